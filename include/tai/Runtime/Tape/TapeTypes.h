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

/// A host function in the sequence that a tape has recorded.
struct TapeCallback {
  /// The function that a replay of the tape calls instead of the recorded
  /// function; may be empty.
  std::function<Status()> forward;
  /// The function that the reverse sweep calls at this place; may be empty.
  std::function<Status()> backward;
};

/// Memory statistics of a tape.
struct TapeStats {
  /// The bytes of saved values: now, and the largest number so far.
  int64_t savedBytes = 0;
  int64_t peakBytes = 0;
  /// Statistics of a tape with a checkpoint policy. snapshots, snapshotBytes:
  /// the maximum number of snapshots and the bytes of the largest snapshot.
  /// recomputed: the number of records run again in all sweeps. optimum: the
  /// least number of such runs for one sweep with as many snapshots if the
  /// number of records had been known in advance (binomial formula).
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
  /// The maximum number of snapshots; 0 means about the square root of the
  /// number of records.
  int64_t snapshots = 0;
  /// The most bytes in snapshots and saved values; 0 means no limit.
  int64_t budget = 0;
};

/// An adjoint that a sweep will launch and that has not been compiled.
struct PendingAdjoint {
  Kernel *kernel;
  /// True for the zeroing variant, which zeroes the adjoints of the elements
  /// that the kernel overwrites.
  bool zeroes;
  /// True for the variant that loads outputs stored by the kernel.
  bool loadsStored;

  bool operator==(const PendingAdjoint &other) const {
    return kernel == other.kernel && zeroes == other.zeroes &&
           loadsStored == other.loadsStored;
  }
  /// Compiles the pending adjoint. Thread-safe.
  Status resolve() const;
};

/// Statistics of an adjoint field, taken after the adjoint of a record has
/// added to it. If the record accesses the field with a fixed index, only
/// elements at this index count. For a host function, there are statistics of
/// each adjoint field that may be non-zero.
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
