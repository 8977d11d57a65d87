//===- Sparse.cpp - Activity of sparse levels -----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Sparse/Sparse.h"
#include "tai/Runtime/Threads/Workers.h"
#include "tai/Support/Skips.h"
#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <sys/mman.h>
#include <unistd.h>
#include <utility>

using namespace mlir::tai;
using namespace mlir::tai::runtime;

/// Atomic views of words in the memory of the tree, which compiled code reads
/// too.
static uint64_t loadWord(const uint64_t *word) {
  return __atomic_load_n(word, __ATOMIC_RELAXED);
}
static int32_t loadLength(const int32_t *length) {
  return __atomic_load_n(length, __ATOMIC_RELAXED);
}

SparseNode::SparseNode(CellMemory &memory, SparseInfo info, SparseNode *parent)
    : memory(memory), layout(std::move(info)), parent(parent) {
  for (const SparseInfo::Step &step : layout.steps)
    cells *= step.cells;
  cellsBelow = parent ? cells / parent->cells : cells;
  if (parent)
    parent->children.push_back(this);
  // `marks` has a bit for each word of 64 cells, or for each list.
  int64_t groups = layout.isList ? cells / capacity() : (cells + 63) / 64;
  numMarks = (groups + 63) / 64;
  marks = static_cast<std::atomic<uint64_t> *>(
      std::calloc(static_cast<size_t>(numMarks), sizeof(uint64_t)));
}

SparseNode::~SparseNode() { std::free(marks); }

uint64_t *SparseNode::words() const {
  return reinterpret_cast<uint64_t *>(memory.base + layout.activityOffset);
}

int32_t *SparseNode::lengths() const {
  return reinterpret_cast<int32_t *>(memory.base + layout.activityOffset);
}

char *SparseNode::addressOf(int64_t cell) const {
  return memory.base + offsetOf(cell);
}

int64_t SparseNode::offsetOf(int64_t cell) const {
  int64_t offset = layout.offset;
  for (size_t i = layout.steps.size(); i-- > 0;) {
    const SparseInfo::Step &step = layout.steps[i];
    offset += cell % step.cells * step.stride;
    cell /= step.cells;
  }
  return offset;
}

void SparseNode::markWord(int64_t word) {
  std::atomic<uint64_t> &mark = marks[word / 64];
  uint64_t bit = uint64_t(1) << (word % 64);
  if (!(mark.load(std::memory_order_relaxed) & bit))
    mark.fetch_or(bit, std::memory_order_relaxed);
}

void SparseNode::changed(int64_t by, bool removes) {
  int64_t now = active.fetch_add(by, std::memory_order_relaxed) + by;
  for (int64_t most = peak.load(std::memory_order_relaxed);
       now > most &&
       !peak.compare_exchange_weak(most, now, std::memory_order_relaxed);) {
  }
  if (children.empty()) {
    memory.activeBytes.fetch_add(by * cellBytes(), std::memory_order_relaxed);
    memory.allActiveBytes->fetch_add(by * cellBytes(),
                                     std::memory_order_relaxed);
  }
  uint64_t began = changes.fetch_add(1, std::memory_order_release) + 1;
  if (!removes)
    return;
  uint64_t last = removed.load(std::memory_order_relaxed);
  while (last < began && !removed.compare_exchange_weak(
                             last, began, std::memory_order_release)) {
  }
}

void SparseNode::noteRemovals(bool on) {
  sync();
  std::lock_guard<std::mutex> lock(mutex);
  notesRemovals.store(on, std::memory_order_release);
  removals.clear();
}

std::vector<int64_t> SparseNode::takeRemovals() {
  sync();
  std::lock_guard<std::mutex> lock(mutex);
  return std::exchange(removals, {});
}

void SparseNode::noteRemoved(int64_t first, int64_t count) {
  if (!notesRemovals.load(std::memory_order_relaxed))
    return;
  std::lock_guard<std::mutex> lock(mutex);
  for (int64_t cell = first; cell < first + count; ++cell)
    removals.push_back(cell);
}

void SparseNode::setActivity(const std::vector<int64_t> &some, bool isActive) {
  if (some.empty())
    return;
  sync();
  bool onBoth = onDevice && onDevice->isCurrent();
  if (!onBoth)
    prepare(/*removes=*/!isActive);
  int64_t by = 0;
  std::vector<int64_t> units;
  auto touches = [&](int64_t unit) {
    markWord(unit);
    if (onBoth && (units.empty() || units.back() != unit))
      units.push_back(unit);
  };
  for (int64_t cell : some) {
    if (layout.isList) {
      int32_t *length = lengths() + cell / capacity();
      auto position = static_cast<int32_t>(cell % capacity());
      int32_t wanted = isActive ? std::max(*length, position + 1)
                                : std::min(*length, position);
      by += wanted - *length;
      *length = wanted;
      touches(cell / capacity());
      continue;
    }
    uint64_t &word = words()[cell / 64];
    uint64_t bit = uint64_t(1) << (cell % 64);
    if (((word & bit) != 0) == isActive)
      continue;
    word ^= bit;
    by += isActive ? 1 : -1;
    touches(cell / 64);
  }
  if (by == 0)
    return;
  uint64_t before = lastRemoval();
  changed(by, by < 0);
  removed.store(before, std::memory_order_release);
  if (onBoth)
    onDevice->uploadActivity(*this, units);
}

//===----------------------------------------------------------------------===//
// Activity of one cell
//===----------------------------------------------------------------------===//

bool SparseNode::isActive(int64_t cell) const {
  sync();
  return holds(cell);
}

bool SparseNode::holds(int64_t cell) const {
  if (layout.isList)
    return cell % capacity() < loadLength(lengths() + cell / capacity());
  return loadWord(words() + cell / 64) >> (cell % 64) & 1;
}

bool SparseNode::activate(int64_t cell) {
  if (__builtin_expect(onDevice != nullptr, false)) {
    if (isActive(cell))
      return false;
    onDevice->hostChanges(/*removes=*/false);
  }
  if (layout.isList) {
    int32_t *length = lengths() + cell / capacity();
    int32_t wanted = static_cast<int32_t>(cell % capacity()) + 1;
    int32_t known = loadLength(length);
    while (known < wanted &&
           !__atomic_compare_exchange_n(length, &known, wanted, true,
                                        __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {
    }
    if (known >= wanted)
      return false;
    markWord(cell / capacity());
    changed(wanted - known, false);
  } else {
    uint64_t bit = uint64_t(1) << (cell % 64);
    uint64_t before =
        __atomic_fetch_or(words() + cell / 64, bit, __ATOMIC_RELAXED);
    if (before & bit)
      return false;
    markWord(cell / 64);
    changed(1, false);
  }
  if (parent)
    parent->activate(cell / cellsBelow);
  return true;
}

int64_t SparseNode::length(int64_t list) const {
  sync();
  return loadLength(lengths() + list);
}

int64_t SparseNode::append(int64_t list) {
  prepare(/*removes=*/false);
  int32_t *length = lengths() + list;
  int32_t known = loadLength(length);
  do {
    if (known >= capacity())
      return -1;
  } while (!__atomic_compare_exchange_n(length, &known, known + 1, true,
                                        __ATOMIC_RELAXED, __ATOMIC_RELAXED));
  markWord(list);
  changed(1, false);
  if (parent)
    parent->activate(list * capacity() / cellsBelow);
  return known;
}

/// Zeroes memory of deactivated cells, and gives whole pages of it back to the
/// system.
static void release(char *begin, int64_t bytes) {
  // A level without cells of its own has no memory.
  if (bytes == 0)
    return;
  static const int64_t page = sysconf(_SC_PAGESIZE);
  auto address = reinterpret_cast<intptr_t>(begin);
  intptr_t first = (address + page - 1) / page * page;
  intptr_t last = (address + bytes) / page * page;
  if (last - first < 2 * page) {
    std::memset(begin, 0, static_cast<size_t>(bytes));
    return;
  }
  std::memset(begin, 0, static_cast<size_t>(first - address));
  // The pages given back to the system read as zero from now on.
  madvise(reinterpret_cast<void *>(first), static_cast<size_t>(last - first),
          MADV_DONTNEED);
  std::memset(reinterpret_cast<void *>(last), 0,
              static_cast<size_t>(address + bytes - last));
}

void SparseNode::clearRange(int64_t first, int64_t count) {
  int64_t cleared = 0;
  if (layout.isList) {
    for (int64_t list = first / capacity(), end = (first + count) / capacity();
         list < end; ++list) {
      int32_t length =
          __atomic_exchange_n(lengths() + list, 0, __ATOMIC_RELAXED);
      noteRemoved(list * capacity(), length);
      cleared += length;
    }
  } else {
    for (int64_t cell = first, end = first + count; cell < end;) {
      int64_t bits = std::min<int64_t>(64 - cell % 64, end - cell);
      uint64_t mask = bits == 64 ? ~uint64_t(0)
                                 : ((uint64_t(1) << bits) - 1) << (cell % 64);
      uint64_t *word = words() + cell / 64;
      if (loadWord(word) & mask) {
        uint64_t gone =
            __atomic_fetch_and(word, ~mask, __ATOMIC_RELAXED) & mask;
        cleared += __builtin_popcountll(gone);
        for (; gone; gone &= gone - 1)
          noteRemoved(cell / 64 * 64 + __builtin_ctzll(gone), 1);
      }
      cell += bits;
    }
  }
  if (cleared == 0)
    return;
  changed(-cleared, true);
  for (SparseNode *child : children)
    child->clearRange(first * child->cellsBelow, count * child->cellsBelow);
}

void SparseNode::deactivate(int64_t cell) {
  if (__builtin_expect(onDevice != nullptr, false)) {
    if (!isActive(layout.isList ? cell / capacity() * capacity() : cell))
      return;
    onDevice->hostChanges(/*removes=*/true);
  }
  if (layout.isList) {
    int64_t list = cell / capacity();
    int32_t length = __atomic_exchange_n(lengths() + list, 0, __ATOMIC_RELAXED);
    if (length == 0)
      return;
    for (SparseNode *child : children)
      child->clearRange(list * capacity() * child->cellsBelow,
                        capacity() * child->cellsBelow);
    release(addressOf(list * capacity()), length * cellBytes());
    noteRemoved(list * capacity(), length);
    changed(-length, true);
    return;
  }
  uint64_t bit = uint64_t(1) << (cell % 64);
  uint64_t before =
      __atomic_fetch_and(words() + cell / 64, ~bit, __ATOMIC_RELAXED);
  if (!(before & bit))
    return;
  for (SparseNode *child : children)
    child->clearRange(cell * child->cellsBelow, child->cellsBelow);
  release(addressOf(cell), cellBytes());
  noteRemoved(cell, 1);
  changed(-1, true);
}

void SparseNode::deactivateAll() {
  if (onDevice && onDevice->deactivateAll(*this))
    return;
  prepare(/*removes=*/true);
  std::vector<int64_t> found;
  collectInto(found, 0, numMarks);
  // Neighbouring cells are released together, because pages are larger than
  // most cells.
  char *begin = nullptr, *end = nullptr;
  for (int64_t cell : found) {
    if (!layout.isList) {
      __atomic_fetch_and(words() + cell / 64, ~(uint64_t(1) << (cell % 64)),
                         __ATOMIC_RELAXED);
    } else if (cell % capacity() == 0) {
      __atomic_store_n(lengths() + cell / capacity(), 0, __ATOMIC_RELAXED);
    }
    for (SparseNode *child : children)
      child->clearRange(cell * child->cellsBelow, child->cellsBelow);
    noteRemoved(cell, 1);
    char *address = addressOf(cell);
    if (address != end) {
      release(begin, end - begin);
      begin = address;
    }
    end = address + cellBytes();
  }
  release(begin, end - begin);
  if (!found.empty())
    changed(-static_cast<int64_t>(found.size()), true);
}

//===----------------------------------------------------------------------===//
// Lists
//===----------------------------------------------------------------------===//

void SparseNode::collectInto(std::vector<int64_t> &found, int64_t begin,
                             int64_t end) const {
  for (int64_t m = begin; m < end; ++m) {
    uint64_t mark = marks[m].load(std::memory_order_relaxed);
    for (; mark; mark &= mark - 1) {
      int64_t group = m * 64 + __builtin_ctzll(mark);
      if (layout.isList) {
        int64_t first = group * capacity();
        for (int64_t i = 0, n = loadLength(lengths() + group); i < n; ++i)
          found.push_back(first + i);
        continue;
      }
      for (uint64_t word = loadWord(words() + group); word; word &= word - 1)
        found.push_back(group * 64 + __builtin_ctzll(word));
    }
  }
}

#ifdef MADV_COLLAPSE
constexpr int kCollapse = MADV_COLLAPSE;
#else
/// Large pages are requested by a call of Linux 6.1 or later; older kernels
/// refuse it, and pages stay small.
constexpr int kCollapse = 25;
#endif

/// Large pages save most of the address translation that a stencil over a full
/// field waits for, but they take memory as a whole: only regions that are
/// active nearly everywhere get them.
void SparseNode::useLargePages(const ActiveList &list) {
  constexpr int64_t kPage = int64_t(2) << 20;
  // A region of memory gets a large page only if so many of its bytes are
  // active.
  constexpr int64_t kEnough = kPage / 8 * 7;
  if (static_cast<int64_t>(list.cells.size()) * cellBytes() < kEnough)
    return;
  std::lock_guard<std::mutex> lock(memory.largePagesMutex);
  auto advise = [&](uintptr_t region, int64_t bytes) {
    if (bytes >= kEnough && memory.largePages.insert(region).second)
      (void)madvise(reinterpret_cast<void *>(region * kPage), kPage, kCollapse);
  };
  uintptr_t region = 0;
  int64_t bytes = 0;
  for (int64_t cell : list.cells) {
    uintptr_t here = reinterpret_cast<uintptr_t>(addressOf(cell)) / kPage;
    if (here != region) {
      advise(region, bytes);
      region = here;
      bytes = 0;
    }
    bytes += cellBytes();
  }
  advise(region, bytes);
}

ActiveListPtr SparseNode::list() {
  sync();
  const ListMaker &maker = *memory.lists;
  std::lock_guard<std::mutex> lock(mutex);
  uint64_t now = changes.load(std::memory_order_acquire);
  if (current && current->epoch == now &&
      maker.skips.has(Skip::UnchangedLists)) {
    ++reused;
    maker.counters.add(SkipCount::ListsReused);
    return current;
  }
  auto list = std::make_shared<ActiveList>();
  list->epoch = now;
  // The number of cells from which on a fork of several threads is worth its
  // cost.
  constexpr int64_t kManyCells = 1 << 15;
  int64_t count = active.load(std::memory_order_relaxed);
  int64_t parts = count < kManyCells
                      ? 1
                      : std::min<int64_t>(maker.workers.threads(), numMarks);
  if (parts <= 1) {
    list->cells.reserve(static_cast<size_t>(std::max<int64_t>(count, 0)));
    collectInto(list->cells, 0, numMarks);
  } else {
    struct Job {
      const SparseNode *node;
      int64_t parts;
      std::vector<std::vector<int64_t>> found;
    } job{this, parts, std::vector<std::vector<int64_t>>(parts)};
    maker.workers.parallel(
        parts,
        [](void *context, int64_t part) {
          Job &job = *static_cast<Job *>(context);
          int64_t marks = job.node->numMarks;
          job.node->collectInto(job.found[part], marks * part / job.parts,
                                marks * (part + 1) / job.parts);
        },
        &job);
    for (const std::vector<int64_t> &found : job.found)
      list->cells.insert(list->cells.end(), found.begin(), found.end());
  }
  if (children.empty() && !onDevice)
    useLargePages(*list);
  ++made;
  maker.counters.add(SkipCount::ListsMade);
  current = std::move(list);
  return current;
}

//===----------------------------------------------------------------------===//
// The activity that the host knows without waiting for a device
//===----------------------------------------------------------------------===//

SparseNode::Moment SparseNode::now() const {
  Moment moment{changes.load(std::memory_order_acquire), 0, true};
  if (onDevice) {
    moment.generation = onDevice->getGeneration();
    moment.isKnown = !onDevice->isBehind();
  }
  return moment;
}

bool SparseNode::hasChangedSince(const Moment &moment) const {
  return epoch() != moment.epoch &&
         (moment.isKnown || onDevice->getGeneration() > moment.generation);
}

bool SparseNode::hasRemovedSince(const Moment &moment) const {
  return lastRemoval() > moment.epoch &&
         (moment.isKnown || onDevice->getLastRemoval() > moment.generation);
}

bool SparseNode::mayBeActive() const {
  return (onDevice && onDevice->isBehind()) ||
         active.load(std::memory_order_relaxed) != 0;
}

//===----------------------------------------------------------------------===//
// The activity of the level on a device
//===----------------------------------------------------------------------===//

bool SparseNode::holdsCellsAlone() const {
  int64_t within = 0;
  for (const SparseNode *child : children)
    within += child->cellsBelow * child->cellBytes();
  return within == cellBytes();
}

int64_t SparseNode::activityBytes() const {
  return layout.isList ? cells / capacity() * int64_t(sizeof(int32_t))
                       : (cells + 63) / 64 * int64_t(sizeof(uint64_t));
}

void SparseNode::forEachKnown(const std::function<void(int64_t)> &body) const {
  std::vector<int64_t> found;
  collectInto(found, 0, numMarks);
  for (int64_t cell : found)
    body(cell);
}

void SparseNode::adopt(const Part &part, Adopted &adopted,
                       const std::function<void(int64_t)> &added) {
  auto forEachBit = [](uint64_t word, const auto &body) {
    for (; word; word &= word - 1)
      body(__builtin_ctzll(word));
  };
  if (layout.isList) {
    const auto *now = static_cast<const int32_t *>(part.activity);
    const auto *was = static_cast<const int32_t *>(part.gone);
    for (int64_t i = 0; i < part.count; ++i) {
      int64_t list = part.first + i;
      int32_t before = lengths()[list], length = was ? was[i] : 0;
      length = std::max(length, now[i] < before ? before : 0);
      if (length) {
        adopted.removes = true;
        noteRemoved(list * capacity(), length);
      }
      if (now[i] == before && !length)
        continue;
      adopted.differs |= now[i] != before;
      adopted.by += now[i] - before;
      lengths()[list] = now[i];
      markWord(list);
      for (int32_t k = 0; k < now[i]; ++k)
        added(list * capacity() + k);
    }
  } else {
    const auto *now = static_cast<const uint64_t *>(part.activity);
    const auto *was = static_cast<const uint64_t *>(part.gone);
    for (int64_t i = 0; i < part.count; ++i) {
      int64_t at = part.first + i;
      uint64_t before = words()[at];
      uint64_t left = (was ? was[i] : 0) | (before & ~now[i]);
      if (left) {
        adopted.removes = true;
        forEachBit(left, [&](int bit) { noteRemoved(at * 64 + bit, 1); });
      }
      if (now[i] == before)
        continue;
      adopted.differs = true;
      adopted.by += __builtin_popcountll(now[i]) - __builtin_popcountll(before);
      words()[at] = now[i];
      markWord(at);
      forEachBit(now[i] & ~before, [&](int bit) { added(at * 64 + bit); });
    }
  }
}
