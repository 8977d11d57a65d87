//===- TapeTopology.h - The history of activity -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The activity of sparse levels is memory that launches change and adjoints
// read: loops visit active cells, `is_active` and `length` are values, and
// adjoints are added to active cells only. So the tape records the changes of
// each record, as lists of cells, and the reverse sweep restores the same
// states of activity backwards, and finally the last one.
//
// The contents of cells are handled by TapeMemory: here only bits and lengths
// change. Adjoints of cells stay in place while the cells are inactive, like
// those of a dense field; deactivation overwrites a cell with zeros, so its
// adjoint becomes zero.
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

  /// Follows the activity of the tree from now on. Must be called before any
  /// action that may change the activity.
  void watch(const TreePtr &tree);
  /// Record a change of activity by the record that has just run. settle:
  /// records the changes of activity. noteLoops: records the cells that the
  /// loops of a launch visited.
  void settle(uint32_t record);
  void noteLoops(uint32_t record, const LoopLists &lists);
  /// Starts a forward replay of the same records, whose activity changes are
  /// known.
  void restart();
  /// Ends the recording of activity. Must be called after the last record.
  void end();

  //===--------------------------------------------------------------------===//
  // Reverse
  //===--------------------------------------------------------------------===//

  /// Fails if a tree has been destroyed, or cells were deactivated since the
  /// sequence ran.
  Status check() const;
  void beginReverse() { settle(kEnd); }
  /// Restores the activity of cells to its state before or after the record.
  void goBefore(uint32_t record) { seek(record); }
  void goAfter(uint32_t record) { seek(record + 1); }
  /// Restores the activity to its state after the record, for the sweep: also
  /// zeroes adjoints of cells that later records deactivated.
  void enter(uint32_t record);
  /// Must be called before and after the record is re-executed from the state
  /// before it. These functions keep the adjoints of cells that the record
  /// deactivates, since these adjoints belong to later records.
  void beginReexecution(uint32_t record);
  void endReexecution(uint32_t record);
  /// Restores the activity to its state after all records. Adds a line to
  /// `notes` if adjoints were lost.
  void endReverse(std::vector<std::string> &notes);

  const LoopLists *loopsAt(uint32_t record) const {
    auto found = loops.find(record);
    return found == loops.end() ? nullptr : &found->second;
  }
  /// True if the record has changed the activity of the level.
  bool changes(uint32_t record, const SparseNode &node) const;
  bool empty() const { return changed.empty(); }
  bool watchesNothing() const { return watched.empty(); }

private:
  static constexpr uint32_t kEnd = UINT32_MAX - 1;
  struct Watched {
    TreePtr tree;
    SparseNode *node;
    /// known: the cells that were active at the last update. first: the cells
    /// that were active before the first record.
    ActiveListPtr known, first;
    /// All cells of the level that were active at any record.
    std::vector<int64_t> ever = {};
  };
  /// The changes of activity in one level by a record.
  struct Change {
    uint32_t record;
    SparseNode *node;
    std::vector<int64_t> added, removed;
    /// Cells that were active before and have been inactive at some time since.
    std::vector<int64_t> cleared;
  };

  std::vector<Change>::const_iterator firstAt(uint32_t record) const;
  void update(Watched &entry, uint32_t record);
  /// Defers the update of the list of changes, if the tree is on a device.
  /// False if it must be done at once.
  bool updateLater(const TreePtr &tree, uint32_t record);
  void add(Change change);
  /// Restores the activity to its state after the first `position` records.
  void seek(uint32_t position);
  void clearAdjoints(const Change &change);
  /// Zeroes the adjoints in cells that are inactive after all records. Returns
  /// how many held the gradient with respect to the initial value of the field.
  int64_t dropAdjoints(const Change &change, Field &field,
                       size_t firstPassed) const;
  void noteRemovals(bool on);
  /// Calls body(field) for each adjoint field that has elements in cells of the
  /// level.
  template <typename Body>
  void forEachAdjoint(const SparseNode &node, const Body &body) const;
  /// Calls body(values, cells) for each adjoint field in the memory that a
  /// record clears. `cells`: all cells there that are active at any record.
  template <typename Body>
  void forEachCleared(uint32_t record, const Body &body) const;
  void findEver();

  Runtime &runtime;
  std::vector<Watched> watched;
  /// The changes of activity, in the order of records. Changes from `cursor` on
  /// are undone, and the sweep has passed the changes from `passed` on.
  std::vector<Change> changed;
  size_t cursor = 0;
  size_t passed = 0;
  std::unordered_map<uint32_t, LoopLists> loops;
  std::vector<char> keptAdjoints;
  bool knowsEver = false;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_MEMORY_TAPETOPOLOGY_H
