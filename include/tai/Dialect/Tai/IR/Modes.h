//===- Modes.h - What a kernel says of its numbers --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The attribute `modes` of kernels:
//
//   precision = "f64" or "f32"       what it computes in, whatever fields hold
//   sums = "compensated"             sums are kept with twice the digits
//          "deterministic"           bits do not depend on threads
//   math = "fast", "strict" or "accurate"
//   ftz = true                       denormal numbers are zero
//
// `"default"` is a word of each. See docs/precision.md.
//
// The functions that a kernel becomes have the same words as a function
// attribute of LLVM, `["tai.modes", "sums=compensated,ftz=true"]` in
// `passthrough`. Both are attributes of the op itself: a pass that drops what
// it does not know must not change a result.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_MODES_H
#define TAI_DIALECT_TAI_IR_MODES_H

#include "mlir/IR/BuiltinAttributes.h"
#include "mlir/IR/Operation.h"
#include <optional>

namespace mlir::tai {

/// What kernels compute in: at least this. The types of fields are their own.
enum class Precision { Default, F64, F32 };

/// How sums over iterations, and scatters, are kept.
enum class SumsMode { Default, Compensated, Deterministic };

/// What may become of arithmetic and of elementary functions.
enum class MathMode { Default, Fast, Strict, Accurate };

struct Modes {
  std::optional<Precision> precision;
  std::optional<SumsMode> sums;
  std::optional<MathMode> math;
  std::optional<bool> ftz;

  /// Those of the kernel or function that `op` is, or stands in.
  static Modes of(Operation *op);

  /// Whether it is deterministic in a context that is so or not.
  bool isDeterministic(bool otherwise) const;
  bool isCompensated() const { return sums == SumsMode::Compensated; }
  /// Whether its sums have the order that all targets share, in a context that
  /// is deterministic or not: see docs/decisions/0039-bits.md.
  bool hasOneOrder(bool deterministic) const {
    return math == MathMode::Strict && !isCompensated() &&
           isDeterministic(deterministic);
  }
  bool isAccurate() const { return math == MathMode::Accurate; }
  bool flushes() const { return ftz.value_or(false); }

  /// Says so on a kernel or on a function of the LLVM dialect.
  void setOn(Operation *function) const;

  friend bool operator==(const Modes &lhs, const Modes &rhs) {
    return lhs.precision == rhs.precision && lhs.sums == rhs.sums &&
           lhs.math == rhs.math && lhs.ftz == rhs.ftz;
  }
};

/// Fails after an error if the dictionary of a kernel holds anything else.
LogicalResult verifyModes(Operation *kernel, DictionaryAttr modes);

/// The same for what a function of the LLVM dialect, if `function` is one, says
/// in `passthrough`. Passes that read it ask: no verifier does.
LogicalResult verifyPassedModes(Operation *function);

} // namespace mlir::tai

#endif // TAI_DIALECT_TAI_IR_MODES_H
