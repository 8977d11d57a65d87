//===- TapeHolds.h - The fields that a tape uses ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A tape holds the fields that it uses: an access of another thread to a held
// field fails if it would change a gradient; see
// docs/decisions/0022-tapes-of-threads.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_RECORD_TAPEHOLDS_H
#define TAI_LIB_RUNTIME_TAPE_RECORD_TAPEHOLDS_H

#include "../TapeServices.h"

namespace mlir::tai::runtime {

class TapeHolds {
public:
  /// `tape`: the owner of the holds. `clears`: the tape zeroes gradients at its
  /// start, and uses them exclusively.
  TapeHolds(TapeServices services, const Tape &tape, bool clears)
      : services(services), tape(tape), clears(clears) {}

  bool has(const FieldPtr &field) const { return used.count(field); }
  /// Holds the fields of a launch for the tape, until release(), and takes over
  /// gradients that other threads have written.
  Status add(const Kernel &kernel);
  Status add(const FieldPtr &field, HoldKind kind);
  /// The kind of hold that the tape has on gradients to which its sweep adds.
  HoldKind gradientKind() const {
    return clears ? HoldKind::Write : HoldKind::Add;
  }
  /// Holds all fields that were added before again, for the calling thread.
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

#endif // TAI_LIB_RUNTIME_TAPE_RECORD_TAPEHOLDS_H
