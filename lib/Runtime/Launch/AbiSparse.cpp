//===- AbiSparse.cpp - Entry points for sparse levels ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ABI/Abi.h"
#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Mirror/Mirror.h"

using namespace mlir::tai;
using namespace mlir::tai::runtime;

static SparseNode &nodeOf(void *tree, int32_t node) {
  return *Tree::of(tree).sparseNodes()[node];
}

/// The mirror of the tree whose base on the device is `tree`; null if the
/// launch runs on the CPU.
static Mirror *mirrorOf(const Launch &launch, const void *tree) {
  return __builtin_expect(launch.onDevice != nullptr, false)
             ? launch.onDevice->mirrorOf(tree)
             : nullptr;
}

static SparseNode &nodeOf(const Launch &launch, void *tree, int32_t node) {
  if (Mirror *mirror = mirrorOf(launch, tree))
    return *mirror->mirrored().sparseNodes()[node];
  return nodeOf(tree, node);
}

/// Fails the launch because of a sparse operation; `where` is the line of the
/// program to report, or null.
static void failAt(TaiFrame *frame, StatusCode code, std::string message,
                   const char *where) {
  launchOf(frame).fail(
      Status::failure(code, std::move(message), where ? where : ""));
}

/// Returns true if the node has this cell; otherwise fails the launch. Without
/// checks of indices, an index out of range may yield the number of an existing
/// cell, which passes this check.
static bool checkCell(TaiFrame *frame, const SparseNode &node, int64_t cell,
                      const char *where) {
  if (cell >= 0 && cell < node.numCells())
    return true;
  failAt(frame, StatusCode::Index,
         "index out of range: there is no cell " + std::to_string(cell) +
             " in " + node.info().label + ", which has " +
             std::to_string(node.numCells()),
         where);
  return false;
}

/// Returns true if the memory limit allows one more active cell; otherwise
/// fails the launch.
static bool checkMemory(TaiFrame *frame, const SparseNode &node,
                        const char *where) {
  Status status = launchOf(frame).owner().memory().checkCells(node, 1);
  if (status)
    return true;
  failAt(frame, status.code(), status.message(), where);
  return false;
}

extern "C" int32_t tai_rt_activate(TaiFrame *frame, void *tree, int32_t node,
                                   int64_t cell, const char *where) {
  return orFail(frame, 0, [&] {
    SparseNode &sparse = nodeOf(tree, node);
    if (!checkCell(frame, sparse, cell, where) ||
        !checkMemory(frame, sparse, where))
      return 0;
    sparse.activate(cell);
    return 1;
  });
}

extern "C" void tai_rt_deactivate(TaiFrame *frame, void *tree, int32_t node,
                                  int64_t cell, const char *where) {
  orFail(frame, [&] {
    SparseNode &sparse = nodeOf(tree, node);
    if (checkCell(frame, sparse, cell, where))
      sparse.deactivate(cell);
  });
}

static int64_t append(TaiFrame *frame, void *tree, int32_t node, int64_t list,
                      const char *where) {
  SparseNode &sparse = nodeOf(tree, node);
  int64_t first;
  if (__builtin_mul_overflow(list, sparse.capacity(), &first))
    first = -1;
  if (!checkCell(frame, sparse, first, where) ||
      !checkMemory(frame, sparse, where))
    return -1;
  int64_t at = sparse.append(list);
  if (at < 0)
    failAt(frame, StatusCode::Index,
           "append to a full list: " + sparse.info().label + " holds at most " +
               std::to_string(sparse.capacity()) + " cells",
           where);
  return at;
}

extern "C" int64_t tai_rt_append(TaiFrame *frame, void *tree, int32_t node,
                                 int64_t list, const char *where) {
  return orFail(frame, int64_t(-1),
                [&] { return append(frame, tree, node, list, where); });
}

/// Passes a list of active cells to compiled code, and returns its length.
static int64_t give(Launch &launch, const std::vector<int64_t> &list,
                    const int64_t **cells) {
  *cells = list.data();
  if (list.empty())
    launch.owner().skipCounters().add(SkipCount::EmptyLoops);
  return static_cast<int64_t>(list.size());
}

/// Passes a list of cells to code on a device. If the device makes the list,
/// only the device knows its length, and the result is a guess. Cells with zero
/// adjoints are not left out: the host would have to wait for the device to
/// find them.
static int64_t giveOnDevice(Launch &launch, Mirror &mirror, int32_t node,
                            const int64_t **cells) {
  SparseNode &sparse = *mirror.mirrored().sparseNodes()[node];
  *cells = nullptr;
  DeviceCellsPtr there;
  Status status;
  if (launch.given) {
    const LoopLists::Entry *entry = launch.findGiven(sparse);
    if (!entry)
      return 0;
    there = entry->onDevice;
  } else {
    status = mirror.sparse()->lists().list(sparse, there);
    if (status && there) {
      std::lock_guard<std::mutex> lock(launch.failureMutex);
      launch.loops.add(sparse, there);
    }
  }
  if (status && there) {
    *cells = reinterpret_cast<const int64_t *>(there->cells());
    if (!launch.given && !sparse.mayBeActive())
      launch.owner().skipCounters().add(SkipCount::EmptyLoops);
    return mirror.sparse()->lists().guessActive(sparse);
  }
  ActiveListPtr list = status ? launch.visitedList(sparse) : nullptr;
  DevicePtr address = 0;
  if (list)
    status = mirror.sparse()->lists().find(list, address);
  if (!list || !status) {
    if (!status)
      launch.fail(std::move(status));
    return 0;
  }
  *cells = reinterpret_cast<const int64_t *>(address);
  if (list->cells.empty())
    launch.owner().skipCounters().add(SkipCount::EmptyLoops);
  return static_cast<int64_t>(list->cells.size());
}

extern "C" int64_t tai_rt_active_cells(TaiFrame *frame, void *tree,
                                       int32_t node, const int64_t **cells) {
  return orFail(frame, int64_t(0), [&] {
    Launch &launch = launchOf(frame);
    if (Mirror *mirror = mirrorOf(launch, tree))
      return giveOnDevice(launch, *mirror, node, cells);
    return give(launch, launch.cellsFor(nodeOf(tree, node)), cells);
  });
}

extern "C" int64_t tai_rt_gathered_cells(TaiFrame *frame, void *tree,
                                         int32_t node, int64_t reach,
                                         const int64_t **cells) {
  return orFail(frame, int64_t(0), [&] {
    Launch &launch = launchOf(frame);
    if (Mirror *mirror = mirrorOf(launch, tree))
      return giveOnDevice(launch, *mirror, node, cells);
    return give(launch, launch.gatheredCellsFor(nodeOf(tree, node), reach),
                cells);
  });
}

static bool isListCurrent(Launch &launch, void *tree, int32_t node) {
  SparseNode &sparse = nodeOf(launch, tree, node);
  if (Mirror *mirror = launch.given ? mirrorOf(launch, tree) : nullptr) {
    const LoopLists::Entry *entry = launch.findGiven(sparse);
    if (!entry)
      return 0;
    // A wrong answer false is harmless: the caller then does work that is right
    // for any list.
    if (entry->onDevice)
      return mirror->sparse()->isShownBy(*entry->onDevice);
  }
  return !launch.given || launch.visitedCells(sparse) == sparse.list()->cells;
}

extern "C" int32_t tai_rt_list_is_current(TaiFrame *frame, void *tree,
                                          int32_t node) {
  return orFail(frame, 0, [&] {
    return int32_t(isListCurrent(launchOf(frame), tree, node));
  });
}
