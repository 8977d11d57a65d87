//===- IntegerRanges.h - Which values an integer may have -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Ranges of integers, computed for the values that are asked for. Operations
// say what they do to ranges through upstream's InferIntRangeInterface; loops
// bound their indices.
//
// Upstream's data flow analysis visits a whole function, and cannot look at
// loops that do not name their bounds, such as those over fields.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_INTEGERRANGES_H
#define TAI_ANALYSIS_INTEGERRANGES_H

#include "mlir/Interfaces/InferIntRangeInterface.h"
#include "llvm/ADT/DenseMap.h"
#include <functional>

namespace mlir::tai {

class IntegerRanges {
public:
  /// What is known of a value by other means, if anything.
  using Oracle = std::function<std::optional<ConstantIntRanges>(Value)>;
  explicit IntegerRanges(Oracle oracle = nullptr) : oracle(std::move(oracle)) {}

  /// The range of a value of integer or index type, or of the elements of a
  /// vector of such.
  ConstantIntRanges get(Value value) { return get(value, /*depth=*/0); }

private:
  ConstantIntRanges get(Value value, unsigned depth);
  ConstantIntRanges compute(Value value, unsigned depth);
  std::optional<ConstantIntRanges> getLoopIndex(BlockArgument argument,
                                                unsigned depth);

  Oracle oracle;
  llvm::DenseMap<Value, ConstantIntRanges> known;
};

} // namespace mlir::tai

#endif // TAI_ANALYSIS_INTEGERRANGES_H
