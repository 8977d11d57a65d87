//===- Sparse.h - Activity of sparse levels ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Every cell of a sparse level has a fixed address; separate bits mark active
// cells, and memory of inactive cells is zero. Cells are numbered row-major,
// level by level, so that the cells below one cell are consecutive.
//
// Activation may happen on many threads at once. Deactivation may too, but a
// cell must not be activated and deactivated at the same time.
//
// If the tree is on a device, device code changes activity too; queries here
// then wait for the device.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_SPARSE_SPARSE_H
#define TAI_RUNTIME_SPARSE_SPARSE_H

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <unordered_set>
#include <vector>

namespace mlir::tai {
class SkipCounters;
class SkipSet;
} // namespace mlir::tai

namespace mlir::tai::runtime {

class SparseNode;
class Workers;

/// The services that lists of active cells need on the host.
struct ListMaker {
  Workers &workers;
  const SkipSet &skips;
  SkipCounters &counters;
};

/// The memory of a tree's cells, and how much of it is active.
struct CellMemory {
  /// Null once the tree has been destroyed.
  char *base = nullptr;
  /// Bytes of active cells of the innermost levels: of this tree, and of all
  /// trees.
  std::atomic<int64_t> activeBytes{0};
  std::atomic<int64_t> *allActiveBytes = nullptr;
  const ListMaker *lists = nullptr;
  /// Regions for which large pages have been requested, by number.
  std::unordered_set<uintptr_t> largePages;
  std::mutex largePagesMutex;
};

/// The interface to the sparse levels of a tree on a device.
class SparseOnDevice {
public:
  virtual ~SparseOnDevice() = default;
  /// Fetches the activity, if the host's knowledge is stale.
  virtual void bringActivity() = 0;
  /// Call before the host changes activity (`removes`: deactivates cells):
  /// makes the host current and the device stale.
  virtual void hostChanges(bool removes) = 0;
  /// Whether the memory of the device is current.
  virtual bool isCurrent() const = 0;
  /// Whether the host's knowledge of activity is stale.
  virtual bool isBehind() const = 0;
  /// The number of the current state of activity, and of the state at which
  /// cells were last deactivated, as far as the host knows.
  virtual uint64_t getGeneration() const = 0;
  virtual uint64_t getLastRemoval() const = 0;
  /// Deactivates all cells of a level on the device too, after the host. False
  /// if the device should be updated by an upload instead.
  virtual bool deactivateAll(SparseNode &node) = 0;
  /// Uploads the activity of a level to a device that is current except for the
  /// words of bits, or the lengths, in `changed`.
  virtual void uploadActivity(const SparseNode &node,
                              const std::vector<int64_t> &changed) = 0;
};

/// The layout of a sparse level.
struct SparseInfo {
  /// For messages: "the 'pointer' level above @x, @v".
  std::string label;
  /// True for a `dynamic` level: the active cells of each list are its first.
  bool isList = false;
  /// The nearest sparse level above, or -1.
  int parent = -1;
  /// One step for each level from the root to this one: its cells below one
  /// parent cell, and the distance between them in bytes.
  struct Step {
    int64_t cells;
    int64_t stride;
  };
  std::vector<Step> steps;
  int64_t offset = 0;         // of cell 0 in the tree
  int64_t activityOffset = 0; // of the bits, or of the lengths
};

/// The active cells of a level, ascending.
struct ActiveList {
  std::vector<int64_t> cells;
  uint64_t epoch = 0;
};
using ActiveListPtr = std::shared_ptr<const ActiveList>;

class SparseNode {
public:
  SparseNode(CellMemory &memory, SparseInfo info, SparseNode *parent);
  ~SparseNode();
  SparseNode(const SparseNode &) = delete;
  SparseNode &operator=(const SparseNode &) = delete;

  const SparseInfo &info() const { return layout; }
  bool isInnermost() const { return children.empty(); }
  int64_t numCells() const { return cells; }
  /// Bytes of one cell.
  int64_t cellBytes() const { return layout.steps.back().stride; }
  /// Cells of this level below one cell of `above`.
  int64_t numCellsBelow() const { return cellsBelow; }
  /// Whether a cell consists of cells of the next levels alone.
  bool holdsCellsAlone() const;
  /// The offset of a cell in the tree, in bytes.
  int64_t offsetOf(int64_t cell) const;
  /// Bytes of the bits or lengths.
  int64_t activityBytes() const;
  int64_t numActive() const {
    sync();
    return active.load(std::memory_order_relaxed);
  }
  /// The maximum of cells active at any time; on a device, at the times when
  /// the host fetched activity.
  int64_t peakActive() const {
    sync();
    return peak.load(std::memory_order_relaxed);
  }
  /// Changes with every change of activity.
  uint64_t epoch() const {
    sync();
    return changes.load(std::memory_order_acquire);
  }
  /// The epoch that began when a cell was last deactivated; 0 for never.
  uint64_t lastRemoval() const {
    sync();
    return removed.load(std::memory_order_acquire);
  }
  SparseNode *above() const { return parent; }

  /// A point in time, taken without waiting for a device.
  struct Moment {
    uint64_t epoch;
    /// On a device: SparseOnDevice::getGeneration, and whether the host's
    /// knowledge was current.
    uint64_t generation;
    bool isKnown;
  };
  Moment now() const;
  /// Whether activity has changed, or a cell has been deactivated, since
  /// `moment`. Conservative for a moment at which the host's knowledge was
  /// stale: a change before the moment may count as a change after it.
  bool hasChangedSince(const Moment &moment) const;
  bool hasRemovedSince(const Moment &moment) const;
  /// False if it is certain, without waiting for a device, that no cell is
  /// active.
  bool mayBeActive() const;

  /// Turns recording of deactivated cells on or off, for a tape.
  void noteRemovals(bool on);
  /// The recorded cells since the last call, in any order.
  std::vector<int64_t> takeRemovals();

  bool isActive(int64_t cell) const;
  /// Activates the cell and its ancestors; in a list, also the cells before it.
  /// Returns true if anything changed.
  bool activate(int64_t cell);
  /// Deactivates and zeroes the cell with all its descendants. In a list, this
  /// applies to the whole list.
  void deactivate(int64_t cell);
  void deactivateAll();
  /// Changes the activity of this level alone, back to an earlier state,
  /// without touching the memory of cells: for a tape, which restores the
  /// memory itself.
  void setActivity(const std::vector<int64_t> &some, bool isActive);

  /// length: the length of a list. append: returns the number of the new cell
  /// within the list, or -1 if the list is full.
  int64_t length(int64_t list) const;
  int64_t append(int64_t list);
  int64_t capacity() const { return layout.steps.back().cells; }

  /// The currently active cells. Cached until activity changes.
  ActiveListPtr list();
  int64_t listsMade() const { return made; }
  int64_t listsReused() const { return reused; }

  //===--------------------------------------------------------------------===//
  // For the same level on a device
  //===--------------------------------------------------------------------===//

  /// Sets the levels on the device; null for none.
  void setOnDevice(SparseOnDevice *levels) { onDevice = levels; }
  /// The host's knowledge, without waiting for the device.
  int64_t knownActive() const { return active.load(std::memory_order_relaxed); }
  uint64_t knownEpoch() const {
    return changes.load(std::memory_order_acquire);
  }
  void forEachKnown(const std::function<void(int64_t)> &body) const;
  /// One bit for each word of bits, or each length, that may be non-zero; in
  /// words of 64 bits.
  const std::atomic<uint64_t> *marked() const { return marks; }
  int64_t numMarked() const { return numMarks; }
  /// A range of words of bits, or of lengths, from a device, and the cells that
  /// it has deactivated since the last fetch, or null.
  struct Part {
    int64_t first, count;
    const void *activity, *gone;
  };
  /// The changes found by `adopt`: the net number of cells activated, whether
  /// activity differs at all, and whether cells were deactivated.
  struct Adopted {
    int64_t by = 0;
    bool differs = false, removes = false;
  };
  /// Takes over the activity of a part. Calls `added` for cells that may have
  /// become active.
  void adopt(const Part &part, Adopted &adopted,
             const std::function<void(int64_t)> &added);
  void changed(int64_t by, bool removes);
  /// Counts a list that was computed, or reused, on the device.
  void countList(bool isReused) { ++(isReused ? reused : made); }

private:
  /// Fetches activity from a device.
  void sync() const {
    if (__builtin_expect(onDevice != nullptr, false))
      onDevice->bringActivity();
  }
  /// Call before the host changes activity.
  void prepare(bool removes) {
    if (__builtin_expect(onDevice != nullptr, false))
      onDevice->hostChanges(removes);
  }
  bool holds(int64_t cell) const;
  uint64_t *words() const;
  int32_t *lengths() const;
  char *addressOf(int64_t cell) const;
  /// Clears the activity of the cells [first, first + count), descendants of a
  /// cell that is being deactivated.
  void clearRange(int64_t first, int64_t count);
  void zero(int64_t cell);
  void noteRemoved(int64_t first, int64_t count);
  void useLargePages(const ActiveList &list);
  void markWord(int64_t word);
  /// Appends the active cells covered by the marks [begin, end).
  void collectInto(std::vector<int64_t> &found, int64_t begin,
                   int64_t end) const;

  CellMemory &memory;
  SparseOnDevice *onDevice = nullptr;
  SparseInfo layout;
  SparseNode *parent;
  std::vector<SparseNode *> children;
  int64_t cells = 1;
  /// Cells of this level below one cell of `parent`.
  int64_t cellsBelow = 1;
  /// One bit for each word of bits that has been non-zero (conservative).
  std::atomic<uint64_t> *marks = nullptr;
  int64_t numMarks = 0;
  std::atomic<int64_t> active{0}, peak{0};
  std::atomic<uint64_t> changes{1};
  std::atomic<uint64_t> removed{0};
  std::atomic<bool> notesRemovals{false};
  std::vector<int64_t> removals;
  std::mutex mutex;
  ActiveListPtr current;
  std::atomic<int64_t> made{0}, reused{0};
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_SPARSE_SPARSE_H
