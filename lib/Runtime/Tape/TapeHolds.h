//===- TapeHolds.h - The fields that a tape uses ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What a tape uses, it holds: what other threads do to such a field meanwhile
// fails where it would change a gradient; see
// docs/decisions/0022-tapes-of-threads.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_TAPEHOLDS_H
#define TAI_LIB_RUNTIME_TAPE_TAPEHOLDS_H

#include "TapeServices.h"

namespace mlir::tai::runtime {

class TapeHolds {
public:
  /// `tape`: in whose name. `clears`: it begins with gradients of zero, and
  /// they are its own.
  TapeHolds(TapeServices services, const Tape &tape, bool clears)
      : services(services), tape(tape), clears(clears) {}

  bool has(const FieldPtr &field) const { return used.count(field); }
  /// Notes what a launch uses, until release(), and takes over gradients that
  /// other threads have left.
  Status add(const Kernel &kernel);
  Status add(const FieldPtr &field, HoldKind kind);
  /// How the tape uses the gradients that its sweep adds to.
  HoldKind gradientKind() const {
    return clears ? HoldKind::Write : HoldKind::Add;
  }
  /// Holds all of that for the calling thread, again.
  Status hold();
  void release();

private:
  TapeServices services;
  const Tape &tape;
  bool clears;
  std::unordered_map<FieldPtr, HoldKind> used;
  bool isHolding = false;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_TAPEHOLDS_H
