//===- IndexedAccess.h - Indices of an access -------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_INDEXEDACCESS_H
#define TAI_ANALYSIS_INDEXEDACCESS_H

#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include <optional>

namespace mlir::tai {

/// An extent of a dimension. The extents of an array are possibly unknown until
/// launch time.
struct Extent {
  int64_t number = 0;
  /// If not null, an array argument whose dimension `number` has this extent.
  Value array = {};
};

/// A memory access with its indices, their first values and extents.
struct IndexedAccess {
  Operation *op;
  /// Name of the accessed memory for messages, such as "field '@x' of shape [4,
  /// 8]"; for an array, the result of describeArray.
  std::string what;
  /// The operands that are indices of the access. Indices of a component within
  /// an element follow the indices of the element.
  SmallVector<OpOperand *> indices;
  SmallVector<int64_t> first;
  SmallVector<Extent> extents;
  /// The number of leading indices that select the element; the rest select a
  /// component of the element.
  size_t rank = 0;

  /// Describes the access that `op` makes. No value if `op` is not an access,
  /// or if its index space is not a box.
  static std::optional<IndexedAccess> get(Operation *op);
};

/// A phrase for messages, such as "field '@x' of shape [4, 8]"; if the indices
/// of the field do not start at zero, the phrase tells the first index.
std::string describeField(const FieldLayout &layout);
/// A phrase for messages, such as "an element of shape [3] of field '@v'".
std::string describeElement(FieldOp field);
/// A phrase for messages, such as "an array of f32 of shape [{}, 3]". Extents
/// that are unknown until launch time are printed as {}.
std::string describeArray(MemRefType type);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_INDEXEDACCESS_H
