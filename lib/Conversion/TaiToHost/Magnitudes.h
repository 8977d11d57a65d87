//===- Magnitudes.h - Bounds of numbers that are tested ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Part of `tai-skip-zero-blocks`: finds values that are finite if certain
// numbers, the leaves, are at most kLeafBound in magnitude.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TAITOHOST_MAGNITUDES_H
#define TAI_LIB_CONVERSION_TAITOHOST_MAGNITUDES_H

#include "tai/Analysis/FloatFacts.h"
#include "llvm/ADT/SetVector.h"
#include <functional>

namespace mlir::tai {

class Magnitudes {
public:
  static constexpr double kLeafBound = 1e6;

  /// `isLeaf` tells which values can be tested.
  explicit Magnitudes(std::function<bool(Value)> isLeaf)
      : isLeaf(std::move(isLeaf)) {}

  /// True if the value is finite, and not NaN, if all leaves are bounded.
  bool isFinite(Value value);

  /// Adds the leaves to which the answer isFinite(value) refers.
  void addLeaves(Value value, llvm::SetVector<Value> &leaves);

private:
  /// Returns a bound of the magnitude; infinity if there is none.
  double getBound(Value value);
  double computeBound(Value value);

  std::function<bool(Value)> isLeaf;
  FloatFacts facts;
  llvm::DenseMap<Value, double> bounds;
};

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOHOST_MAGNITUDES_H
