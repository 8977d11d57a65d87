//===- BoundsMode.h - Treatment of indices out of range ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The option `bounds`, and the mark of checked accesses; see
// docs/decisions/0018-hoisted-bounds.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_SUPPORT_BOUNDSMODE_H
#define TAI_SUPPORT_BOUNDSMODE_H

#include "llvm/ADT/StringRef.h"
#include "llvm/Support/CommandLine.h"

namespace mlir::tai {

/// The semantics of an index that depends on data and is out of range:
/// undefined behaviour, the nearest element, or a failure of the launch.
enum class BoundsMode { Off, Clamp, Check };

inline llvm::StringRef stringifyBoundsMode(BoundsMode mode) {
  switch (mode) {
  case BoundsMode::Off:
    return "off";
  case BoundsMode::Clamp:
    return "clamp";
  case BoundsMode::Check:
    return "check";
  }
  llvm_unreachable("all modes are handled");
}

/// The attribute of an access whose indices are all in range, so that it needs
/// no check. If a pass drops the attribute, only time is lost.
constexpr llvm::StringLiteral kInRangeAttrName = "tai.in_range";

} // namespace mlir::tai

#endif // TAI_SUPPORT_BOUNDSMODE_H
