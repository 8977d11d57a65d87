//===- ShardPlan.h - How ranks share a loop ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Decides which iterations of a loop over sharded fields a rank runs, and what
// ranks exchange before and after the loop. Reports accesses that no exchange
// serves. `tai-shard` carries out the plan.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_SHARDS_SHARDPLAN_H
#define TAI_LIB_TRANSFORMS_SHARDS_SHARDPLAN_H

#include "tai/Analysis/Index/IndexBuilder.h"
#include "tai/Dialect/Mesh/IR/Mesh.h"
#include "tai/Interfaces/FieldAccess.h"
#include <vector>

namespace mlir::tai {

/// Indices that are the same in all iterations of a loop, by dimension of a
/// field. The values are those in the body of the loop.
struct FixedIndices {
  std::vector<int64_t> dims;
  std::vector<Value> values;
  std::vector<IndexExpr> exprs;

  bool operator==(const FixedIndices &other) const {
    return dims == other.dims && exprs == other.exprs;
  }
};

/// An exchange of a part of a field. `before` and `after` count the rows of
/// other ranks.
struct PlannedExchange {
  ExchangeKind kind;
  FlatSymbolRefAttr field;
  Location loc;
  FixedIndices at;
  int64_t before = 0, after = 0;
};

/// An access to a row that data choose, which must be a row of the rank or one
/// of the `halo` rows on either side.
struct RowCheck {
  FieldAccessOpInterface access;
  Sharding sharding;
  int64_t halo;
};

/// The plan of a loop that accesses sharded fields. The iteration with index
/// `iv` along dimension `dimension` of the loop belongs to the owner of row
/// iv + `offset`. If `isWhole`, each rank runs all iterations, on rows that it
/// has gathered, for the reason `why`.
struct ShardPlan {
  Sharding sharding;
  bool isWhole = false;
  StringRef why;
  unsigned dimension = 0;
  int64_t offset = 0;
  std::vector<PlannedExchange> before, after;
  std::vector<RowCheck> checks;
};

/// True if the loop visits or accesses a sharded field.
bool touchesShards(ParallelForOp loop);

/// The plan of a loop that touches a sharded field. If `reports`, an error
/// tells what cannot be planned.
FailureOr<ShardPlan> planShards(ParallelForOp loop, bool reports = true);

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_SHARDS_SHARDPLAN_H
