//===- Cost.h - Cost estimates ----------------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// One estimate for all decisions about how a loop runs. It needs to be right
// within a small factor only: it decides whether a loop is worth a fork.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_COST_H
#define TAI_ANALYSIS_COST_H

#include "mlir/IR/Block.h"
#include "llvm/ADT/StringRef.h"

namespace mlir::tai {

/// Nanoseconds to distribute a loop to other cores and to wait for them.
constexpr double kForkNanoseconds = 4000;

/// The trip count assumed of a loop whose bounds are not known.
constexpr int64_t kAssumedTrips = 8;

/// The number of trips of a loop op, assumed where unknown.
int64_t estimateTrips(Operation *loop);

/// Nanoseconds of one execution of the op, or of the block, on one core.
double estimateNanoseconds(Operation *op);
double estimateNanoseconds(Block &block);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_COST_H
