//===- IndexDigits.h - Indices that are digits of a number ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Quotients and remainders of one number, as in `y[i // 4, i % 4]`: together
// they determine the number.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_INDEXDIGITS_H
#define TAI_ANALYSIS_INDEXDIGITS_H

#include "mlir/IR/Value.h"

namespace mlir::tai {

/// Pairs of values, of the first and of the second list, that are equal if the
/// lists are: the numbers of which indices are the digits. The lists may be of
/// different iterations of `loop`.
SmallVector<std::pair<Value, Value>>
findNumbersOfDigits(ValueRange first, ValueRange second, Operation *loop);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_INDEXDIGITS_H
