//===- Recomputation.h - Values of other iterations -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Emits values of a loop body again, for the indices of another iteration.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_ACCUMULATIONS_RECOMPUTATION_H
#define TAI_LIB_TRANSFORMS_ACCUMULATIONS_RECOMPUTATION_H

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/IRMapping.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// Recomputes values of the loop body in the iteration that `mapping` gives.
class Recomputation {
public:
  Recomputation(OpBuilder &builder, ParallelForOp loop, IRMapping mapping)
      : builder(builder), loop(loop), mapping(std::move(mapping)) {}

  Value get(Value value);

  OpBuilder &builder;
  ParallelForOp loop;
  IRMapping mapping;
};

Value createZeroValue(OpBuilder &builder, Location loc, Type type);

/// Recomputes `value`, which `op` uses, under `conditions`, the `scf.if` ops
/// around `op`; zero where one of them does not hold.
Value recomputeUnder(Recomputation &at, Operation *op, Value value,
                     ArrayRef<scf::IfOp> conditions);

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_ACCUMULATIONS_RECOMPUTATION_H
