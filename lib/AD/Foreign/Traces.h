//===- Traces.h - Values that a function read ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The gradient of a function that overwrites elements it has read, or that
// keeps values in arrays of its own, runs the function once more and records
// the values of its reads: the trace. The reverse sweep then takes the values
// from there.
//
// A trace is an array with one element for each execution of the read. The
// number of an execution follows from the iterations of the loops around it. If
// the bounds of all loops are computed before the first loop, the array has its
// final size from the start. Otherwise the array grows, and the number at which
// a loop begins is recorded in a trace of its own.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_FOREIGN_TRACES_H
#define TAI_LIB_AD_FOREIGN_TRACES_H

#include "mlir/Interfaces/FunctionInterfaces.h"
#include "llvm/ADT/DenseMap.h"

namespace mlir::tai {

struct Traces {
  /// The results of recorded reads, each with the value in the trace.
  DenseMap<Value, Value> recorded;
  /// Arguments that stand for traces in the primal, and the traces in the
  /// gradient.
  SmallVector<std::pair<Value, Value>> arrays;
  /// The positions of arguments whose former elements the second execution
  /// reads.
  SmallVector<int64_t> before;
};

/// Where the traces are made.
enum class TraceMode {
  /// The gradient runs the function again at its beginning, on copies of the
  /// arrays that it writes.
  Rerun,
  /// A separate function repeats the whole function, and returns the results of
  /// the function and then the traces.
  Augmented
};

/// Runs `primal` again at the beginning of `target`, which is empty and whose
/// arguments begin with those of `primal`, and records the results of `reads`.
/// Extends `primal` by arguments and ops that read the traces. Memory of the
/// caller is not changed, unless `target` is the augmented function.
Traces recordReads(FunctionOpInterface primal, FunctionOpInterface target,
                   ArrayRef<Operation *> reads,
                   TraceMode mode = TraceMode::Rerun);

} // namespace mlir::tai

#endif // TAI_LIB_AD_FOREIGN_TRACES_H
