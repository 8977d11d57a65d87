//===- Rematerialiser.h - Checkpointed reverse sweeps -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// With a checkpoint policy, a tape keeps only snapshots while it records. The
// reverse sweep proceeds from each snapshot to the one before: it re-executes
// the records in between, and saves overwritten values for these only. If even
// that is too much, it takes further snapshots on the way, by the binomial
// schedule (Griewank and Walther, "revolve").
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_SWEEP_REMATERIALISER_H
#define TAI_LIB_RUNTIME_TAPE_SWEEP_REMATERIALISER_H

#include "ReverseSweep.h"

namespace mlir::tai::runtime {

class Rematerialiser {
public:
  Rematerialiser(TapeServices services, const TapeRecording &recording,
                 const TapePlan &plan, TapeMemory &memory,
                 TapeTopology &topology, ReverseSweep &reverse)
      : services(services), recording(recording), plan(plan), memory(memory),
        topology(topology), reverse(reverse) {}

  /// isOn: true if the tape has a checkpoint policy. setPolicy sets one, before
  /// anything is recorded.
  bool isOn() const { return checkpoints != nullptr; }
  Status setPolicy(CheckpointPolicy policy);

  /// Resets counts of re-execution, before the sequence runs from its start.
  void restart();
  /// Runs the recorded sequence again, forward, with new snapshots.
  Status replay(Launch &launch);
  /// Runs the reverse sweep by the plan. Afterwards memory has the same
  /// contents as before.
  Status sweep();

  /// The number of times that the record has been re-executed.
  uint32_t countAt(size_t index) const {
    return index < executedAt.size() ? executedAt[index] : 0;
  }
  void addTo(TapeStats &stats) const;

private:
  Status recompute(Launch &launch, size_t index, bool saving, size_t oldest);
  Status recomputeRange(Launch &launch, size_t from, size_t to);
  Status reverseRange(Launch &launch, size_t from, size_t to);
  Status reverseSaving(Launch &launch, size_t from, size_t to);
  Status reverseAll(Launch &launch);
  Status recomputeAll(Launch &launch);
  Status dropTop();
  template <typename Body> Status forEachChange(size_t index, const Body &body);
  bool mayNeed(size_t index) const;
  bool isShort(size_t from, size_t to) const;
  int64_t freeSnapshots() const;
  int64_t bestSnapshots() const;

  TapeServices services;
  const TapeRecording &recording;
  const TapePlan &plan;
  TapeMemory &memory;
  TapeTopology &topology;
  ReverseSweep &reverse;
  std::unique_ptr<Checkpoints> checkpoints;
  /// The number of re-executions of records, in total and of each record.
  int64_t executed = 0;
  std::vector<uint32_t> executedAt;
  /// True if a sweep has run: after it, only the first snapshot is left.
  bool sweptBefore = false;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_SWEEP_REMATERIALISER_H
