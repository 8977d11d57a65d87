//===- ProgramSchedule.h - Where steps wait for each other ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_QUEUE_PROGRAMSCHEDULE_H
#define TAI_LIB_RUNTIME_QUEUE_PROGRAMSCHEDULE_H

#include "tai/ABI/DeviceAccesses.h"
#include "tai/Runtime/Device/Device.h"

namespace mlir::tai::runtime {

/// What a device function touches, made ready to be asked for launches.
struct Footprint {
  explicit Footprint(const FunctionAccesses &accesses);

  /// How addresses follow the number of an iteration: extents and strides in
  /// bytes of its digits, the last one that counts first, neighbours that are
  /// one in memory as one.
  using Map = std::vector<std::pair<int64_t, int64_t>>;
  struct Line {
    DeviceAccess access;
    /// How far iterations reach from the address of the first.
    int64_t low = 0, high = 0;
    /// Empty where it does not say which thread touches what.
    Map map;
  };
  std::vector<Line> lines;
  /// There is one iteration.
  bool isSingle = false;
};

/// The memory that a step touches.
struct StepMemory {
  struct Piece {
    DeviceAccess::Kind kind;
    /// Of the first window, and of all of it.
    uint64_t first, begin, end;
    int64_t window, step, size;
    /// As in the footprint; null for none.
    const Footprint::Map *map;
  };
  /// Those that are read and nothing else, and the others.
  std::vector<Piece> reads, changes;
  /// Nothing else is touched.
  bool isKnown = false;
  /// The first thread does it all.
  bool isSingle = false;

  static StepMemory ofLaunch(const Footprint *footprint, const uint64_t *slots,
                             size_t numSlots);
  /// Adds bytes of which it is not known which thread touches them.
  void add(DeviceAccess::Kind kind, uint64_t begin, uint64_t bytes);
  /// Adds rows.
  void addRows(DeviceAccess::Kind kind, uint64_t begin, uint64_t step,
               uint64_t rowBytes, uint64_t rows);
  /// Adds numbers of so many bytes, each thread having its own as in a loop
  /// over them.
  void addNumbers(DeviceAccess::Kind kind, uint64_t begin, int64_t bytes,
                  int64_t count);

private:
  void add(const Piece &piece) {
    (piece.kind == DeviceAccess::Read ? reads : changes).push_back(piece);
  }

  /// Maps of pieces that no footprint has.
  std::shared_ptr<Footprint::Map> ownMap;
};

/// True if so many bytes, `distance` behind an element, lie between elements of
/// `size` bytes each of which is `step` behind the one before.
bool liesBetween(int64_t distance, int64_t bytes, int64_t size, int64_t step);

/// The order in which a program runs its steps.
struct ProgramSchedule {
  ProgramSchedule() = default;
  explicit ProgramSchedule(const std::vector<StepMemory> &steps);

  /// Numbers of steps.
  std::vector<uint32_t> order;
  /// For each place in that order: whether all threads meet after the step.
  std::vector<bool> waits;
  /// How often that is.
  size_t numBarriers = 0;
};

/// What one step must ask of an earlier one.
enum class StepRelation {
  /// Nothing: they may change places.
  None,
  /// That each thread runs them in this order.
  SameThread,
  /// That all threads are done with it.
  Barrier
};
StepRelation getRelation(const StepMemory &a, const StepMemory &b);

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_PROGRAMSCHEDULE_H
