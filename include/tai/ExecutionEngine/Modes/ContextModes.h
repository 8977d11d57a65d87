//===- ContextModes.h - Numeric modes of a context --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The numeric modes that are options of a context. Passes read only the modes
// of kernels (see Modes.h): a kernel made in a context gets the modes of the
// context, except modes that the kernel itself specifies.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_MODES_CONTEXTMODES_H
#define TAI_EXECUTIONENGINE_MODES_CONTEXTMODES_H

#include "tai/Dialect/Tai/IR/Tai.h"
#include <bitset>
#include <string>

namespace mlir::tai {

struct ContextModes {
  std::string precision = "default";
  std::string sums = "default";
  std::string math = "default";
  bool ftz = false;
  /// With "f64", the gradients of all fields are stored as f64.
  std::string adjoints = "default";
  /// Options of a context that are short forms of numeric modes.
  enum class Shorthand : unsigned { FastMath, Strict, Deterministic };
  std::bitset<3> shorthands;
  /// True if shadow execution is on: not a numeric mode, but it excludes the
  /// same modes that strict arithmetic excludes.
  bool shadow = false;

  bool has(Shorthand option) const {
    return shorthands.test(static_cast<unsigned>(option));
  }
  bool isFast() const { return has(Shorthand::FastMath) || math == "fast"; }
  bool isStrict() const { return has(Shorthand::Strict) || math == "strict"; }
  bool isDeterministic() const {
    return has(Shorthand::Deterministic) || sums == "deterministic";
  }

  /// Sets the option `precision`, `sums`, `math` or `adjoints` to a word.
  /// Returns "" or, for an invalid word, a description of the valid words.
  std::string setWord(StringRef name, StringRef word);

  /// Returns the reason why the modes contradict each other, or "".
  std::string findContradiction() const;

  /// Sets the modes of the context on the kernels of a module, except modes
  /// that a kernel itself specifies.
  void addTo(ModuleOp module) const;

  /// Reports an error at the first field of a module whose gradient field does
  /// not have the precision that `adjoints` requires.
  LogicalResult checkFields(ModuleOp module) const;
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_MODES_CONTEXTMODES_H
