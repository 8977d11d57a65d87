//===- Checkpoints.h - Snapshots in place of saved values -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Incremental snapshots. A snapshot at a record holds the contents, at that
// time, of all cells that change between it and the next snapshot: they are
// copied before their first change. A record's state is restored by restoring
// the snapshots from the last one down to that record's.
//
// The number of records is not known while recording (online checkpointing). So
// the first snapshots are dense, and whenever there are too many, every second
// one is merged into the one before.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_MEMORY_CHECKPOINTS_H
#define TAI_LIB_RUNTIME_TAPE_MEMORY_CHECKPOINTS_H

#include "Track.h"
#include "tai/Runtime/Tape/TapeTypes.h"

namespace mlir::tai::runtime {

/// The minimum number of re-executed steps to reverse `steps` steps with this
/// many snapshots, including the one at the start.
int64_t binomialCost(int64_t steps, int64_t snapshots);
/// The position of the next snapshot in an optimal schedule for reversing
/// `steps` steps.
int64_t binomialSplit(int64_t steps, int64_t snapshots);

class Checkpoints {
public:
  Checkpoints(Runtime &runtime, CheckpointPolicy policy)
      : runtime(runtime), policy(policy) {}

  const CheckpointPolicy &chosenPolicy() const { return policy; }

  /// Drops all snapshots, before the sequence runs from its start.
  void restart();
  /// Drops all snapshots but the first, which covers all records; memory must
  /// be as at that snapshot. Nothing is lost if the sequence then fails before
  /// its end.
  void rewind();
  /// Takes a snapshot where one is due. Must be called before each record while
  /// the sequence first runs.
  void reach(uint32_t record);
  /// Copies slabs (parts of a field) to the snapshot before they may change;
  /// after the launch, settle drops the copies of cells that did not change.
  Status log(Track &track, SlabRange range);
  void settle();
  /// True if some snapshot was copied outside forward mode, and so lacks
  /// tangents.
  bool lackTangents() const { return lacksTangents; }

  /// Pushes a new snapshot, of the memory before a record.
  void push(uint32_t record);
  /// Restores memory to the topmost snapshot. Fails if the host interrupts the
  /// restoration; then only the final contents can be restored.
  Status restore();
  /// Drops the topmost snapshot, after restore() or before restoreFinal().
  void pop();
  int64_t count() const { return static_cast<int64_t>(logs.size()); }
  uint32_t start(int64_t number) const { return logs[number].start; }
  uint32_t topStart() const { return logs.back().start; }
  /// An estimate, in bytes, by which the topmost snapshot may still grow.
  int64_t growth() const { return largest - logs.back().bytes; }

  /// Save the contents of the fields at the end, and restore them. A failed
  /// save keeps nothing. A restoration cannot be interrupted.
  Status keepFinal();
  void restoreFinal();

  /// Bytes of the largest snapshot; bytes of all snapshots and of the final
  /// contents; the maximum number of snapshots so far.
  int64_t snapshotBytes() const { return largest; }
  int64_t bytes() const { return total + finalBytes; }
  int64_t mostSnapshots() const { return most; }
  /// Fails if the memory budget is below the minimum that is needed.
  Status checkBudget(int64_t leafBytes) const;

private:
  struct Log {
    uint32_t start;
    uint32_t id;
    int64_t bytes = 0;
    /// Copies of memory contents; if two of them overlap, the later one holds
    /// older contents.
    std::vector<Piece> pieces;
  };
  Status logOne(Track &track, SlabRange range);
  Status copyFinals();
  void mergeIntoPrevious(size_t index);
  void thin();
  bool tooMany() const;

  Runtime &runtime;
  CheckpointPolicy policy;
  std::vector<Log> logs;
  std::vector<Piece> finals;
  size_t unsettled = 0;
  bool lacksTangents = false;
  /// The memory of sparse fields in which the running record may activate
  /// cells.
  std::vector<Track *> growing;
  uint32_t ids = 0;
  uint32_t stride = 1;
  /// The bytes of the snapshots, and of the final contents.
  int64_t total = 0, finalBytes = 0;
  int64_t largest = 0;
  int64_t most = 0;
  /// Checks for interrupts by the host during copies and comparisons.
  CopySafepoints safepoints;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_MEMORY_CHECKPOINTS_H
