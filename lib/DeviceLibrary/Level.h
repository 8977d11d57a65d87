//===- Level.h - A sparse level of a tree on the device ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Accessors and updates of a level, for the code for activity and for lists of
// active cells.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_DEVICELIBRARY_LEVEL_H
#define TAI_LIB_DEVICELIBRARY_LEVEL_H

#include "Target.h"
#include "tai/ABI/DeviceSparse.h"

namespace tai::device {

/// A sparse level of the tree at `base`.
struct Level {
  char *base;
  const TaiDeviceTree &tree;
  const TaiDeviceNode &node;

  Level(char *base, int32_t number)
      : base(base),
        tree(**(reinterpret_cast<const TaiDeviceTree *const *>(base) - 1)),
        node(tree.nodes[number]) {}

  uint64_t *words() const {
    return reinterpret_cast<uint64_t *>(base + node.activityOffset);
  }
  int32_t *lengths() const {
    return reinterpret_cast<int32_t *>(base + node.activityOffset);
  }
  char *addressOf(int64_t cell) const {
    int64_t offset = node.offset;
    for (int32_t i = node.steps; i-- > 0;) {
      const TaiDeviceStep &step = tree.steps[node.firstStep + i];
      offset += cell % step.cells * step.stride;
      cell /= step.cells;
    }
    return base + offset;
  }

  void note(uint32_t what) const {
    TaiDeviceActivity &activity = *node.activity;
    if ((atomicRead(&activity.changes) & what) != what)
      atomicOr(&activity.changes, what);
    if (!atomicRead(&activity.isNew))
      atomicExchange(&activity.isNew, 1u);
  }
  /// Sets the mark of word number `word` of the level's activity: the word may
  /// be non-zero.
  void mark(int64_t word) const {
    uint64_t bit = uint64_t(1) << (word % 64);
    uint64_t *mark = node.marks + word / 64;
    if (!(atomicRead(mark) & bit))
      atomicOr(mark, bit);
  }
  /// Counts the memory of `cells` further active cells. False if the limit is
  /// exceeded.
  bool take(int64_t cells) const {
    if (!node.memoryMessage)
      return true;
    TaiDeviceAccount &account = *tree.account;
    int64_t bytes = cells * node.cellBytes;
    if (atomicAdd(&account.used, bytes) + bytes <= account.limit)
      return true;
    giveBack(cells);
    return false;
  }
  void giveBack(int64_t cells) const {
    if (node.memoryMessage && cells)
      atomicAdd(&tree.account->used, -cells * node.cellBytes);
  }

  /// Reserves the pieces of memory that hold `count` consecutive cells from
  /// `cell` on. False if the limit is exceeded.
  bool takePieces(int64_t cell, int64_t count, bool isSure = false) const {
    if (!node.memoryMessage || !tree.account->pieces)
      return true;
    TaiDeviceAccount &account = *tree.account;
    uint64_t from =
        reinterpret_cast<uint64_t>(addressOf(cell)) - account.origin;
    uint64_t to = from + static_cast<uint64_t>(count * node.cellBytes) - 1;
    auto bytes = static_cast<uint64_t>(account.pieceBytes);
    for (uint64_t piece = from / bytes; piece <= to / bytes; ++piece)
      if (!takePiece(account, piece, isSure))
        return false;
    return true;
  }
  /// The bit of a piece is set after the piece has been reserved, not before:
  /// threads that find the bit set continue. Several threads may reserve the
  /// same piece; all but one of them give it back, so a thread that exceeds the
  /// limit tries again.
  static bool takePiece(TaiDeviceAccount &account, uint64_t piece,
                        bool isSure) {
    uint64_t *word = account.pieces + piece / 64;
    uint64_t bit = uint64_t(1) << (piece % 64);
    constexpr int mostTries = 256;
    for (int tries = 0; tries < mostTries;) {
      if (atomicRead(word) & bit)
        return true;
      int64_t known = atomicRead(&account.inPieces);
      int64_t wanted = known + account.pieceBytes;
      if (wanted > account.mostInPieces && !isSure) {
        ++tries;
        continue;
      }
      if (!atomicReplace(&account.inPieces, known, wanted))
        continue;
      if (atomicOr(word, bit) & bit)
        atomicAdd(&account.inPieces, -account.pieceBytes);
      return true;
    }
    return false;
  }

  void noteRemovedBits(int64_t word, uint64_t bits) const {
    giveBack(__builtin_popcountll(bits));
    note(TAI_DEVICE_ACTIVITY_CHANGED | TAI_DEVICE_CELLS_REMOVED);
    atomicOr(static_cast<uint64_t *>(node.removed) + word, bits);
  }
  void noteRemovedList(int64_t list, int32_t length) const {
    giveBack(length);
    note(TAI_DEVICE_ACTIVITY_CHANGED | TAI_DEVICE_CELLS_REMOVED);
    raise(static_cast<int32_t *>(node.removed) + list, length);
  }

  /// An atomic maximum. Returns the previous value.
  static int32_t raise(int32_t *number, int32_t wanted) {
    int32_t known = atomicRead(number);
    while (known < wanted && !atomicReplace(number, known, wanted)) {
    }
    return known;
  }

  /// The number of inactive cells that activate(cell) would activate: in a
  /// list, the cells before it too.
  int64_t countNew(int64_t cell) const {
    if (!node.isList)
      return !(atomicRead(words() + cell / 64) >> (cell % 64) & 1);
    int64_t more =
        cell % node.capacity + 1 - atomicRead(lengths() + cell / node.capacity);
    return more < 0 ? 0 : more;
  }

  /// Activates one cell of this level; in a list, also the cells before it.
  /// Returns the number of cells that were inactive.
  int64_t activate(int64_t cell) const {
    int64_t added = 1;
    if (node.isList) {
      auto wanted = static_cast<int32_t>(cell % node.capacity) + 1;
      int64_t list = cell / node.capacity;
      int32_t before = raise(lengths() + list, wanted);
      if (before >= wanted)
        return 0;
      if (before == 0)
        mark(list);
      added = wanted - before;
    } else {
      uint64_t bit = uint64_t(1) << (cell % 64);
      uint64_t before = atomicOr(words() + cell / 64, bit);
      if (before & bit)
        return 0;
      if (before == 0)
        mark(cell / 64);
    }
    note(TAI_DEVICE_ACTIVITY_CHANGED);
    return added;
  }

  /// Deactivates the cells [first, first + count); of a list level, whole
  /// lists. The work is divided: thread number `thread` of `threads` does its
  /// share.
  void clear(int64_t first, int64_t count, int64_t thread = 0,
             int64_t threads = 1) const {
    if (node.isList) {
      int64_t end = (first + count) / node.capacity;
      for (int64_t list = first / node.capacity + thread; list < end;
           list += threads)
        if (atomicRead(lengths() + list))
          noteRemovedList(list, atomicExchange(lengths() + list, 0));
      return;
    }
    int64_t end = first + count;
    for (int64_t word = first / 64 + thread; word * 64 < end; word += threads) {
      uint64_t mask = ~uint64_t(0);
      if (word * 64 < first)
        mask <<= first % 64;
      if (end - word * 64 < 64)
        mask &= (uint64_t(1) << (end % 64)) - 1;
      if (atomicRead(words() + word) & mask)
        noteRemovedBits(word, atomicAnd(words() + word, ~mask) & mask);
    }
  }
};

/// Zeroes memory; this thread does its share.
inline void zero(char *memory, int64_t bytes, int64_t thread, int64_t threads) {
  bool isWhole =
      (reinterpret_cast<uintptr_t>(memory) | uint64_t(bytes)) % 8 == 0;
  if (isWhole) {
    auto *words = reinterpret_cast<uint64_t *>(memory);
    for (int64_t i = thread; i < bytes / 8; i += threads)
      words[i] = 0;
    return;
  }
  for (int64_t i = thread; i < bytes; i += threads)
    memory[i] = 0;
}

/// Zeroes the active cells among [first, first + count), which stay active. If
/// the level has lists, zeroes whole lists. This thread does its share of each
/// cell.
inline void zeroActive(const Level &level, int64_t first, int64_t count,
                       int64_t thread, int64_t threads) {
  int64_t each = level.node.isList ? level.node.capacity : 64;
  int64_t end = (first + count + each - 1) / each;
  for (int64_t unit = first / each; unit < end; ++unit) {
    uint64_t marks = level.node.marks[unit / 64] >> (unit % 64);
    if (!marks) {
      unit |= 63;
      continue;
    }
    if (!(marks & 1))
      continue;
    if (level.node.isList) {
      zero(level.addressOf(unit * each),
           level.lengths()[unit] * level.node.cellBytes, thread, threads);
      continue;
    }
    for (uint64_t word = level.words()[unit]; word; word &= word - 1) {
      int64_t cell = unit * 64 + __builtin_ctzll(word);
      if (cell >= first && cell < first + count)
        zero(level.addressOf(cell), level.node.cellBytes, thread, threads);
    }
  }
}

/// The number of cells of level `number` below one cell of level `above`; 0 if
/// `above` is not an ancestor.
inline int64_t cellsWithin(const TaiDeviceNode *nodes, int32_t number,
                           int32_t above) {
  int64_t span = 1;
  for (; number > above; number = nodes[number].parent)
    span *= nodes[number].cellsBelow;
  return number == above ? span : 0;
}

/// Zeroes the contents of the cells [first, first + count). If these cells hold
/// only cells of other levels, zeroes the active ones of the latter. This
/// thread does its share.
inline void zeroContents(const Level &level, int32_t number, int64_t first,
                         int64_t count, int64_t thread, int64_t threads) {
  if (!level.node.holdsCellsAlone) {
    zero(level.addressOf(first), count * level.node.cellBytes, thread, threads);
    return;
  }
  const TaiDeviceNode *nodes = level.tree.nodes;
  for (int32_t other = number + 1; other < level.tree.numNodes; ++other) {
    int64_t span = cellsWithin(nodes, other, number);
    if (span && !nodes[other].holdsCellsAlone)
      zeroActive(Level(level.base, other), first * span, count * span, thread,
                 threads);
  }
}

/// Activates the cells of the levels above that contain a cell of `level`.
inline void activateAbove(const Level &level, int64_t cell) {
  const TaiDeviceNode *node = &level.node;
  while (node->parent >= 0) {
    cell /= node->cellsBelow;
    Level above(level.base, node->parent);
    if (!above.activate(cell))
      return;
    node = &above.node;
  }
}

/// Deactivates the descendants of the cells [first, first + count); this thread
/// does its share.
inline void clearBelow(const Level &level, int32_t number, int64_t first,
                       int64_t count, int64_t thread = 0, int64_t threads = 1) {
  const TaiDeviceNode *nodes = level.tree.nodes;
  for (int32_t other = number + 1; other < level.tree.numNodes; ++other) {
    if (int64_t span = cellsWithin(nodes, other, number))
      Level(level.base, other)
          .clear(first * span, count * span, thread, threads);
  }
}

} // namespace tai::device

#endif // TAI_LIB_DEVICELIBRARY_LEVEL_H
