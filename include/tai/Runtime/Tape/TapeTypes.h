//===- TapeTypes.h - What goes into a tape and comes out --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_TAPE_TAPETYPES_H
#define TAI_RUNTIME_TAPE_TAPETYPES_H

#include "tai/Support/Status.h"
#include <cstdint>
#include <functional>

namespace mlir::tai::runtime {

class Field;
class Kernel;

/// A host function in the sequence. It may be called again by a replay.
struct TapeCallback {
  /// Called by a forward replay in place of what ran when it was recorded; may
  /// be empty.
  std::function<Status()> forward;
  /// Called at its place in the reverse sweep; may be empty.
  std::function<Status()> backward;
};

/// What a tape keeps.
struct TapeStats {
  /// Bytes of overwritten values that it keeps now, and most at any time.
  int64_t savedBytes = 0;
  int64_t peakBytes = 0;
  /// With a checkpoint policy: the most snapshots at any time, the bytes of the
  /// largest, how many records have been executed again in all sweeps, and how
  /// many a sweep that knew their number beforehand would execute again with as
  /// many snapshots, by the binomial formula.
  int64_t snapshots = 0;
  int64_t snapshotBytes = 0;
  int64_t recomputed = 0;
  int64_t optimum = 0;
};

/// How a tape recomputes values instead of saving all that are overwritten.
struct CheckpointPolicy {
  enum class Kind : uint8_t {
    None,     // saves
    Periodic, // snapshots at even distances, saves between two of them
    Binomial, // snapshots alone
    Mixed     // as periodic where the values between two fit
  };
  Kind kind = Kind::None;
  /// Most snapshots; 0 for about the square root of the number of records.
  int64_t snapshots = 0;
  /// Most bytes of snapshots and saved values; 0 for no limit.
  int64_t budget = 0;
};

/// An adjoint that a sweep will launch and that has not been made.
struct PendingAdjoint {
  Kernel *kernel;
  /// The form that zeroes the adjoints of what the kernel overwrites.
  bool zeroes;
  /// The form that loads what the kernel has stored.
  bool loadsStored;

  bool operator==(const PendingAdjoint &other) const {
    return kernel == other.kernel && zeroes == other.zeroes &&
           loadsStored == other.loadsStored;
  }
  /// Makes it now. Any thread.
  Status resolve() const;
};

/// What the adjoint of a record left in the adjoint of a field that it adds to;
/// of the elements at the record's fixed index, where it has one. For a host
/// function, one for each adjoint that may be non-zero.
struct RecordHealth {
  int64_t record;
  const Field *field;
  int64_t nans;
  int64_t infs;
  double maxAbs;     // of the finite numbers
  double sumSquares; // of the finite numbers
};

/// A launch that writes a field which an earlier record reads or writes.
struct FieldOverwrite {
  int64_t record;
  const Field *field;
  int64_t earlier; // the last such record before it
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_TAPE_TAPETYPES_H
