//===- DeviceLists.cpp - Lists of active cells on a device ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The device computes lists on demand, and their lengths stay on the device.
// The host knows only which launches may have changed activity: after such a
// launch it queues the computation again, which returns at once if nothing has
// changed.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Mirror/DeviceLists.h"
#include "tai/Runtime/Mirror/Mirror.h"
#include <algorithm>

using namespace mlir::tai;
using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Memory for lists
//===----------------------------------------------------------------------===//

/// The size from which on a list's memory is reserved, and committed on use, if
/// the device can do so.
static constexpr int64_t mostBytes = int64_t(256) << 20;

static int64_t bytesFor(int64_t cells) {
  return static_cast<int64_t>(DeviceCells::cellsOffset) +
         cells * static_cast<int64_t>(sizeof(int64_t));
}

Status DeviceCells::make(std::shared_ptr<DeviceContext> context,
                         int64_t capacity, std::shared_ptr<DeviceCells> &list) {
  DevicePtr memory = 0;
  int64_t bytes = bytesFor(capacity);
  const char *owner = "lists of active cells";
  Status status = bytes > mostBytes ? context->reserve(bytes, owner, memory)
                                    : context->allocate(bytes, owner, memory);
  if (!status)
    return status;
  list.reset(new DeviceCells(std::move(context), memory, capacity));
  const char zero = 0;
  return list->device().fill(memory, &zero, 1, int64_t(cellsOffset));
}

Status mlir::tai::runtime::fetchCells(const DeviceCells &list,
                                      std::vector<int64_t> &cells) {
  TaiDeviceListHeader header;
  Status status = list.device().copyOut(&header, list.header(), sizeof(header));
  if (!status)
    return status;
  cells.resize(static_cast<size_t>(header.count));
  return list.device().copyOut(cells.data(), list.cells(),
                               header.count *
                                   static_cast<int64_t>(sizeof(int64_t)));
}

Status mlir::tai::runtime::findDifference(const LoopLists &lists,
                                          const SparseNode &node,
                                          bool &differs) {
  bool any = false;
  std::vector<int64_t> first, next;
  differs = false;
  for (const LoopLists::Entry &entry : lists.all()) {
    if (entry.node != &node || differs)
      continue;
    Status status;
    if (entry.onDevice)
      status = fetchCells(*entry.onDevice, next);
    else
      next = entry.list->cells;
    if (!status)
      return status;
    if (!any)
      first.swap(next);
    else
      differs = first != next;
    any = true;
  }
  return Status::success();
}

DeviceLists::~DeviceLists() {
  for (const Uploaded &list : uploaded)
    context.free(list.memory);
}

Status DeviceLists::find(const ActiveListPtr &list, DevicePtr &address) {
  Section::Entry entry(making);
  if (entry.isAgain())
    return entry.check();
  for (const Uploaded &known : uploaded)
    if (known.list == list) {
      address = known.memory + DeviceCells::cellsOffset;
      return Status::success();
    }
  // Lists without another owner, which no loop can request again, are dropped;
  // so are the oldest lists beyond this number.
  constexpr size_t mostLists = 64;
  auto isOld = [&](const Uploaded &known) {
    bool old = (known.list.use_count() == 1 ||
                (uploaded.size() > mostLists &&
                 &known - uploaded.data() <
                     ptrdiff_t(uploaded.size()) - ptrdiff_t(mostLists)));
    if (old)
      context.free(known.memory);
    return old;
  };
  std::vector<Uploaded> kept;
  for (const Uploaded &known : uploaded)
    if (!isOld(known))
      kept.push_back(known);
  uploaded = std::move(kept);
  auto count = static_cast<int64_t>(list->cells.size());
  DevicePtr memory = 0;
  Status status =
      context.allocate(bytesFor(count), "lists of active cells", memory);
  if (!status)
    return status;
  uploaded.push_back({list, memory});
  address = memory + DeviceCells::cellsOffset;
  status = context.get().copyIn(address - sizeof(count), &count, sizeof(count));
  if (!status || count == 0)
    return status;
  return context.get().copyIn(address, list->cells.data(),
                              count * static_cast<int64_t>(sizeof(int64_t)));
}

//===----------------------------------------------------------------------===//
// Making lists
//===----------------------------------------------------------------------===//

size_t mlir::tai::runtime::numberOf(const Tree &tree, const SparseNode &node) {
  const auto &nodes = tree.sparseNodes();
  return static_cast<size_t>(
      std::find_if(nodes.begin(), nodes.end(),
                   [&](const auto &other) { return other.get() == &node; }) -
      nodes.begin());
}

int64_t DeviceLists::guessActive(const SparseNode &node) const {
  int64_t known = node.knownActive();
  if (activity.isBehind())
    known = known > 0 ? 2 * known : node.numCells();
  // The guess of the number of cells is rounded up to a power of two, so that a
  // few more cells do not change it.
  int64_t guess = 1;
  while (guess < known)
    guess *= 2;
  return std::min(guess, std::max<int64_t>(node.numCells(), 1));
}

Status DeviceLists::queueList(const SparseNode &node, DeviceCells &cells) {
  constexpr int64_t fewTiles = 4;
  constexpr unsigned manyThreads = 1024, someThreads = 512;
  uint64_t number = numberOf(tree, node), header = cells.header();
  int64_t units = node.info().isList ? node.numCells() / node.capacity()
                                     : (node.numCells() + 63) / 64;
  int64_t tiles = (units + TAI_DEVICE_LIST_TILE - 1) / TAI_DEVICE_LIST_TILE;
  LibraryKernels &library = context.library();
  if (tiles <= fewTiles)
    return library.launch(LibraryKernel::ListCells, /*blocks=*/1, manyThreads,
                          {base, number, header});
  constexpr int64_t mostBlocks = 1024;
  auto blocks = static_cast<unsigned>(std::min(tiles, mostBlocks));
  Status status = library.launch(LibraryKernel::ListCount, blocks, someThreads,
                                 {base, number, header, sums});
  if (status)
    status = library.launch(LibraryKernel::ListScan, /*blocks=*/1, manyThreads,
                            {base, number, header, sums});
  if (status)
    status = library.launch(LibraryKernel::ListWrite, blocks, someThreads,
                            {base, number, header, sums});
  return status;
}

Status DeviceLists::list(SparseNode &node, DeviceCellsPtr &cells) {
  Section::Entry entry(making);
  cells = nullptr;
  if (entry.isAgain())
    return entry.check();
  const DeviceServices &host = context.host();
  Pool &pool = pools[numberOf(tree, node)];
  if (pool.current && activity.isShownBy(*pool.current) &&
      host.skips.has(Skip::UnchangedLists)) {
    node.countList(/*isReused=*/true);
    host.counters.add(SkipCount::ListsReused);
    cells = pool.current;
    return Status::success();
  }
  // If the host does not know the number of active cells, the list gets room
  // for all cells.
  int64_t needed = activity.isBehind() ? node.numCells() : guessActive(node);
  if (bytesFor(needed) > mostBytes &&
      context.get().limits().reservedPieceBytes == 0)
    return Status::success();
  bool isThere = false;
  Status status = context.library().load(isThere);
  if (!status || !isThere)
    return status;
  auto isFree = [&](const std::shared_ptr<DeviceCells> &list) {
    long holders = list == pool.current ? 2 : 1;
    return list.use_count() == holders && list->capacity() >= needed;
  };
  std::shared_ptr<DeviceCells> chosen;
  // The current list is preferred, since it possibly shows the active cells
  // already. But collected work is recognised only if each loop has its former
  // list.
  if (pool.current && isFree(pool.current) && !context.queue().isCollecting())
    chosen = pool.current;
  for (const std::shared_ptr<DeviceCells> &list : pool.all)
    if (!chosen && isFree(list))
      chosen = list;
  if (!chosen) {
    status = DeviceCells::make(tree.mirror()->sharedContext(), needed, chosen);
    if (!status)
      return status;
    pool.all.push_back(chosen);
  }
  chosen->generation = activity.generation;
  pool.current = chosen;
  cells = chosen;
  node.countList(/*isReused=*/false);
  host.counters.add(SkipCount::ListsMade);
  return queueList(node, *chosen);
}
