//===- IntegerRanges.h - Ranges of integers ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Integer ranges on demand. Operations define their ranges by upstream's
// InferIntRangeInterface; loops bound their indices.
//
// Upstream's data flow analysis visits a whole function, and cannot look at
// loops that do not name their bounds, such as loops over fields.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_INDEX_INTEGERRANGES_H
#define TAI_ANALYSIS_INDEX_INTEGERRANGES_H

#include "mlir/Interfaces/InferIntRangeInterface.h"
#include "llvm/ADT/DenseMap.h"
#include <functional>

namespace mlir::tai {

class IntegerRanges {
public:
  /// A callback that gives the range of a value if the caller has further
  /// knowledge about it.
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

#endif // TAI_ANALYSIS_INDEX_INTEGERRANGES_H
