//===- AbiSparse.cpp - What compiled kernels call for sparse levels -------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Launch.h"
#include "tai/Runtime/Abi.h"

using namespace mlir::tai;
using namespace mlir::tai::runtime;

static SparseNode &nodeOf(void *tree, int32_t node) {
  return *Tree::of(tree).sparseNodes()[node];
}

Status Runtime::checkActiveBytes(const SparseNode &node, int64_t cells) const {
  int64_t used = reservedBytes() + activeCellBytes(), wanted;
  if (!node.isInnermost() ||
      (!__builtin_mul_overflow(cells, node.cellBytes(), &wanted) &&
       wanted <= limit - used))
    return Status::success();
  std::string what =
      cells == 1 ? "one more cell" : std::to_string(cells) + " cells";
  return Status::failure(StatusCode::Memory,
                         "out of memory: " + what + " of " + node.info().label +
                             " of " + formatBytes(node.cellBytes()) +
                             " each; its " + std::to_string(node.numActive()) +
                             " active cells take " +
                             formatBytes(node.numActive() * node.cellBytes()) +
                             ", and all fields take " + formatBytes(used) +
                             " of " + formatBytes(limit));
}

/// True if there is memory for one more cell; else the launch fails.
static bool checkMemory(TaiFrame *frame, const SparseNode &node) {
  Launch &launch = launchOf(frame);
  Status status = launch.owner().checkActiveBytes(node, 1);
  if (status)
    return true;
  launch.fail(std::move(status));
  return false;
}

extern "C" int32_t tai_rt_activate(TaiFrame *frame, void *tree, int32_t node,
                                   int64_t cell) {
  SparseNode &sparse = nodeOf(tree, node);
  if (!checkMemory(frame, sparse))
    return 0;
  sparse.activate(cell);
  return 1;
}

extern "C" void tai_rt_deactivate(TaiFrame *, void *tree, int32_t node,
                                  int64_t cell) {
  nodeOf(tree, node).deactivate(cell);
}

extern "C" int64_t tai_rt_append(TaiFrame *frame, void *tree, int32_t node,
                                 int64_t list) {
  SparseNode &sparse = nodeOf(tree, node);
  if (!checkMemory(frame, sparse))
    return -1;
  int64_t at = sparse.append(list);
  if (at < 0)
    launchOf(frame).fail(Status::failure(
        StatusCode::Index, "append to a full list: " + sparse.info().label +
                               " of tree '" + Tree::of(tree).name() +
                               "' holds at most " +
                               std::to_string(sparse.capacity()) + " cells"));
  return at;
}

extern "C" int64_t tai_rt_active_cells(TaiFrame *frame, void *tree,
                                       int32_t node, const int64_t **cells) {
  Launch &launch = launchOf(frame);
  ActiveListPtr list = nodeOf(tree, node).list(launch.owner());
  *cells = list->cells.data();
  int64_t count = static_cast<int64_t>(list->cells.size());
  launch.keep(std::move(list));
  if (count == 0)
    launch.owner().skipCounters().add(SkipCount::EmptyLoops);
  return count;
}
