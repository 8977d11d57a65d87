//===- Modes.h - Numeric modes of a kernel ----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The attribute `modes` of kernels:
//
//   precision = "f64", "f32"      the type of arithmetic; fields keep theirs
//   sums = "compensated",         sums are kept with twice the digits
//          "deterministic",       bits do not depend on threads
//          "compensated+deterministic"  both; set in deterministic contexts
//   math = "fast", "strict", "accurate"
//   ftz = true, false             denormal numbers are zero
//
// Each entry also accepts `"default"`. See docs/guides/precision.md.
//
// Functions that a kernel is lowered to have the same settings as an LLVM
// function attribute, `["tai.modes", "sums=compensated,ftz=true"]` in
// `passthrough`. Both are inherent attributes: passes are free to drop
// discardable attributes, and a dropped mode would change results.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_MODES_H
#define TAI_DIALECT_TAI_IR_MODES_H

#include "mlir/IR/BuiltinAttributes.h"
#include "mlir/IR/Operation.h"
#include <optional>

namespace mlir::tai {

/// The minimum precision of a kernel's arithmetic. Fields keep their types.
enum class Precision { Default, F64, F32 };

/// The arithmetic and the order of sums over iterations and of scatters.
enum class SumsMode { Default, Compensated, Deterministic, Both };

/// The transformations allowed for arithmetic and elementary functions.
enum class MathMode { Default, Fast, Strict, Accurate };

struct Modes {
  std::optional<Precision> precision;
  std::optional<SumsMode> sums;
  std::optional<MathMode> math;
  std::optional<bool> ftz;

  /// The numeric modes of the kernel or function that `op` is, or is in.
  static Modes of(Operation *op);

  /// Returns these modes with deterministic sums, for a kernel in a
  /// deterministic context.
  Modes inDeterministicContext() const;

  bool isDeterministic() const {
    return sums == SumsMode::Deterministic || sums == SumsMode::Both;
  }
  bool isCompensated() const {
    return sums == SumsMode::Compensated || sums == SumsMode::Both;
  }
  /// True if sums are added in the order that all targets share: see
  /// docs/decisions/0039-bits.md.
  bool hasOneOrder() const {
    return math == MathMode::Strict && !isCompensated() && isDeterministic();
  }
  bool isAccurate() const { return math == MathMode::Accurate; }
  bool flushes() const { return ftz.value_or(false); }

  /// Sets the numeric modes on a kernel or on a function of the LLVM dialect.
  void setOn(Operation *function) const;

  friend bool operator==(const Modes &lhs, const Modes &rhs) {
    return lhs.precision == rhs.precision && lhs.sums == rhs.sums &&
           lhs.math == rhs.math && lhs.ftz == rhs.ftz;
  }
};

/// Emits an error and fails if the dictionary of numeric modes has an unknown
/// entry.
LogicalResult verifyModes(Operation *kernel, DictionaryAttr modes);

/// Verifies the numeric modes in the `passthrough` attribute of `function`, if
/// it is a function of the LLVM dialect. Passes that read these modes call
/// verifyPassedModes, because no verifier checks `passthrough`.
LogicalResult verifyPassedModes(Operation *function);

} // namespace mlir::tai

#endif // TAI_DIALECT_TAI_IR_MODES_H
