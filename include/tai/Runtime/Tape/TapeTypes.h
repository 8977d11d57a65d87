//===- TapeTypes.h - Public types of tapes ----------------------*- C++ -*-===//
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

/// A host function in the recorded sequence.
struct TapeCallback {
  /// Called by a forward replay, in place of the recorded execution; may be
  /// empty.
  std::function<Status()> forward;
  /// Called at its place in the reverse sweep; may be empty.
  std::function<Status()> backward;
};

/// Memory statistics of a tape.
struct TapeStats {
  /// Bytes of saved values, now and at most.
  int64_t savedBytes = 0;
  int64_t peakBytes = 0;
  /// With a checkpoint policy: the maximum number of snapshots, the bytes of
  /// the largest snapshot, the number of re-executed records in all sweeps, and
  /// the optimum for one sweep with as many snapshots if the number of records
  /// were known in advance (binomial formula).
  int64_t snapshots = 0;
  int64_t snapshotBytes = 0;
  int64_t recomputed = 0;
  int64_t optimum = 0;
};

/// How a tape trades recomputation for saved values.
struct CheckpointPolicy {
  enum class Kind : uint8_t {
    None,     // saves values only
    Periodic, // snapshots at even distances, saves values between snapshots
    Binomial, // snapshots only
    Mixed     // Periodic where the values between two snapshots fit
  };
  Kind kind = Kind::None;
  /// Maximum of snapshots; 0 for about the square root of the number of
  /// records.
  int64_t snapshots = 0;
  /// Maximum of bytes in snapshots and saved values; 0 for no limit.
  int64_t budget = 0;
};

/// An adjoint that a sweep will launch and that has not been compiled.
struct PendingAdjoint {
  Kernel *kernel;
  /// The zeroing variant: zeroes the adjoints of the overwritten elements.
  bool zeroes;
  /// The variant that loads stored outputs.
  bool loadsStored;

  bool operator==(const PendingAdjoint &other) const {
    return kernel == other.kernel && zeroes == other.zeroes &&
           loadsStored == other.loadsStored;
  }
  /// Compiles the adjoint now. Thread-safe.
  Status resolve() const;
};

/// Statistics of an adjoint field after the adjoint of a record has added to
/// the field; of only the slab of the record's fixed index, if it has one. For
/// a host function, there is an entry for each adjoint field that may be
/// non-zero.
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
  int64_t earlier; // the last record before it that stores to the field
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_TAPE_TAPETYPES_H
