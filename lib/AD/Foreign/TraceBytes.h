//===- TraceBytes.h - Memory that traces take -------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_FOREIGN_TRACEBYTES_H
#define TAI_LIB_AD_FOREIGN_TRACEBYTES_H

#include "mlir/IR/ImplicitLocOpBuilder.h"

namespace mlir::tai {

std::optional<int64_t> getConstant(Value value);

/// True for numbers and for vectors of a fixed number of them.
bool hasBytes(Type type);
uint64_t getBytes(Type type);

/// True if `value` is defined outside of the block of `op`, or before `op`.
bool isDefinedBefore(Value value, Operation *op);

/// A number of bytes: the sum of a constant and of values.
struct TraceBytes {
  int64_t known = 0;
  SmallVector<Value> values;

  /// Adds the bytes of `array`. False if they cannot be computed before `op`,
  /// which is where `b` inserts ops.
  bool add(ImplicitLocOpBuilder &b, Value array, Operation *op);
  Value sum(ImplicitLocOpBuilder &b) const;
};

/// Asserts that the copies and records of the derivative of '@`name`' take at
/// most `limit` bytes.
void assertBytes(ImplicitLocOpBuilder &b, Value fits, StringRef name,
                 int64_t limit);

/// Asserts that `arrays` take at most `limit` bytes; the sizes of some are
/// known at run time. Fails if all are constants, or if one is made in a loop.
LogicalResult assertTraces(Block &body, StringRef name, ArrayRef<Value> arrays,
                           int64_t limit);

} // namespace mlir::tai

#endif // TAI_LIB_AD_FOREIGN_TRACEBYTES_H
