//===- ArrayRanges.h - Arrays that overlap ----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Arrays of the caller may be identical, or views of one memory. A loop that
// needs to know gets a version for launches in which they are apart.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_UTILS_ARRAYRANGES_H
#define TAI_TRANSFORMS_UTILS_ARRAYRANGES_H

#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/ADT/SetVector.h"

namespace mlir::tai {

/// On a loop: most iterations, or the launches of interest, take another
/// version of it.
constexpr llvm::StringLiteral kFallbackAttrName = "tai.fallback";

/// The array arguments that a loop accesses, and of these the ones that it
/// writes.
struct LoopArrays {
  llvm::SetVector<Value> all;
  llvm::SmallDenseSet<Value> written;

  /// No value if the loop has effects other than accesses to elements of fields
  /// and of contiguous arrays, or many arrays.
  static std::optional<LoopArrays> collect(ParallelForOp loop);

  /// Emits a test that no array overlaps with one that is written; null if the
  /// loop is known to have no such arrays.
  Value createTest(ImplicitLocOpBuilder &b, ParallelForOp loop) const;
};

/// The conjunction of two conditions, each of which may be null.
Value createBoth(ImplicitLocOpBuilder &b, Value lhs, Value rhs);

/// Along one index of a loop, iterations or elements near both ends of a range:
/// `width` from `first` on, and as many from `second` on.
struct RangeEnds {
  Value first, second;
  int64_t width;

  /// The index for iteration `number` of a loop over both ends.
  Value getIndex(ImplicitLocOpBuilder &b, Value number) const;
};

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_ARRAYRANGES_H
