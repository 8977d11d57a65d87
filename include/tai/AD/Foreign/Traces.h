//===- Traces.h - Values that a function read -------------------*- C++ -*-===//
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

#ifndef TAI_AD_FOREIGN_TRACES_H
#define TAI_AD_FOREIGN_TRACES_H

#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "llvm/ADT/DenseMap.h"

namespace mlir::tai {

struct Traces {
  /// Maps the result of each recorded read to the value that is loaded from its
  /// trace.
  DenseMap<Value, Value> recorded;
  /// Pairs of an argument of the primal that stands for a trace, and the trace
  /// itself in the gradient.
  SmallVector<std::pair<Value, Value>> arrays;
  /// Positions of array arguments that must be passed as they were before the
  /// function ran, because the second execution reads them.
  SmallVector<int64_t> before;
};

/// The function in which the second execution takes place and traces are made.
enum class TraceMode {
  /// The gradient begins with the second execution, which writes to copies of
  /// the arrays.
  Rerun,
  /// A separate function is the second execution; it returns the results of the
  /// original function, and then the traces.
  Augmented
};

/// Runs `primal` again at the beginning of `target`, which is empty and whose
/// arguments begin with those of `primal`, and records the results of `reads`.
/// Extends `primal` by arguments and ops that read the traces. Memory of the
/// caller is not changed, unless `target` is the augmented function.
Traces recordReads(FunctionOpInterface primal, FunctionOpInterface target,
                   ArrayRef<Operation *> reads,
                   TraceMode mode = TraceMode::Rerun);

/// The bytes of an array, or none if its size is no constant.
std::optional<uint64_t> getAllocatedBytes(memref::AllocOp array);

/// Divides the loops of the `gradient` of '@`name`' with most `records` into
/// segments. The second execution keeps the arrays at the start of each, and
/// the reverse sweep runs one segment after the other again, so that all of
/// `arrays`, the records and the copies, take at most `limit` bytes. Sizes that
/// are known at run time only are checked there, by an assertion. Fails if this
/// cannot be; the gradient is then not to be used.
LogicalResult divideTraces(FunctionOpInterface gradient, StringRef name,
                           ArrayRef<Value> records, ArrayRef<Value> arrays,
                           uint64_t limit);

} // namespace mlir::tai

#endif // TAI_AD_FOREIGN_TRACES_H
