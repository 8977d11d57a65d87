//===- Sparse.cpp - Activity of sparse levels, on the device --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The functions of tai/ABI/Abi.h by which device code changes activity, with
// the same semantics as SparseNode on the host: every cell has a fixed address,
// and memory of inactive cells is zero. Tests of activity are inline in
// kernels; the functions here run once for a cell, and are out of line.
//
//===----------------------------------------------------------------------===//

#include "Level.h"
#include "tai/ABI/Abi.h"
#include "tai/ABI/DeviceState.h"

using namespace tai::device;

#define TAI_RARE __attribute__((noinline))

/// Returns true if the level has this cell; otherwise fails the launch.
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

static void failForRoom(TaiFrame *frame, const char *message, int64_t most,
                        const char *where) {
  int32_t kind = TAI_DEVICE_VALUE_BYTES;
  auto slot = static_cast<uint64_t>(most);
  tai_rt_fail(frame, TAI_FAIL_MEMORY, message, where, 1, &kind, nullptr, &slot);
}

/// Reserves memory for `added` more cells among the `count` cells from `first`
/// on. Returns false and fails the launch if the limit is exceeded.
static bool takeRoom(TaiFrame *frame, const Level &level, int64_t first,
                     int64_t count, int64_t added, const char *where) {
  if (!level.take(added)) {
    failForRoom(frame, level.node.memoryMessage, level.tree.account->limit,
                where);
    return false;
  }
  if (level.takePieces(first, count))
    return true;
  level.giveBack(added);
  failForRoom(frame, level.node.pieceMessage, level.tree.account->mostInPieces,
              where);
  return false;
}

TAI_RARE int32_t tai_rt_activate(TaiFrame *frame, void *tree, int32_t node,
                                 int64_t cell, const char *where) {
  Level level(static_cast<char *>(tree), node);
  if (!check(frame, level, cell, where))
    return 0;
  int64_t wanted = level.countNew(cell);
  if (wanted == 0)
    return 1;
  // In a list, activating a cell activates the inactive cells before it, which
  // need room too.
  if (!takeRoom(frame, level, cell - wanted + 1, wanted, wanted, where))
    return 0;
  // Give back room that is not needed, because other threads have activated
  // some of the cells meanwhile.
  int64_t added = level.activate(cell);
  level.giveBack(wanted - added);
  if (added)
    activateAbove(level, cell);
  return 1;
}

TAI_RARE void tai_rt_deactivate(TaiFrame *frame, void *tree, int32_t node,
                                int64_t cell, const char *where) {
  Level level(static_cast<char *>(tree), node);
  if (!check(frame, level, cell, where))
    return;
  // The cells of a list are deactivated together, and only the first ones, up
  // to its length, have contents.
  int64_t count = 1, span = 1;
  if (level.node.isList) {
    int64_t list = cell / level.node.capacity;
    count = atomicExchange(level.lengths() + list, 0);
    if (count == 0)
      return;
    level.noteRemovedList(list, static_cast<int32_t>(count));
    span = level.node.capacity;
    cell = list * span;
  } else {
    uint64_t bit = uint64_t(1) << (cell % 64);
    if (!(atomicAnd(level.words() + cell / 64, ~bit) & bit))
      return;
    level.noteRemovedBits(cell / 64, bit);
  }
  // A cell may be large, and one thread slow: the threads of the warp that are
  // here together zero their cells one after another, and share the work on
  // each cell.
  uint64_t own[] = {reinterpret_cast<uint64_t>(tree), uint64_t(node),
                    uint64_t(cell), uint64_t(count), uint64_t(span)};
  forEachTogether(own, [](const uint64_t *values, const Together &all,
                          int64_t thread, int64_t threads) {
    auto number = static_cast<int32_t>(values[1]);
    Level level(reinterpret_cast<char *>(values[0]), number);
    auto first = static_cast<int64_t>(values[2]);
    zeroContents(level, number, first, static_cast<int64_t>(values[3]), thread,
                 threads);
    // A barrier: all threads must have read which cells below are active before
    // clearBelow changes that.
    all.meet();
    clearBelow(level, number, first, static_cast<int64_t>(values[4]), thread,
               threads);
  });
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
  int64_t next = atomicRead(length);
  if (next >= capacity)
    next = capacity - 1;
  if (!takeRoom(frame, level, first + next, 1, 1, where))
    return -1;
  int32_t at = atomicAdd(length, int32_t(1));
  if (at >= capacity) {
    atomicAdd(length, int32_t(-1));
    level.giveBack(1);
    tai_rt_fail(frame, TAI_FAIL_INDEX, level.node.fullMessage, where, 0,
                nullptr, nullptr, nullptr);
    return -1;
  }
  // Another thread has appended meanwhile: the cell that this thread gets may
  // lie in another piece, which is reserved even beyond the limit.
  if (at != next)
    level.takePieces(first + at, 1, /*isSure=*/true);
  if (at == 0)
    level.mark(list);
  level.note(TAI_DEVICE_ACTIVITY_CHANGED);
  activateAbove(level, first);
  return at;
}
