//===- ProgramSchedule.h - Order and barriers of steps ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_PROGRAMS_PROGRAMSCHEDULE_H
#define TAI_RUNTIME_PROGRAMS_PROGRAMSCHEDULE_H

#include "tai/ABI/DeviceAccesses.h"
#include "tai/Runtime/Device/Device.h"

namespace mlir::tai::runtime {

/// The accesses of a device function, prepared for queries about launches.
struct Footprint {
  explicit Footprint(const FunctionAccesses &accesses);

  /// Maps an iteration number to an address: the extents and the strides in
  /// bytes of its digits (one for each loop dimension), the fastest digit
  /// first, with contiguous digits merged.
  using Map = std::vector<std::pair<int64_t, int64_t>>;
  struct Line {
    DeviceAccess access;
    /// The range of addresses that an iteration accesses, relative to the first
    /// iteration's address.
    int64_t low = 0, high = 0;
    /// The map from iterations to addresses; empty if the accesses of each
    /// thread are not known.
    Map map;
  };
  std::vector<Line> lines;
  /// True if the loop of the device function has only one iteration.
  bool isSingle = false;
};

/// The memory that a step of a program accesses.
struct StepMemory {
  struct Piece {
    DeviceAccess::Kind kind;
    /// The address of the memory piece in the first iteration, and its range
    /// over all iterations.
    uint64_t first, begin, end;
    int64_t window, step, size;
    /// The map from iterations to addresses (Footprint::Line::map), or null.
    const Footprint::Map *map;
  };
  /// reads: pieces of memory that the step only reads. changes: pieces of
  /// memory that the step writes.
  std::vector<Piece> reads, changes;
  /// True if `reads` and `changes` cover all memory accesses of the step.
  bool isKnown = false;
  /// True if the first thread makes all memory accesses of the step.
  bool isSingle = false;

  static StepMemory ofLaunch(const Footprint *footprint, const uint64_t *slots,
                             size_t numSlots);
  /// Adds a range of memory for which the accesses of each thread are not
  /// known.
  void add(DeviceAccess::Kind kind, uint64_t begin, uint64_t bytes);
  /// Adds strided rows.
  void addRows(DeviceAccess::Kind kind, uint64_t begin, uint64_t step,
               uint64_t rowBytes, uint64_t rows);
  /// Adds an access to `count` numbers of `bytes` bytes, distributed to threads
  /// as in a grid-stride loop over the numbers.
  void addNumbers(DeviceAccess::Kind kind, uint64_t begin, int64_t bytes,
                  int64_t count);

private:
  void add(const Piece &piece) {
    (piece.kind == DeviceAccess::Read ? reads : changes).push_back(piece);
  }

  /// Owns a map from iterations to addresses that does not belong to a
  /// footprint.
  std::shared_ptr<Footprint::Map> ownMap;
};

/// True if a range of `bytes`, at `distance` after the start of an element,
/// lies between elements of `size` bytes that start every `step` bytes.
bool liesBetween(int64_t distance, int64_t bytes, int64_t size, int64_t step);

/// The order in which a program runs its steps, and the barriers between them.
struct ProgramSchedule {
  ProgramSchedule() = default;
  explicit ProgramSchedule(const std::vector<StepMemory> &steps);

  /// The numbers of the steps, in the order of execution.
  std::vector<uint32_t> order;
  /// For each position in the order: true if a barrier follows the step.
  std::vector<bool> waits;
  /// The number of barriers.
  size_t numBarriers = 0;
};

/// The dependence of a step on an earlier one.
enum class StepRelation {
  /// The steps are independent: they may be reordered.
  None,
  /// Program order within each thread is enough to keep the dependence between
  /// the steps.
  SameThread,
  /// A barrier is needed between the steps.
  Barrier
};
StepRelation getRelation(const StepMemory &a, const StepMemory &b);

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_PROGRAMS_PROGRAMSCHEDULE_H
