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
  /// Base address of the tree's memory; null once the tree has been destroyed.
  char *base = nullptr;
  /// Bytes of the active cells of the innermost sparse levels: in this tree,
  /// and in all trees.
  std::atomic<int64_t> activeBytes{0};
  std::atomic<int64_t> *allActiveBytes = nullptr;
  const ListMaker *lists = nullptr;
  /// The regions for which large pages have been requested, by number of the
  /// region.
  std::unordered_set<uintptr_t> largePages;
  std::mutex largePagesMutex;
};

/// The interface to the sparse levels of a tree on a device.
class SparseOnDevice {
public:
  virtual ~SparseOnDevice() = default;
  /// Fetches the activity from the device, if the host's copy is stale.
  virtual void bringActivity() = 0;
  /// Makes the activity on the host current and on the device stale. Must be
  /// called before the host changes activity (`removes`: deactivates cells).
  virtual void hostChanges(bool removes) = 0;
  /// True if the activity in the device's memory is current.
  virtual bool isCurrent() const = 0;
  /// True if the host's copy of the activity is stale.
  virtual bool isBehind() const = 0;
  /// Numbers of states of activity, as far as the host knows: of the current
  /// state, and of the state at which cells were last deactivated.
  virtual uint64_t getGeneration() const = 0;
  virtual uint64_t getLastRemoval() const = 0;
  /// Deactivates all cells of a level on the device too, after the host has
  /// done so. False if the device should be updated by an upload instead.
  virtual bool deactivateAll(SparseNode &node) = 0;
  /// Uploads the activity of a level to a device that is current except for the
  /// words of bits, or the lengths, in `changed`.
  virtual void uploadActivity(const SparseNode &node,
                              const std::vector<int64_t> &changed) = 0;
};

/// Describes the layout of a sparse level.
struct SparseInfo {
  /// The name of the level for messages: "the 'pointer' level above @x, @v".
  std::string label;
  /// True for a `dynamic` level: the active cells of each list are its first.
  bool isList = false;
  /// The number of the nearest sparse level above, or -1.
  int parent = -1;
  /// For each level on the path from the root to this level: the number of its
  /// cells below one parent cell, and the distance in bytes between them.
  struct Step {
    int64_t cells;
    int64_t stride;
  };
  std::vector<Step> steps;
  int64_t offset = 0;         // of cell 0 in the tree
  int64_t activityOffset = 0; // of the bits, or of the lengths
};

/// The list of active cells of a sparse level, ascending.
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
  /// The size of a cell of this level in bytes.
  int64_t cellBytes() const { return layout.steps.back().stride; }
  /// The number of cells of this level below one cell of the next sparse level
  /// above.
  int64_t numCellsBelow() const { return cellsBelow; }
  /// True if cells of this level consist of cells of further sparse levels, and
  /// hold no elements themselves.
  bool holdsCellsAlone() const;
  /// The offset of a cell's memory from the base of the tree, in bytes.
  int64_t offsetOf(int64_t cell) const;
  /// The size in bytes of the level's activity: a bit for each cell, or, for a
  /// level of lists, the length of each list.
  int64_t activityBytes() const;
  int64_t numActive() const {
    sync();
    return active.load(std::memory_order_relaxed);
  }
  /// The largest number of cells that have been active at once. On a device,
  /// counted only when the host fetches the activity.
  int64_t peakActive() const {
    sync();
    return peak.load(std::memory_order_relaxed);
  }
  /// A number that changes whenever the activity of the level changes.
  uint64_t epoch() const {
    sync();
    return changes.load(std::memory_order_acquire);
  }
  /// The epoch() that began when a cell was last deactivated; 0 if none ever
  /// was.
  uint64_t lastRemoval() const {
    sync();
    return removed.load(std::memory_order_acquire);
  }
  SparseNode *above() const { return parent; }

  /// A state of the level's activity, noted without waiting for a device.
  struct Moment {
    uint64_t epoch;
    /// With a device: the value of SparseOnDevice::getGeneration, and whether
    /// the host's copy of the activity was current.
    uint64_t generation;
    bool isKnown;
  };
  Moment now() const;
  /// True if the level's activity has changed, or a cell of it has been
  /// deactivated, since `moment`. Conservative if the host's copy of the
  /// activity was stale at that moment: a change before the moment may count as
  /// after it.
  bool hasChangedSince(const Moment &moment) const;
  bool hasRemovedSince(const Moment &moment) const;
  /// False if certainly no cell of the level is active. Does not wait for a
  /// device.
  bool mayBeActive() const;

  /// Turns recording of deactivated cells on or off, for a tape.
  void noteRemovals(bool on);
  /// Returns the cells deactivated since the last call, while recording was on,
  /// in any order.
  std::vector<int64_t> takeRemovals();

  bool isActive(int64_t cell) const;
  /// Activates a cell and its ancestors; in a list, also the cells before it.
  /// Returns true if any cell was inactive.
  bool activate(int64_t cell);
  /// Deactivates and zeroes a cell with all its descendants. In a list, this
  /// applies to the whole list.
  void deactivate(int64_t cell);
  void deactivateAll();
  /// Sets the activity of the cells `some` of this level alone, without
  /// touching the memory of cells. For a tape that goes back to an earlier
  /// state, and restores the memory itself.
  void setActivity(const std::vector<int64_t> &some, bool isActive);

  /// For a level of lists. length: the length of one list. append: activates
  /// the cell after the last, and returns its position in the list, or -1 if
  /// the list is full.
  int64_t length(int64_t list) const;
  int64_t append(int64_t list);
  int64_t capacity() const { return layout.steps.back().cells; }

  /// The currently active cells, in ascending order. Cached until activity
  /// changes.
  ActiveListPtr list();
  int64_t listsMade() const { return made; }
  int64_t listsReused() const { return reused; }

  //===--------------------------------------------------------------------===//
  // Functions for the code that keeps this level on a device
  //===--------------------------------------------------------------------===//

  /// Sets the interface to the tree's sparse levels on a device; null for none.
  void setOnDevice(SparseOnDevice *levels) { onDevice = levels; }
  /// The number of active cells as the host knows it, possibly stale: does not
  /// wait for the device.
  int64_t knownActive() const { return active.load(std::memory_order_relaxed); }
  uint64_t knownEpoch() const {
    return changes.load(std::memory_order_acquire);
  }
  void forEachKnown(const std::function<void(int64_t)> &body) const;
  /// A bit set, in words of 64 bits: bit i is set if word i of the level's
  /// activity (64 bits of cells, or the length of one list) may be non-zero.
  const std::atomic<uint64_t> *marked() const { return marks; }
  int64_t numMarked() const { return numMarks; }
  /// Activity fetched from a device: words (bits of cells, or lengths of lists)
  /// `first` to `first + count` - 1, and in `gone` the cells that the device
  /// has deactivated since the last fetch, or null.
  struct Part {
    int64_t first, count;
    const void *activity, *gone;
  };
  /// Changes that `adopt` found: the number of cells activated less the number
  /// deactivated, whether any activity differs, and whether any cell was
  /// deactivated.
  struct Adopted {
    int64_t by = 0;
    bool differs = false, removes = false;
  };
  /// Replaces a part of the host's copy of the activity by activity fetched
  /// from a device. Calls `added` for cells that may have become active.
  void adopt(const Part &part, Adopted &adopted,
             const std::function<void(int64_t)> &added);
  void changed(int64_t by, bool removes);
  /// Counts a list of active cells that the device has computed, or reused.
  void countList(bool isReused) { ++(isReused ? reused : made); }

private:
  /// Fetches the activity from the device if it is newer there.
  void sync() const {
    if (__builtin_expect(onDevice != nullptr, false))
      onDevice->bringActivity();
  }
  /// Must be called before the host changes the activity (`removes`:
  /// deactivates cells).
  void prepare(bool removes) {
    if (__builtin_expect(onDevice != nullptr, false))
      onDevice->hostChanges(removes);
  }
  bool holds(int64_t cell) const;
  uint64_t *words() const;
  int32_t *lengths() const;
  char *addressOf(int64_t cell) const;
  /// Clears the activity of the cells [first, first + count). They are
  /// descendants of a cell that is being deactivated.
  void clearRange(int64_t first, int64_t count);
  void zero(int64_t cell);
  void noteRemoved(int64_t first, int64_t count);
  void useLargePages(const ActiveList &list);
  void markWord(int64_t word);
  /// Appends to `found` the active cells whose activity lies in the words that
  /// the bits [begin, end) of the set `marks` stand for.
  void collectInto(std::vector<int64_t> &found, int64_t begin,
                   int64_t end) const;

  CellMemory &memory;
  SparseOnDevice *onDevice = nullptr;
  SparseInfo layout;
  SparseNode *parent;
  std::vector<SparseNode *> children;
  int64_t cells = 1;
  /// The number of cells of this level below one cell of the parent level.
  int64_t cellsBelow = 1;
  /// Bit i is set if word i of the level's activity has ever been non-zero.
  /// Conservative: the word may be zero now.
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
