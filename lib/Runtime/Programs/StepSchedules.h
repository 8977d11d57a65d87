//===- StepSchedules.h - The schedules of a sequence ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The order and the barriers of a sequence's steps in programs: one schedule
// with single steps, and one in which launches that form tile chains are one
// unit.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_PROGRAMS_STEPSCHEDULES_H
#define TAI_LIB_RUNTIME_PROGRAMS_STEPSCHEDULES_H

#include "ProgramLoops.h"
#include "TileChains.h"
#include "tai/Runtime/Programs/Sequence.h"

namespace mlir::tai::runtime::programs {

class StepSchedules {
public:
  StepSchedules(const Device &device, const Sequence &sequence)
      : device(device), sequence(sequence) {}

  /// Consecutive steps that are one unit of a program: a single step, or a tile
  /// chain.
  struct Unit {
    size_t first, count;
    /// The number of the tile chain that the unit is; -1 for a single step.
    int chain;
  };
  struct Schedule {
    std::vector<Unit> units;
    /// The order of the units of the program, and the barriers between them.
    ProgramSchedule order;
    const Unit &unit(size_t at) const { return units[order.order[at]]; }
  };

  /// Computes the schedules. With `wantsTiles`, also computes the schedule with
  /// tiles, if tile chains exist.
  void make(bool wantsTiles);
  /// Computes the schedules again if launch parameters that affect them have
  /// changed.
  void update();
  /// Makes update() compute no schedule with tiles any more.
  void dropTiles() { wantsTiles = false; }

  /// Whether there are chains.
  bool hasTiles() const { return !tiled.units.empty(); }
  const Schedule &get(bool withTiles) const {
    return withTiles ? tiled : plain;
  }
  /// The launch shape for tiles: a block for each tile, and a thread for each
  /// cell of a tile.
  LaunchShape tileShape() const;
  /// The number of steps that run separately before the program.
  size_t countBefore() const { return numBefore; }
  /// The number of steps whose memory accesses are not known.
  size_t countUnknown() const { return numUnknown; }

  /// The steps with the numbers of their program parts, in the order of the
  /// schedule.
  std::vector<LoopStep> listSteps(bool withTiles) const;
  /// Adds to the plan the functions that run single iterations, numbered after
  /// the other parts, and the tile chains that call them.
  void addTiles(ProgramPlan &plan) const;
  std::string describe(const Unit &unit) const;
  std::string describeChains() const;

private:
  size_t countStepsBefore() const;
  void listDecisiveSlots();
  void makeTiled(const std::vector<StepMemory> &memory);

  const Device &device;
  const Sequence &sequence;
  /// plain: the schedule whose units are the steps of a program, one launch
  /// each. tiled: the schedule whose units are chains of steps that run tile by
  /// tile; empty if no steps form such a chain.
  Schedule plain, tiled;
  bool wantsTiles = false;
  /// All tile chains found so far, by number.
  std::vector<TileChain> chains;
  size_t numBefore = 0, numUnknown = 0;
  /// The slots that determine which memory the steps access, and the values of
  /// these slots when the schedules were computed.
  std::vector<size_t> decisiveSlots;
  std::vector<uint64_t> decisiveValues;
};

} // namespace mlir::tai::runtime::programs

#endif // TAI_LIB_RUNTIME_PROGRAMS_STEPSCHEDULES_H
