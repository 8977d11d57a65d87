//===- TapeTopology.h - What a tape knows of activity -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Which cells of sparse levels are active is memory that launches change, and
// that adjoints read: loops go over active cells, `is_active` and `length` are
// values, and adjoints are added to active cells alone. So the tape keeps what
// each record changed, as lists of cells, and the reverse sweep goes through
// the same states of activity backwards, and forward again when it is done.
//
// What cells hold is the business of TapeMemory: here only bits and lengths
// change. Adjoints of cells stay where they are while the cells are inactive,
// as do those of a dense field; where cells were deactivated, that overwrote
// them with zeros, and their adjoints become zero.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_MEMORY_TAPETOPOLOGY_H
#define TAI_LIB_RUNTIME_TAPE_MEMORY_TAPETOPOLOGY_H

#include "tai/Runtime/Launch/Runtime.h"
#include "tai/Runtime/Sparse/LoopLists.h"

namespace mlir::tai::runtime {

class TapeTopology {
public:
  explicit TapeTopology(Runtime &runtime) : runtime(runtime) {}
  ~TapeTopology() { noteRemovals(false); }

  //===--------------------------------------------------------------------===//
  // Forward
  //===--------------------------------------------------------------------===//

  /// Before anything that may change activity in the tree.
  void watch(const TreePtr &tree);
  /// After a record: keeps what it has changed, and what its loops went over.
  void settle(uint32_t record);
  void noteLoops(uint32_t record, const LoopLists &lists);
  /// Starts a forward replay of the same records.
  void restart();
  /// After the last record.
  void end();

  //===--------------------------------------------------------------------===//
  // Reverse
  //===--------------------------------------------------------------------===//

  /// Fails if a tree has been destroyed, or cells were deactivated since.
  Status check() const;
  void beginReverse() { settle(kEnd); }
  /// Makes activity what it was before the record, or after it.
  void goBefore(uint32_t record) { seek(record); }
  void goAfter(uint32_t record) { seek(record + 1); }
  /// The same for the sweep: adjoints of what was deactivated later are zero
  /// from then on.
  void enter(uint32_t record);
  /// Before and after the record is run again, from the state before it. The
  /// adjoints of what it deactivates are those of a later time, and stay.
  void runsAgain(uint32_t record);
  void ranAgain(uint32_t record);
  /// Makes activity what it was after all records. Adds a line to `notes` where
  /// adjoints were lost.
  void endReverse(std::vector<std::string> &notes);

  const LoopLists *loopsAt(uint32_t record) const {
    auto found = loops.find(record);
    return found == loops.end() ? nullptr : &found->second;
  }
  /// Whether the record has changed the activity of the level.
  bool changes(uint32_t record, const SparseNode &node) const;
  bool empty() const { return changed.empty(); }
  bool watchesNothing() const { return watched.empty(); }

private:
  static constexpr uint32_t kEnd = UINT32_MAX - 1;
  struct Watched {
    TreePtr tree;
    SparseNode *node;
    /// Now, and before the first record.
    ActiveListPtr known, first;
    /// All cells that a record has found or made active.
    std::vector<int64_t> ever = {};
  };
  /// What a record did to one level.
  struct Change {
    uint32_t record;
    SparseNode *node;
    std::vector<int64_t> added, removed;
    /// Those that were active before and have been inactive since.
    std::vector<int64_t> cleared;
  };

  std::vector<Change>::const_iterator firstAt(uint32_t record) const;
  void update(Watched &entry, uint32_t record);
  /// Where the tree is on a device, leaves that until somebody asks. False
  /// where it is better done at once.
  bool updateLater(const TreePtr &tree, uint32_t record);
  void add(Change change);
  /// Makes activity what it was after this many records.
  void seek(uint32_t position);
  void clearAdjoints(const Change &change);
  /// Zeroes the adjoints in cells that are inactive after all records. Returns
  /// how many held the gradient by what the field held before the first.
  int64_t dropAdjoints(const Change &change, Field &field,
                       size_t firstPassed) const;
  void noteRemovals(bool on);
  /// Calls body(field) for the adjoints that lie in cells of the level.
  template <typename Body>
  void forEachAdjoint(const SparseNode &node, const Body &body) const;
  /// The same as body(values, cells) for those in the memory that a record
  /// clears; those of other times are there, too.
  template <typename Body>
  void forEachCleared(uint32_t record, const Body &body) const;
  void findEver();

  Runtime &runtime;
  std::vector<Watched> watched;
  /// In the order of their records; those from `cursor` on are undone, and the
  /// sweep has passed those from `passed` on.
  std::vector<Change> changed;
  size_t cursor = 0;
  size_t passed = 0;
  std::unordered_map<uint32_t, LoopLists> loops;
  std::vector<char> keptAdjoints;
  bool knowsEver = false;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_MEMORY_TAPETOPOLOGY_H
