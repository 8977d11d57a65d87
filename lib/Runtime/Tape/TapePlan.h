//===- TapePlan.h - What a reverse sweep will do ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The decision for each record, made once for a sequence of records and a set
// of adjoints that are non-zero at the start of the sweep. A callback may touch
// anything, so that from there on one decides as one goes, from the dirty flags
// of the adjoint fields, which every launch and every host write keep. Nothing
// is launched here.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_TAPEPLAN_H
#define TAI_LIB_RUNTIME_TAPE_TAPEPLAN_H

#include "Overwrites.h"
#include "TapeRecording.h"
#include "TapeServices.h"

namespace mlir::tai::runtime {

class TapePlan {
public:
  enum class Decision : uint8_t {
    Replay,
    SkipNoDerivative, // the kernel has none
    SkipUnreached,    // changes no field with a live adjoint
    SkipNoEffect,     // reads no field with an adjoint, overwrites none
    Callback,
    SkipCallback, // nothing to call in reverse
    Unpruned,     // replayed although it has no effect: pruning is off
    Overwrite     // the adjoint of what the host wrote becomes zero
  };
  static bool isReplayed(Decision decision) {
    return decision == Decision::Replay || decision == Decision::Overwrite ||
           decision == Decision::Unpruned;
  }

  /// Decides on all records, from the summaries of their kernels alone. `live`:
  /// the fields whose adjoints may be non-zero at the start.
  void make(const TapeServices &services, const TapeRecording &recording,
            std::vector<Field *> live);
  /// Whether there are decisions for these records, whatever they hold for.
  bool isMade(const TapeRecording &recording) const {
    return decisions.size() == recording.size();
  }
  /// Whether they hold in this state of the storage and with these adjoints.
  bool holds(const TapeRecording &recording, uint64_t epoch,
             const std::vector<Field *> &live) const {
    return isMade(recording) && plannedEpoch == epoch && plannedLive == live;
  }
  /// Decides on a record again, by the adjoints that are dirty now.
  void decideAgain(const TapeRecording &recording, size_t index);

  Decision operator[](size_t index) const { return decisions[index]; }
  /// The records that are replayed, from the last to the first.
  const std::vector<uint32_t> &replayed() const { return needed; }
  bool replaysAny() const;
  int64_t numSkipped() const;
  /// Whether the adjoint of a record is to zero the adjoints of what it
  /// overwrites.
  bool zeroesAt(size_t index) const { return overwrites.isRepeated[index]; }
  /// Adjoints of elements that are zero after the sweep.
  const Overwrites::Zeros &zerosAfter() const { return overwrites.storedOnce; }

private:
  template <typename Live>
  Decision decide(const TapeRecording &recording, size_t index,
                  const Live &live) const;

  std::vector<Decision> decisions;
  std::vector<uint32_t> needed;
  Overwrites overwrites;
  /// What they hold for.
  std::vector<Field *> plannedLive;
  uint64_t plannedEpoch = 0;
  bool prunes = true;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_TAPEPLAN_H
