//===- Rematerialiser.h - Reverse sweeps that recompute values --*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// With a checkpoint policy, a tape keeps snapshots while it records and nothing
// else. The reverse sweep goes from one to the one before: it executes the
// records in between again, and saves what they overwrite only there. Where
// even that is too much, it takes more snapshots on the way, where the binomial
// schedule (Griewank and Walther, "revolve") wants them.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_REMATERIALISER_H
#define TAI_LIB_RUNTIME_TAPE_REMATERIALISER_H

#include "ReverseSweep.h"

namespace mlir::tai::runtime {

class Rematerialiser {
public:
  Rematerialiser(TapeServices services, const TapeRecording &recording,
                 const TapePlan &plan, TapeMemory &memory,
                 TapeTopology &topology, ReverseSweep &reverse)
      : services(services), recording(recording), plan(plan), memory(memory),
        topology(topology), reverse(reverse) {}

  /// Whether there is a policy; and sets one. To be called before anything is
  /// recorded.
  bool isOn() const { return checkpoints != nullptr; }
  Status setPolicy(CheckpointPolicy policy);

  /// Forgets what was executed again: the sequence is about to run from its
  /// start.
  void restart();
  /// The same sequence once more, forward, with new snapshots.
  Status replay(Launch &launch);
  /// The reverse sweep by the plan. Memory is what it was when all is done.
  Status sweep();

  /// How often the record has been executed again.
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
  /// How often records were executed again, and each of them.
  int64_t executed = 0;
  std::vector<uint32_t> executedAt;
  /// Only the first snapshot is left.
  bool sweptBefore = false;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_REMATERIALISER_H
