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

/// An extent; the extents of an array are possibly unknown until launch time.
struct Extent {
  int64_t number = 0;
  /// If not null, the extent of dimension `number` of this argument.
  Value array = {};
};

/// An access with its indices, their first values and extents.
struct IndexedAccess {
  Operation *op;
  /// "field '@x' of shape [4, 8]"; for an array, see `describeArray`.
  std::string what;
  /// The indices of the program. Indices of components of an element follow the
  /// indices of the element.
  SmallVector<OpOperand *> indices;
  SmallVector<int64_t> first;
  SmallVector<Extent> extents;
  /// The number of indices of the element; the rest are indices of components.
  size_t rank = 0;

  /// Returns no value for an operation that is not an access, or whose index
  /// space is not a box.
  static std::optional<IndexedAccess> get(Operation *op);
};

/// "field '@x' of shape [4, 8]", with the first index where it is not zero.
std::string describeField(const FieldLayout &layout);
/// "an element of shape [3] of field '@v'".
std::string describeElement(FieldOp field);
/// "an array of f32 of shape [{}, 3]"; extents that the launch decides are left
/// open.
std::string describeArray(MemRefType type);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_INDEXEDACCESS_H
