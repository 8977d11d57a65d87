//===- ContextModes.h - Modes of numbers of a context -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The words of numbers that are options of a context. All that passes read are
// those of a kernel (see Modes.h): a kernel that is made in a context gets its
// words, but for what it says itself.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_CONTEXTMODES_H
#define TAI_EXECUTIONENGINE_CONTEXTMODES_H

#include "tai/Dialect/Tai/IR/Tai.h"
#include <string>

namespace mlir::tai {

struct ContextModes {
  std::string precision = "default";
  std::string sums = "default";
  std::string math = "default";
  bool ftz = false;
  /// "f64": gradients of fields are fields of f64.
  std::string adjoints = "default";
  /// The short forms.
  bool fastMath = false, strict = false, deterministic = false;
  /// Not of the modes, but strict where they are.
  bool shadow = false;

  bool isFast() const { return fastMath || math == "fast"; }
  bool isStrict() const { return strict || math == "strict"; }
  bool isDeterministic() const {
    return deterministic || sums == "deterministic";
  }

  /// Sets one of the five words. Nothing if there is such a word, else what the
  /// option expects.
  std::string setWord(StringRef name, StringRef word);

  /// Why these cannot be had together, or nothing.
  std::string findContradiction() const;

  /// Says on the kernels of a module what they do not say themselves.
  void addTo(ModuleOp module) const;

  /// Reports an error at the first field of a module whose gradient does not
  /// hold what `adjoints` asks for.
  LogicalResult checkFields(ModuleOp module) const;
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_CONTEXTMODES_H
