//===- Checkpoints.h - Snapshots in place of saved values -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Snapshots of what launches change. A snapshot at a record holds the contents,
// as they were there, of all cells that change from it to the next: they are
// copied when they are first changed. To go back to a record is to put back
// the snapshots from the last one to that one.
//
// How many records there will be is not known while they are recorded. So the
// first snapshots are dense, and whenever there are too many of them, each
// second one is merged into the one before.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_MEMORY_CHECKPOINTS_H
#define TAI_LIB_RUNTIME_TAPE_MEMORY_CHECKPOINTS_H

#include "Track.h"
#include "tai/Runtime/Tape/TapeTypes.h"

namespace mlir::tai::runtime {

/// Steps that have to be run again, at least, to go through `steps` of them in
/// reverse with this many snapshots, the one at the start among them.
int64_t binomialCost(int64_t steps, int64_t snapshots);
/// Where to put the next snapshot to meet that number.
int64_t binomialSplit(int64_t steps, int64_t snapshots);

class Checkpoints {
public:
  Checkpoints(Runtime &runtime, CheckpointPolicy policy)
      : runtime(runtime), policy(policy) {}

  const CheckpointPolicy &getPolicy() const { return policy; }

  /// Forgets all snapshots: the sequence is about to run from its start.
  void restart();
  /// Called before each record while the sequence first runs: takes a snapshot
  /// where one is due.
  void reach(uint32_t record);
  /// Copies a slab that is about to change, and after the launch forgets what
  /// did not.
  Status log(Track &track, int64_t slab);
  void settle();

  /// Takes a snapshot at a record, on top of the others.
  void push(uint32_t record);
  /// Makes memory what it was at the topmost one.
  void restore();
  /// Gives up the topmost one; memory is that of its record.
  void pop();
  int64_t count() const { return static_cast<int64_t>(logs.size()); }
  uint32_t start(int64_t number) const { return logs[number].start; }
  uint32_t topStart() const { return logs.back().start; }
  /// What the topmost snapshot may still grow by.
  int64_t growth() const { return largest - logs.back().bytes; }

  /// Keeps what the fields hold at the end, and puts it back.
  Status keepFinal();
  void restoreFinal();

  /// Bytes of the largest snapshot and of all of them with what the fields hold
  /// at the end; most snapshots at any time.
  int64_t snapshotBytes() const { return largest; }
  int64_t bytes() const { return total; }
  int64_t mostSnapshots() const { return most; }
  /// Fails if the budget cannot even hold the least that is needed.
  Status checkBudget(int64_t leafBytes) const;

private:
  struct Log {
    uint32_t start;
    uint32_t id;
    int64_t bytes = 0;
    /// Later ones hold what is older.
    std::vector<Piece> pieces;
  };
  void mergeIntoPrevious(size_t index);
  void thin();
  bool tooMany() const;

  Runtime &runtime;
  CheckpointPolicy policy;
  std::vector<Log> logs;
  std::vector<Piece> finals;
  size_t unsettled = 0;
  /// Sparse fields that the record which runs may extend.
  std::vector<Track *> growing;
  uint32_t ids = 0;
  uint32_t stride = 1;
  int64_t total = 0;
  int64_t largest = 0;
  int64_t most = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_MEMORY_CHECKPOINTS_H
