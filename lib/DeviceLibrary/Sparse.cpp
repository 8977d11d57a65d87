//===- Sparse.cpp - Which cells of a tree are active, on the device -------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The part of tai/Runtime/Abi.h by which device code changes activity. It means
// what SparseNode does on the host: every cell has a fixed address, and memory
// of inactive cells is zero. Tests of activity are in the code of the kernels;
// what is here happens once for a cell, and stays out of line.
//
//===----------------------------------------------------------------------===//

#include "Target.h"
#include "tai/Runtime/Abi.h"
#include "tai/Runtime/DeviceSparse.h"

using namespace tai::device;

#define TAI_RARE __attribute__((noinline))

namespace {
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
    if ((atomicRead(node.changes) & what) != what)
      atomicOr(node.changes, what);
  }
  void noteRemovedBits(int64_t word, uint64_t bits) const {
    note(TAI_DEVICE_ACTIVITY_CHANGED | TAI_DEVICE_CELLS_REMOVED);
    atomicOr(static_cast<uint64_t *>(node.removed) + word, bits);
  }
  void noteRemovedList(int64_t list, int32_t length) const {
    note(TAI_DEVICE_ACTIVITY_CHANGED | TAI_DEVICE_CELLS_REMOVED);
    raise(static_cast<int32_t *>(node.removed) + list, length);
  }

  /// Makes a number at least so large. Returns what it was.
  static int32_t raise(int32_t *number, int32_t wanted) {
    int32_t known = atomicRead(number);
    while (known < wanted && !atomicReplace(number, known, wanted)) {
    }
    return known;
  }

  /// Makes one cell of this level active. Returns true if it was not.
  bool activate(int64_t cell) const {
    if (node.isList) {
      auto wanted = static_cast<int32_t>(cell % node.capacity) + 1;
      if (raise(lengths() + cell / node.capacity, wanted) >= wanted)
        return false;
    } else {
      uint64_t bit = uint64_t(1) << (cell % 64);
      if (atomicOr(words() + cell / 64, bit) & bit)
        return false;
    }
    note(TAI_DEVICE_ACTIVITY_CHANGED);
    return true;
  }

  /// Makes the cells [first, first + count) inactive, whole lists of them.
  void clear(int64_t first, int64_t count) const {
    if (node.isList) {
      int64_t end = (first + count) / node.capacity;
      for (int64_t list = first / node.capacity; list < end; ++list)
        if (atomicRead(lengths() + list))
          noteRemovedList(list, atomicExchange(lengths() + list, 0));
      return;
    }
    for (int64_t cell = first, end = first + count; cell < end;) {
      int64_t bits = 64 - cell % 64;
      if (bits > end - cell)
        bits = end - cell;
      uint64_t mask = bits == 64 ? ~uint64_t(0)
                                 : ((uint64_t(1) << bits) - 1) << (cell % 64);
      uint64_t *word = words() + cell / 64;
      if (atomicRead(word) & mask)
        noteRemovedBits(cell / 64, atomicAnd(word, ~mask) & mask);
      cell += bits;
    }
  }
};
} // namespace

/// Makes the cells above a cell of `level` active.
static void activateAbove(const Level &level, int64_t cell) {
  const TaiDeviceNode *node = &level.node;
  while (node->parent >= 0) {
    cell /= node->cellsBelow;
    Level above(level.base, node->parent);
    if (!above.activate(cell))
      return;
    node = &above.node;
  }
}

/// Makes inactive what lies below the cells [first, first + count).
static void clearBelow(const Level &level, int32_t number, int64_t first,
                       int64_t count) {
  const TaiDeviceNode *nodes = level.tree.nodes;
  for (int32_t other = number + 1; other < level.tree.numNodes; ++other) {
    int64_t span = 1;
    int32_t at = other;
    for (; at > number; at = nodes[at].parent)
      span *= nodes[at].cellsBelow;
    if (at == number)
      Level(level.base, other).clear(first * span, count * span);
  }
}

static void zero(char *memory, int64_t bytes) {
  char *end = memory + bytes;
  while (memory < end && reinterpret_cast<uintptr_t>(memory) % 8)
    *memory++ = 0;
  for (; end - memory >= 8; memory += 8)
    *reinterpret_cast<uint64_t *>(memory) = 0;
  while (memory < end)
    *memory++ = 0;
}

/// True if there is such a cell; else the launch fails.
static bool check(TaiFrame *frame, const Level &level, int64_t cell,
                  const char *where) {
  if (cell >= 0 && cell < level.node.cells)
    return true;
  int32_t kind = TAI_VALUE_I64;
  auto slot = static_cast<uint64_t>(cell);
  tai_rt_fail(frame, TAI_FAIL_INDEX, level.node.rangeMessage, where, 1, &kind,
              nullptr, &slot);
  return false;
}

TAI_RARE int32_t tai_rt_activate(TaiFrame *frame, void *tree, int32_t node,
                                 int64_t cell, const char *where) {
  Level level(static_cast<char *>(tree), node);
  if (!check(frame, level, cell, where))
    return 0;
  if (level.activate(cell))
    activateAbove(level, cell);
  return 1;
}

TAI_RARE void tai_rt_deactivate(TaiFrame *frame, void *tree, int32_t node,
                                int64_t cell, const char *where) {
  Level level(static_cast<char *>(tree), node);
  if (!check(frame, level, cell, where))
    return;
  int64_t count = 1;
  if (level.node.isList) {
    int64_t list = cell / level.node.capacity;
    count = atomicExchange(level.lengths() + list, 0);
    if (count == 0)
      return;
    level.noteRemovedList(list, static_cast<int32_t>(count));
    cell = list * level.node.capacity;
    clearBelow(level, node, cell, level.node.capacity);
  } else {
    uint64_t bit = uint64_t(1) << (cell % 64);
    if (!(atomicAnd(level.words() + cell / 64, ~bit) & bit))
      return;
    level.noteRemovedBits(cell / 64, bit);
    clearBelow(level, node, cell, 1);
  }
  zero(level.addressOf(cell), count * level.node.cellBytes);
}

TAI_RARE int64_t tai_rt_append(TaiFrame *frame, void *tree, int32_t node,
                               int64_t list, const char *where) {
  Level level(static_cast<char *>(tree), node);
  int64_t first, capacity = level.node.capacity;
  if (__builtin_mul_overflow(list, capacity, &first))
    first = -1;
  if (!check(frame, level, first, where))
    return -1;
  int32_t *length = level.lengths() + list;
  int32_t at = atomicAdd(length, int32_t(1));
  if (at >= capacity) {
    atomicAdd(length, int32_t(-1));
    tai_rt_fail(frame, TAI_FAIL_INDEX, level.node.fullMessage, where, 0,
                nullptr, nullptr, nullptr);
    return -1;
  }
  level.note(TAI_DEVICE_ACTIVITY_CHANGED);
  activateAbove(level, first);
  return at;
}
