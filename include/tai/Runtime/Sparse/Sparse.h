//===- Sparse.h - Which cells of a tree are active --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Every cell of a sparse level has a fixed address; bits beside the cells say
// which are active, and memory of inactive cells is zero. Cells are numbered
// row-major, level below level, so that the cells below one cell are
// consecutive.
//
// Activation may happen on many threads at once. Deactivation may too, but a
// cell must not be activated and deactivated at the same time.
//
// Where the tree is on a device, code there changes activity too: whoever asks
// here then waits for it.
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

/// Who makes lists of active cells on the host.
struct ListMaker {
  Workers &workers;
  const SkipSet &skips;
  SkipCounters &counters;
};

/// The memory of the cells of a tree, and how much of it is active.
struct CellMemory {
  /// Null once the tree has been destroyed.
  char *base = nullptr;
  /// Of the cells of the innermost levels; and the same of all trees.
  std::atomic<int64_t> activeBytes{0};
  std::atomic<int64_t> *allActiveBytes = nullptr;
  const ListMaker *lists = nullptr;
  /// Regions that have been asked to lie in large pages, by their number.
  std::unordered_set<uintptr_t> largePages;
  std::mutex largePagesMutex;
};

/// The sparse levels of a tree on a device, which changes activity there.
class SparseOnDevice {
public:
  virtual ~SparseOnDevice() = default;
  /// Makes what the host knows of activity current.
  virtual void bringActivity() = 0;
  /// The host is about to change activity, or to remove cells: it is where the
  /// contents are current from then on.
  virtual void hostChanges(bool removes) = 0;
  /// Whether the memory of the device is current.
  virtual bool isCurrent() const = 0;
  /// Whether the host does not know what is active.
  virtual bool isBehind() const = 0;
  /// How many states there have been, and the one at which cells were last made
  /// inactive, as far as the host knows.
  virtual uint64_t getGeneration() const = 0;
  virtual uint64_t getLastRemoval() const = 0;
  /// Makes all cells of a level inactive there, as the host does on its side.
  /// False where that is better done on the host alone.
  virtual bool deactivateAll(SparseNode &node) = 0;
  /// Brings the activity of a level to the device, which is current but for
  /// these words of bits, or lengths, which both sides have known as others.
  virtual void uploadActivity(const SparseNode &node,
                              const std::vector<int64_t> &changed) = 0;
};

/// How a sparse level is laid out.
struct SparseInfo {
  /// For messages: "the 'pointer' level above @x, @v".
  std::string label;
  /// True for a `dynamic` level: the active cells of each list are its first.
  bool isList = false;
  /// The nearest sparse level above, or -1.
  int parent = -1;
  /// For each level from the root to this one: its cells below one cell of the
  /// level above, and the distance between them in bytes.
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
  /// Whether a cell consists of cells of the levels next below.
  bool holdsCellsAlone() const;
  /// Where a cell is in the tree.
  int64_t offsetOf(int64_t cell) const;
  /// Bytes of the bits or lengths.
  int64_t activityBytes() const;
  int64_t numActive() const {
    sync();
    return active.load(std::memory_order_relaxed);
  }
  /// The most cells that were active at any time; on a device, at any time when
  /// the host looked.
  int64_t peakActive() const {
    sync();
    return peak.load(std::memory_order_relaxed);
  }
  /// Changes with every change of activity.
  uint64_t epoch() const {
    sync();
    return changes.load(std::memory_order_acquire);
  }
  /// The epoch that began when a cell was last made inactive; 0 for never.
  uint64_t lastRemoval() const {
    sync();
    return removed.load(std::memory_order_acquire);
  }
  SparseNode *above() const { return parent; }

  /// A point in time, taken without waiting for a device.
  struct Moment {
    uint64_t epoch;
    /// Of a device: how many launches there had been that may change activity,
    /// and whether the host knew what they did.
    uint64_t generation;
    bool isKnown;
  };
  Moment now() const;
  /// Whether activity has changed, or a cell has been made inactive, since. Of
  /// what a device did around a moment that was not known, the answer may be
  /// true where only a launch before it did so, and one after it might have.
  bool hasChangedSince(const Moment &moment) const;
  bool hasRemovedSince(const Moment &moment) const;
  /// False if the host knows, without waiting, that nothing is active.
  bool mayBeActive() const;

  /// Whether to note which cells are made inactive, for a tape.
  void noteRemovals(bool on);
  /// Those since the last call, in any order.
  std::vector<int64_t> takeRemovals();

  bool isActive(int64_t cell) const;
  /// Makes the cell and those above it active; of a list, the cells before it
  /// too. Returns true if anything changed.
  bool activate(int64_t cell);
  /// Makes the cell inactive and zeroes it, with all that lies below. Of a
  /// list, that is the whole list.
  void deactivate(int64_t cell);
  void deactivateAll();
  /// Goes to another state of this level alone that there has been, with the
  /// memory of its cells left as it is: for a tape, which restores that itself.
  void setActivity(const std::vector<int64_t> &some, bool isActive);

  /// Of a list: its length, and one more cell at its end. Returns the number of
  /// the new cell within the list, or -1 if the list is full.
  int64_t length(int64_t list) const;
  int64_t append(int64_t list);
  int64_t capacity() const { return layout.steps.back().cells; }

  /// The active cells now. The list is kept until activity changes.
  ActiveListPtr list();
  int64_t listsMade() const { return made; }
  int64_t listsReused() const { return reused; }

  //===--------------------------------------------------------------------===//
  // For the same level on a device
  //===--------------------------------------------------------------------===//

  /// Null where there is none (any more).
  void setOnDevice(SparseOnDevice *levels) { onDevice = levels; }
  /// What the host knows, without waiting for the device.
  int64_t knownActive() const { return active.load(std::memory_order_relaxed); }
  uint64_t knownEpoch() const {
    return changes.load(std::memory_order_acquire);
  }
  void forEachKnown(const std::function<void(int64_t)> &body) const;
  /// One bit for each 64 words of bits, or lengths, that may not be zero.
  const std::atomic<uint64_t> *marked() const { return marks; }
  int64_t numMarked() const { return numMarks; }
  /// Words of bits, or lengths, from a certain one on, as a device has them,
  /// and what it has made inactive meanwhile, or null.
  struct Part {
    int64_t first, count;
    const void *activity, *gone;
  };
  /// What the host learns from them.
  struct Adopted {
    int64_t by = 0;
    bool differs = false, removes = false;
  };
  /// Goes there. Calls `added` for cells that may have become active.
  void adopt(const Part &part, Adopted &adopted,
             const std::function<void(int64_t)> &added);
  void changed(int64_t by, bool removes);
  /// A list was made, or used again, there.
  void countList(bool isReused) { ++(isReused ? reused : made); }

private:
  /// Makes what is known here current.
  void sync() const {
    if (__builtin_expect(onDevice != nullptr, false))
      onDevice->bringActivity();
  }
  /// To be called before the host changes activity.
  void prepare(bool removes) {
    if (__builtin_expect(onDevice != nullptr, false))
      onDevice->hostChanges(removes);
  }
  bool holds(int64_t cell) const;
  uint64_t *words() const;
  int32_t *lengths() const;
  char *addressOf(int64_t cell) const;
  /// Clears the activity of the cells [first, first + count), which lie below
  /// one cell that is being deactivated.
  void clearRange(int64_t first, int64_t count);
  void zero(int64_t cell);
  void noteRemoved(int64_t first, int64_t count);
  void useLargePages(const ActiveList &list);
  void markWord(int64_t word);
  /// Appends the active cells of which the marks [begin, end) speak.
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
  /// One bit for each word of bits that is not zero (it may be zero again).
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
