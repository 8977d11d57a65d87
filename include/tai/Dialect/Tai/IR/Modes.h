//===- Modes.h - What a kernel says of its numbers --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The attribute `tai.modes` of kernels, and of the functions that they become:
//
//   precision = "f64" or "f32"       what it computes in, whatever fields hold
//   sums = "compensated"             sums are kept with twice the digits
//          "deterministic"           bits do not depend on threads
//   math = "fast", "strict" or "accurate"
//   ftz = true                       denormal numbers are zero
//
// `"default"` is a word of each. See docs/precision.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_MODES_H
#define TAI_DIALECT_TAI_IR_MODES_H

#include "mlir/IR/Operation.h"
#include <optional>

namespace mlir::tai {

/// What kernels compute in: at least this. The types of fields are their own.
enum class Precision { Default, F64, F32, F16, BF16 };

/// How sums over iterations, and scatters, are kept.
enum class SumsMode { Default, Compensated, Deterministic };

/// What may become of arithmetic and of elementary functions.
enum class MathMode { Default, Fast, Strict, Accurate };

constexpr llvm::StringLiteral kModesAttrName = "tai.modes";

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
  bool isAccurate() const { return math == MathMode::Accurate; }
  bool flushes() const { return ftz.value_or(false); }
};

/// Fails after an error if the dictionary holds anything else.
LogicalResult verifyModes(Operation *op, Attribute modes);

} // namespace mlir::tai

#endif // TAI_DIALECT_TAI_IR_MODES_H
