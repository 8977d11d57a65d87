//===- StepSchedules.h - The schedules of a sequence ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// In which order programs do the steps of a sequence, and where their threads
// meet: once step by step, and once with launches that can share tiles standing
// together as one.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_QUEUE_STEPSCHEDULES_H
#define TAI_LIB_RUNTIME_QUEUE_STEPSCHEDULES_H

#include "ProgramLoops.h"
#include "Sequence.h"
#include "TileChains.h"

namespace mlir::tai::runtime {

class DeviceQueue::StepSchedules {
public:
  StepSchedules(const Device &device, const Sequence &sequence)
      : device(device), sequence(sequence) {}

  /// Steps of the sequence that stand together in a program: one, or a chain.
  struct Unit {
    size_t first, count;
    /// The number of the chain; -1 for none.
    int chain;
  };
  struct Schedule {
    std::vector<Unit> units;
    /// Of the units.
    ProgramSchedule order;
    const Unit &unit(size_t at) const { return units[order.order[at]]; }
  };

  /// Makes them. `wantsTiles`: that with tiles, too, if there is a use for it.
  void make(bool wantsTiles);
  /// Makes them again where parameters have changed that matter for them.
  void update();
  /// Nobody wants that with tiles any more.
  void dropTiles() { wantsTiles = false; }

  /// Whether there are chains.
  bool hasTiles() const { return !tiled.units.empty(); }
  const Schedule &get(bool withTiles) const {
    return withTiles ? tiled : plain;
  }
  /// A block for each tile, and a thread for each of its cells.
  LaunchShape getTileShape() const;
  /// So many steps come before the program, each by itself.
  size_t countBefore() const { return numBefore; }
  /// Steps of which it is not known what they touch.
  size_t countUnknown() const { return numUnknown; }

  /// The steps with the numbers of their parts, in the order of the schedule.
  std::vector<LoopStep> listSteps(bool withTiles) const;
  /// Adds the functions of iterations, whose numbers follow those of the
  /// others, and the chains that call them.
  void addTiles(ProgramPlan &plan) const;
  std::string describe(const Unit &unit) const;
  std::string describeChains() const;

private:
  size_t countStepsBefore() const;
  void listDecisiveSlots();
  void makeTiled(const std::vector<StepMemory> &memory);

  const Device &device;
  const Sequence &sequence;
  /// That with tiles is empty where there are no chains.
  Schedule plain, tiled;
  bool wantsTiles = false;
  /// All that there have been so far, by their numbers.
  std::vector<TileChain> chains;
  size_t numBefore = 0, numUnknown = 0;
  /// The slots that say which memory the steps touch, and what they held.
  std::vector<size_t> decisiveSlots;
  std::vector<uint64_t> decisiveValues;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_STEPSCHEDULES_H
