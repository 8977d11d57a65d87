//===- SparseMirror.cpp - A sparse tree on a device -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Mirror/SparseMirror.h"
#include "tai/Runtime/Mirror/CellElements.h"
#include "tai/Runtime/Mirror/CellMover.h"
#include "tai/Runtime/Mirror/Mirror.h"
#include "tai/Runtime/Text/Format.h"
#include <algorithm>
#include <cstddef>
#include <cstring>

using namespace mlir::tai;
using namespace mlir::tai::runtime;

/// The number of tiles in which a device computes a list of the level.
static int64_t numTiles(const SparseNode &node) {
  int64_t units = node.info().isList ? node.numCells() / node.capacity()
                                     : (node.numCells() + 63) / 64;
  return (units + TAI_DEVICE_LIST_TILE - 1) / TAI_DEVICE_LIST_TILE;
}

static int64_t alignUp(int64_t bytes) { return (bytes + 255) / 256 * 256; }

SparseMirror::SparseMirror(DeviceContext &context, Tree &tree)
    : context(context), tree(tree), cellLists(context, tree, state) {
  for (const std::unique_ptr<SparseNode> &node : tree.sparseNodes())
    sharedEpochs.push_back(node->knownEpoch());
  touchOutside(0, tree.bytes(), nullptr, 0);
}

SparseMirror::~SparseMirror() {
  for (DevicePtr memory : descriptions)
    context.free(memory);
  for (DevicePtr memory : keptMemory)
    context.free(memory);
  if (block)
    context.free(block);
}

//===----------------------------------------------------------------------===//
// Memory
//===----------------------------------------------------------------------===//

Status SparseMirror::allocate(DevicePtr &address) {
  const auto &nodes = tree.sparseNodes();
  int64_t bytes = TAI_DEVICE_TREE_HEADER + alignUp(tree.bytes());
  int64_t activityAt = bytes;
  bytes +=
      alignUp(static_cast<int64_t>(nodes.size() * sizeof(TaiDeviceActivity)));
  std::vector<int64_t> removedAt, marksAt;
  int64_t mostTiles = 0;
  for (const std::unique_ptr<SparseNode> &node : nodes) {
    removedAt.push_back(bytes);
    bytes += alignUp(node->activityBytes());
    marksAt.push_back(bytes);
    bytes += alignUp(node->numMarked() * int64_t(sizeof(uint64_t)));
    mostTiles = std::max(mostTiles, numTiles(*node));
  }
  int64_t accountAt = bytes;
  bytes += alignUp(sizeof(TaiDeviceAccount));
  int64_t sumsAt = bytes;
  bytes += alignUp(mostTiles * int64_t(sizeof(int64_t)));
  pieceBytes = context.get().limits().reservedPieceBytes;
  int64_t piecesAt = bytes;
  if (pieceBytes > 0) {
    numPieces = bytes / pieceBytes + 2;
    bytes += alignUp((numPieces + 63) / 64 * int64_t(sizeof(uint64_t)));
  }
  Status status = allocateBlock(bytes);
  if (!status)
    return status;
  pieces = block + static_cast<DevicePtr>(piecesAt);
  base = block + TAI_DEVICE_TREE_HEADER;
  activity = block + static_cast<DevicePtr>(activityAt);
  account = block + static_cast<DevicePtr>(accountAt);
  cellLists.setMemory(base, block + static_cast<DevicePtr>(sumsAt));
  for (int64_t offset : removedAt)
    removed.push_back(block + static_cast<DevicePtr>(offset));
  for (int64_t offset : marksAt)
    marks.push_back(block + static_cast<DevicePtr>(offset));
  const char zero = 0;
  if (!isReserved)
    status = context.get().fill(block, &zero, 1, bytes);
  uint64_t first = 1;
  if (status)
    status = context.get().fillRows(
        {activity + offsetof(TaiDeviceActivity, version),
         sizeof(TaiDeviceActivity), sizeof(first), int64_t(nodes.size())},
        &first, sizeof(first));
  if (status)
    status = writeDescriptor();
  if (status)
    status = sendAccount();
  if (status)
    status = countPieces();
  if (!status) {
    context.free(block);
    removed.clear();
    marks.clear();
    block = base = 0;
  }
  address = base;
  return status;
}

/// Writes the descriptor of the tree's sparse levels for device code to memory
/// of its own, and the address of this memory in front of the tree.
Status SparseMirror::writeDescriptor() {
  const auto &nodes = tree.sparseNodes();
  std::vector<TaiDeviceNode> entries;
  std::vector<TaiDeviceStep> steps;
  std::string texts;
  std::vector<std::array<size_t, 4>> textAt;
  for (const std::unique_ptr<SparseNode> &node : nodes) {
    const SparseInfo &info = node->info();
    TaiDeviceNode entry = {};
    entry.isList = info.isList;
    entry.parent = info.parent;
    entry.firstStep = static_cast<int32_t>(steps.size());
    entry.steps = static_cast<int32_t>(info.steps.size());
    for (const SparseInfo::Step &step : info.steps)
      steps.push_back({step.cells, step.stride});
    entry.cells = node->numCells();
    entry.cellsBelow = node->numCellsBelow();
    entry.capacity = node->capacity();
    entry.cellBytes = node->cellBytes();
    entry.offset = info.offset;
    entry.activityOffset = info.activityOffset;
    DevicePtr own = activity + entries.size() * sizeof(TaiDeviceActivity);
    entry.activity = reinterpret_cast<TaiDeviceActivity *>(own);
    entry.removed = reinterpret_cast<void *>(removed[entries.size()]);
    entry.marks = reinterpret_cast<uint64_t *>(marks[entries.size()]);
    size_t range = texts.size();
    texts += "index out of range: there is no cell {} in " + info.label +
             ", which has " + std::to_string(node->numCells());
    texts += '\0';
    size_t full = texts.size();
    texts += "append to a full list: " + info.label + " holds at most " +
             std::to_string(node->capacity()) + " cells";
    texts += '\0';
    size_t room = texts.size();
    texts += "out of memory: one more cell of " + info.label + " of " +
             formatBytes(node->cellBytes()) +
             " each; the active cells of "
             "tree '" +
             tree.name() +
             "' take all of {} that the memory limit "
             "leaves them";
    texts += '\0';
    textAt.push_back({range, full, room, texts.size()});
    texts += "out of memory on the device: one more cell of " + info.label +
             "; the active cells of tree '" + tree.name() +
             "' lie in pieces of " +
             formatBytes(std::max<int64_t>(pieceBytes, 1)) +
             " that take all of {} which the device has for them";
    texts += '\0';
    entry.holdsCellsAlone = node->holdsCellsAlone();
    entries.push_back(entry);
  }
  size_t entryBytes = entries.size() * sizeof(TaiDeviceNode);
  size_t stepBytes = steps.size() * sizeof(TaiDeviceStep);
  size_t bytes = sizeof(TaiDeviceTree) + entryBytes + stepBytes + texts.size();
  DevicePtr memory = 0;
  Status status = context.allocate(static_cast<int64_t>(bytes),
                                   "descriptions of sparse trees", memory);
  if (!status)
    return status;
  descriptions.push_back(memory);
  DevicePtr nodesAt = memory + sizeof(TaiDeviceTree);
  DevicePtr stepsAt = nodesAt + entryBytes, textsAt = stepsAt + stepBytes;
  for (size_t i = 0; i < entries.size(); ++i) {
    entries[i].rangeMessage =
        reinterpret_cast<const char *>(textsAt + textAt[i][0]);
    entries[i].fullMessage =
        reinterpret_cast<const char *>(textsAt + textAt[i][1]);
    if (!nodes[i]->isInnermost())
      continue;
    entries[i].memoryMessage =
        reinterpret_cast<const char *>(textsAt + textAt[i][2]);
    entries[i].pieceMessage =
        reinterpret_cast<const char *>(textsAt + textAt[i][3]);
  }
  TaiDeviceTree header = {static_cast<int64_t>(entries.size()),
                          reinterpret_cast<const TaiDeviceNode *>(nodesAt),
                          reinterpret_cast<const TaiDeviceStep *>(stepsAt),
                          reinterpret_cast<TaiDeviceAccount *>(account)};
  std::vector<char> image(bytes);
  char *at = image.data();
  auto put = [&](const void *from, size_t size) {
    std::memcpy(at, from, size);
    at += size;
  };
  put(&header, sizeof(header));
  put(entries.data(), entryBytes);
  put(steps.data(), stepBytes);
  put(texts.data(), texts.size());
  status = context.get().copyIn(memory, image.data(),
                                static_cast<int64_t>(image.size()));
  if (status)
    status =
        context.get().copyIn(base - sizeof(memory), &memory, sizeof(memory));
  return status;
}

//===----------------------------------------------------------------------===//
// Ranges of the tree that may be non-zero
//===----------------------------------------------------------------------===//

/// Ranges of the tree that were touched consist of whole pages of the host.
static constexpr int64_t pageBytes = 4 << 10;

void SparseMirror::touch(int64_t begin, int64_t end) {
  begin = begin / pageBytes * pageBytes;
  end = std::min((end + pageBytes - 1) / pageBytes * pageBytes, tree.bytes());
  auto next = touched.upper_bound(begin);
  if (next != touched.begin()) {
    auto before = std::prev(next);
    if (before->second >= end)
      return;
    if (before->second >= begin) {
      begin = before->first;
      touched.erase(before);
    }
  }
  while (next != touched.end() && next->first <= end) {
    end = std::max(end, next->second);
    next = touched.erase(next);
  }
  touched[begin] = end;
}

/// True if a level has so many bits or lengths that only marked parts of them
/// are copied.
static bool hasLongRow(const SparseNode &node) {
  return node.activityBytes() >= int64_t(1) << 20;
}

/// Calls touch() for [begin, end) without the cells of the sparse levels
/// directly below. The range is the cell `cell` of the level `above`; if that
/// is null, the whole tree.
void SparseMirror::touchOutside(int64_t begin, int64_t end,
                                const SparseNode *above, int64_t cell) {
  constexpr int64_t mostPools = 1 << 16;
  std::vector<std::pair<int64_t, int64_t>> pools;
  size_t known = above ? above->info().steps.size() : 0;
  for (const std::unique_ptr<SparseNode> &node : tree.sparseNodes()) {
    if (node->above() != above)
      continue;
    const std::vector<SparseInfo::Step> &steps = node->info().steps;
    const SparseInfo::Step &last = steps.back();
    int64_t count = 1, bytes = last.cells * last.stride;
    bool nested = true;
    for (size_t i = known; i + 1 < steps.size(); ++i) {
      nested &= steps[i].stride >= steps[i + 1].cells * steps[i + 1].stride;
      count = std::min(count, mostPools) * steps[i].cells;
    }
    // Pools of cells that are smaller than a page contain no whole page.
    if (!nested || count > mostPools || bytes < pageBytes)
      continue;
    int64_t first = cell * node->numCellsBelow();
    for (int64_t i = 0; i < count; ++i) {
      int64_t offset = node->offsetOf(first + i * last.cells);
      pools.push_back({offset, offset + bytes});
    }
  }
  // Long arrays of activity bits and list lengths are tracked by marks of
  // changed parts instead of touched ranges.
  for (const std::unique_ptr<SparseNode> &node : tree.sparseNodes())
    if (!above && hasLongRow(*node))
      pools.push_back({node->info().activityOffset,
                       node->info().activityOffset + node->activityBytes()});
  std::sort(pools.begin(), pools.end());
  for (auto [from, to] : pools) {
    if (begin < from)
      touch(begin, from);
    // Pages that are partly outside of the pool of cells belong to its
    // neighbours.
    begin = std::max(begin, to);
  }
  if (begin < end)
    touch(begin, end);
}

void SparseMirror::touchCell(const SparseNode &node, int64_t cell) {
  int64_t begin = node.offsetOf(cell), end = begin + node.cellBytes();
  if (node.isInnermost() || end - begin < 2 * pageBytes)
    touch(begin, end);
  else
    touchOutside(begin, end, &node, cell);
}

Status SparseMirror::forEachRun(
    const std::function<Status(int64_t offset, int64_t bytes)> &body) {
  // A gap of this size or less is copied too, since this costs less than one
  // more copy.
  constexpr int64_t smallGap = 16 << 10;
  Status status;
  for (auto part = touched.begin(); part != touched.end() && status;) {
    auto [begin, end] = *part;
    for (++part; part != touched.end() && part->first - end <= smallGap; ++part)
      end = part->second;
    status = body(begin, end - begin);
  }
  return status;
}

//===----------------------------------------------------------------------===//
// Copies
//===----------------------------------------------------------------------===//

Status SparseMirror::upload() {
  Section::Entry entry(moving);
  if (entry.isAgain())
    return entry.check();
  for (const std::unique_ptr<SparseNode> &node : tree.sparseNodes())
    node->forEachKnown([&](int64_t cell) { touchCell(*node, cell); });
  Status status = countPieces();
  if (status)
    status = forEachRun([&](int64_t offset, int64_t bytes) {
      return context.get().copyIn(base + static_cast<DevicePtr>(offset),
                                  tree.base() + offset, bytes);
    });
  for (const std::unique_ptr<SparseNode> &node : tree.sparseNodes())
    if (status && hasLongRow(*node))
      status = sendBits(*node);
  return status ? sendActivity() : std::move(status);
}

Status SparseMirror::download() {
  Section::Entry entry(moving);
  Status status = entry.check();
  if (status)
    status = fetchActivity();
  if (!status)
    return status;
  return forEachRun([&](int64_t offset, int64_t bytes) {
    return context.get().copyOut(tree.base() + offset,
                                 base + static_cast<DevicePtr>(offset), bytes);
  });
}

Status SparseMirror::fetch() {
  Section::Entry entry(moving);
  if (entry.isAgain())
    return entry.check();
  // The function called for a snapshot of activity may ask for activity again,
  // which must not recurse.
  if (!isBehind() || isFetching)
    return Status::success();
  Device &device = context.get();
  context.host().counters.add(SkipCount::ActivityFetched);
  const auto &nodes = tree.sparseNodes();
  std::vector<TaiDeviceActivity> found(nodes.size());
  bool any = false, anyKept = false;
  isFetching = true;
  Status status = adoptKept(anyKept);
  isFetching = false;
  if (status)
    status = device.copyOut(
        found.data(), activity,
        static_cast<int64_t>(nodes.size() * sizeof(TaiDeviceActivity)));
  for (size_t i = 0; i < nodes.size() && status; ++i) {
    uint32_t happened = found[i].changes;
    if (!happened)
      continue;
    any = true;
    SparseNode &node = *nodes[i];
    status = fetchLevel(node, happened & TAI_DEVICE_CELLS_REMOVED);
    sharedEpochs[i] = node.knownEpoch();
  }
  const uint32_t zero = 0;
  if (status && (any || anyKept))
    state.unchangedFrom = state.generation;
  if (status && any) {
    status = device.fillRows({activity, sizeof(TaiDeviceActivity), sizeof(zero),
                              int64_t(nodes.size())},
                             &zero, sizeof(zero));
  }
  if (status)
    state.behind.store(false, std::memory_order_release);
  return status;
}

//===----------------------------------------------------------------------===//
// Changes by the host to its own copy of the tree, and to the copy on the
// device
//===----------------------------------------------------------------------===//

void SparseMirror::hostChanges(bool removes) {
  // The host's copy is made the only current one, and then the host changes it.
  (void)tree.writable();
  state.change(removes);
}

bool SparseMirror::isCurrent() const { return tree.mirror()->onDevice(); }

/// The levels whose cells are zeroed to deactivate all cells of a level: the
/// levels below, if they hold all memory of its cells; then the level itself.
static std::vector<SparseNode *> findHolders(SparseNode &node,
                                             const Tree &tree) {
  std::vector<SparseNode *> found;
  if (node.holdsCellsAlone())
    for (const std::unique_ptr<SparseNode> &below : tree.sparseNodes())
      if (below->above() == &node)
        for (SparseNode *holder : findHolders(*below, tree))
          found.push_back(holder);
  found.push_back(&node);
  return found;
}

bool SparseMirror::deactivateAll(SparseNode &node) {
  Section::Entry entry(moving);
  if (entry.isAgain()) {
    context.note(entry.check());
    return true;
  }
  if (!isCurrent())
    return false;
  // If cells consist of cells of the next levels alone, the latter are zeroed,
  // each level by a list of its own: possibly few of the cells are active.
  std::vector<std::pair<SparseNode *, DeviceCellsPtr>> all;
  for (SparseNode *next : findHolders(node, tree)) {
    DeviceCellsPtr cells;
    Status status = cellLists.list(*next, cells);
    if (status && !cells)
      return false;
    if (!status) {
      context.note(std::move(status));
      return true;
    }
    all.push_back({next, std::move(cells)});
  }
  Status status;
  constexpr unsigned threads = 128;
  for (const auto &[next, cells] : all)
    if (status)
      status = context.library().launch(
          LibraryKernel::DeactivateList,
          /*blocks=*/0, threads,
          {base, numberOf(tree, *next), cells->header()});
  tree.mirror()->deviceWrites();
  deviceActivates(/*removes=*/true);
  context.note(std::move(status));
  return true;
}

bool SparseMirror::fillActive(const Field &field, const CellElements &elements,
                              const void *scalarBytes) {
  Section::Entry entry(moving);
  if (entry.isAgain()) {
    context.note(entry.check());
    return true;
  }
  std::shared_ptr<CellMover> mover;
  DeviceCellsPtr cells;
  if (!isCurrent())
    return false;
  Status status = CellMover::find(field, elements, mover);
  if (status && mover)
    status =
        cellLists.list(const_cast<SparseNode &>(*field.sparseNode()), cells);
  if (status && !cells)
    return false;
  // The count -1 means that only the device knows the number of cells.
  if (status)
    status = mover->fill({cells->cells(), -1}, scalarBytes);
  context.note(std::move(status));
  return true;
}

std::shared_ptr<CellMover> &SparseMirror::moverOf(const Field &field) {
  return movers[{field.layout().placeOffset, int64_t(field.scalar()),
                 field.numComponents()}];
}
