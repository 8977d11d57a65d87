//===- SparseMirror.cpp - A sparse tree on a device -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "SparseMirror.h"
#include "CellElements.h"
#include "CellMover.h"
#include "Launch.h"
#include "Mirror.h"
#include "tai/Runtime/Runtime.h"
#include <algorithm>
#include <cstddef>
#include <cstring>

using namespace mlir::tai::runtime;

/// How many tiles a list of the level is made of.
static int64_t numTiles(const SparseNode &node) {
  int64_t units = node.info().isList ? node.numCells() / node.capacity()
                                     : (node.numCells() + 63) / 64;
  return (units + TAI_DEVICE_LIST_TILE - 1) / TAI_DEVICE_LIST_TILE;
}

static int64_t alignUp(int64_t bytes) { return (bytes + 255) / 256 * 256; }

SparseMirror::SparseMirror(DeviceContext &context, Tree &tree)
    : context(context), tree(tree) {
  for (const std::unique_ptr<SparseNode> &node : tree.sparseNodes())
    sharedEpochs.push_back(node->changes.load(std::memory_order_acquire));
  pools.resize(sharedEpochs.size());
  touchOutside(0, tree.bytes(), nullptr, 0);
}

SparseMirror::~SparseMirror() {
  for (const Uploaded &list : lists)
    context.free(list.memory);
  if (block)
    context.free(block);
}

//===----------------------------------------------------------------------===//
// Memory
//===----------------------------------------------------------------------===//

static const std::string &innermost(const std::vector<SparseInfo> &levels) {
  return levels.back().label;
}

Status SparseMirror::check(const DeviceContext &context,
                           const std::string &name, int64_t bytes,
                           const std::vector<SparseInfo> &levels) {
  int64_t most = context.get().limits().memoryBytes;
  if (bytes <= most)
    return Status::success();
  return Status::failure(
      StatusCode::Memory,
      "tree '" + name + "' spans " + formatBytes(bytes) +
          " with all cells active (" + innermost(levels) +
          "), and the device '" + context.get().name() + "' has " +
          formatBytes(most) +
          "; cells do not get their memory one by one on the GPU yet: make the "
          "levels smaller, or use the CPU for this program");
}

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
    bytes += alignUp(node->numMarks * int64_t(sizeof(uint64_t)));
    mostTiles = std::max(mostTiles, numTiles(*node));
  }
  int64_t accountAt = bytes;
  bytes += alignUp(sizeof(TaiDeviceAccount));
  int64_t sumsAt = bytes;
  bytes += alignUp(mostTiles * int64_t(sizeof(int64_t)));
  Status status = context.allocate(bytes,
                                   "tree '" + tree.name() + "' (all cells of " +
                                       nodes.back()->info().label + ")",
                                   block);
  if (!status)
    return status;
  base = block + TAI_DEVICE_TREE_HEADER;
  activity = block + static_cast<DevicePtr>(activityAt);
  sums = block + static_cast<DevicePtr>(sumsAt);
  account = block + static_cast<DevicePtr>(accountAt);
  for (int64_t offset : removedAt)
    removed.push_back(block + static_cast<DevicePtr>(offset));
  for (int64_t offset : marksAt)
    marks.push_back(block + static_cast<DevicePtr>(offset));
  const char zero = 0;
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
  if (!status) {
    context.free(block);
    removed.clear();
    marks.clear();
    block = base = 0;
  }
  address = base;
  return status;
}

/// What device code must know lies in memory of its own, which the tree holds.
Status SparseMirror::writeDescriptor() {
  const auto &nodes = tree.sparseNodes();
  std::vector<TaiDeviceNode> entries;
  std::vector<TaiDeviceStep> steps;
  std::string texts;
  std::vector<std::array<size_t, 3>> textAt;
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
    textAt.push_back({range, full, texts.size()});
    texts += "out of memory: one more cell of " + info.label + " of " +
             formatBytes(node->cellBytes()) +
             " each; the active cells of "
             "tree '" +
             tree.name() +
             "' take all of {} that the memory limit "
             "leaves them";
    texts += '\0';
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
  lists.push_back({nullptr, memory});
  DevicePtr nodesAt = memory + sizeof(TaiDeviceTree);
  DevicePtr stepsAt = nodesAt + entryBytes, textsAt = stepsAt + stepBytes;
  for (size_t i = 0; i < entries.size(); ++i) {
    entries[i].rangeMessage =
        reinterpret_cast<const char *>(textsAt + textAt[i][0]);
    entries[i].fullMessage =
        reinterpret_cast<const char *>(textsAt + textAt[i][1]);
    if (nodes[i]->isInnermost())
      entries[i].memoryMessage =
          reinterpret_cast<const char *>(textsAt + textAt[i][2]);
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
// What may hold something
//===----------------------------------------------------------------------===//

/// Whole pages, as the host has them.
static constexpr int64_t pieceBytes = 4 << 10;

void SparseMirror::touch(int64_t begin, int64_t end) {
  begin = begin / pieceBytes * pieceBytes;
  end =
      std::min((end + pieceBytes - 1) / pieceBytes * pieceBytes, tree.bytes());
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

/// What lies in [begin, end), which is cell `cell` of the level `above` or the
/// whole tree, but not in cells of the sparse levels next below.
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
    // Small ones hold no piece as a whole.
    if (!nested || count > mostPools || bytes < pieceBytes)
      continue;
    int64_t first = cell * node->numCellsBelow();
    for (int64_t i = 0; i < count; ++i) {
      int64_t offset = node->offsetOf(first + i * last.cells);
      pools.push_back({offset, offset + bytes});
    }
  }
  std::sort(pools.begin(), pools.end());
  for (auto [from, to] : pools) {
    if (begin < from)
      touch(begin, from);
    // Pieces that the pool has in part are those of its neighbours too.
    begin = std::max(begin, to);
  }
  if (begin < end)
    touch(begin, end);
}

void SparseMirror::touchCell(const SparseNode &node, int64_t cell) {
  int64_t begin = node.offsetOf(cell), end = begin + node.cellBytes();
  if (node.isInnermost() || end - begin < 2 * pieceBytes)
    touch(begin, end);
  else
    touchOutside(begin, end, &node, cell);
}

Status SparseMirror::forEachRun(
    const std::function<Status(int64_t offset, int64_t bytes)> &body) {
  // So few bytes more are less than one more copy.
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
  std::lock_guard<std::recursive_mutex> lock(mutex);
  for (const std::unique_ptr<SparseNode> &node : tree.sparseNodes())
    node->forEachActive([&](int64_t cell) { touchCell(*node, cell); });
  Status status = forEachRun([&](int64_t offset, int64_t bytes) {
    return context.get().copyIn(base + static_cast<DevicePtr>(offset),
                                tree.base() + offset, bytes);
  });
  return status ? sendActivity() : std::move(status);
}

Status SparseMirror::download() {
  std::lock_guard<std::recursive_mutex> lock(mutex);
  Status status = fetchActivity();
  if (!status)
    return status;
  return forEachRun([&](int64_t offset, int64_t bytes) {
    return context.get().copyOut(tree.base() + offset,
                                 base + static_cast<DevicePtr>(offset), bytes);
  });
}

Status SparseMirror::fetch() {
  std::lock_guard<std::recursive_mutex> lock(mutex);
  if (!behind.load(std::memory_order_acquire))
    return Status::success();
  Device &device = context.get();
  context.getRuntime().skipCounters().add(SkipCount::ActivityFetched);
  const auto &nodes = tree.sparseNodes();
  std::vector<TaiDeviceActivity> found(nodes.size());
  Status status = device.copyOut(
      found.data(), activity,
      static_cast<int64_t>(nodes.size() * sizeof(TaiDeviceActivity)));
  bool any = false;
  for (size_t i = 0; i < nodes.size() && status; ++i) {
    uint32_t happened = found[i].changes;
    if (!happened)
      continue;
    any = true;
    SparseNode &node = *nodes[i];
    int64_t bytes = node.activityBytes();
    // Whole words, of which the last of a row of lengths may be half.
    auto words = static_cast<size_t>((bytes + 7) / 8);
    std::vector<uint64_t> now(words), gone;
    status = device.copyOut(
        now.data(), base + static_cast<DevicePtr>(node.info().activityOffset),
        bytes);
    if (status && (happened & TAI_DEVICE_CELLS_REMOVED)) {
      gone.resize(words);
      status = device.copyOut(gone.data(), removed[i], bytes);
      const char zero = 0;
      if (status)
        status = device.fill(removed[i], &zero, 1, bytes);
    }
    if (status)
      node.adopt(now.data(), gone.empty() ? nullptr : gone.data(),
                 [&](int64_t cell) { touchCell(node, cell); });
    sharedEpochs[i] = node.changes.load(std::memory_order_acquire);
  }
  const uint32_t zero = 0;
  if (status && any) {
    unchangedFrom = generation;
    sentLimit = -1;
    status = device.fillRows({activity, sizeof(TaiDeviceActivity), sizeof(zero),
                              int64_t(nodes.size())},
                             &zero, sizeof(zero));
  }
  if (status)
    behind.store(false, std::memory_order_release);
  return status;
}

//===----------------------------------------------------------------------===//
// What the host changes on both sides
//===----------------------------------------------------------------------===//

bool SparseMirror::isCurrent() const { return tree.mirror()->onDevice(); }

bool SparseMirror::deactivateAll(SparseNode &node) {
  std::lock_guard<std::recursive_mutex> lock(mutex);
  DeviceCellsPtr cells;
  if (!isCurrent())
    return false;
  Status status = list(node, cells);
  if (status && !cells)
    return false;
  if (status) {
    constexpr unsigned threads = 128;
    status = context.library().launch(LibraryKernel::DeactivateList,
                                      /*blocks=*/0, threads,
                                      {base, numberOf(node), cells->header()});
    tree.mirror()->deviceWrites();
    deviceActivates(/*removes=*/true);
  }
  context.note(std::move(status));
  return true;
}

void SparseMirror::uploadActivity(const SparseNode &node) {
  int64_t offset = node.info().activityOffset;
  Status status =
      context.get().copyIn(base + static_cast<DevicePtr>(offset),
                           tree.base() + offset, node.activityBytes());
  if (status)
    status = sendActivity();
  context.note(std::move(status));
}

bool SparseMirror::fillActive(const Field &field, const CellElements &elements,
                              const void *scalarBytes) {
  std::lock_guard<std::recursive_mutex> lock(mutex);
  std::shared_ptr<CellMover> mover;
  DeviceCellsPtr cells;
  if (!isCurrent())
    return false;
  Status status = CellMover::find(field, elements, mover);
  if (status && mover)
    status = list(const_cast<SparseNode &>(*field.sparseNode()), cells);
  if (status && !cells)
    return false;
  // How many there are is known there.
  if (status)
    status = mover->fill({cells->cells(), -1}, scalarBytes);
  context.note(std::move(status));
  return true;
}

std::shared_ptr<CellMover> &SparseMirror::moverOf(const Field &field) {
  return movers[{field.layout().placeOffset, int64_t(field.scalar()),
                 field.numComponents()}];
}

/// Goes to the activity that the device has: bits or lengths, and those of the
/// cells that were removed meanwhile, or null. Calls `added` for cells that may
/// have become active.
void SparseNode::adopt(const void *activity, const void *gone,
                       const std::function<void(int64_t)> &added) {
  int64_t by = 0;
  bool differs = false, removes = false;
  auto forEachBit = [](uint64_t word, const auto &body) {
    for (; word; word &= word - 1)
      body(__builtin_ctzll(word));
  };
  if (layout.isList) {
    const auto *now = static_cast<const int32_t *>(activity);
    const auto *was = static_cast<const int32_t *>(gone);
    for (int64_t list = 0, n = cells / capacity(); list < n; ++list) {
      int32_t before = lengths()[list], length = was ? was[list] : 0;
      length = std::max(length, now[list] < before ? before : 0);
      if (length) {
        removes = true;
        noteRemoved(list * capacity(), length);
      }
      if (now[list] == before && !length)
        continue;
      differs |= now[list] != before;
      by += now[list] - before;
      lengths()[list] = now[list];
      markWord(list);
      for (int32_t i = 0; i < now[list]; ++i)
        added(list * capacity() + i);
    }
  } else {
    const auto *now = static_cast<const uint64_t *>(activity);
    const auto *was = static_cast<const uint64_t *>(gone);
    for (int64_t i = 0, n = (cells + 63) / 64; i < n; ++i) {
      uint64_t before = words()[i];
      uint64_t left = (was ? was[i] : 0) | (before & ~now[i]);
      if (left) {
        removes = true;
        forEachBit(left, [&](int bit) { noteRemoved(i * 64 + bit, 1); });
      }
      if (now[i] == before)
        continue;
      differs = true;
      by += __builtin_popcountll(now[i]) - __builtin_popcountll(before);
      words()[i] = now[i];
      markWord(i);
      forEachBit(now[i] & ~before, [&](int bit) { added(i * 64 + bit); });
    }
  }
  if (differs || removes)
    changed(by, removes);
}

void SparseNode::bringActivity() const { onDevice->bringActivity(); }

void SparseNode::prepareChange(bool removes) {
  // Nobody changes it in two places.
  (void)tree.writable();
  onDevice->hostChanges(removes);
}

int64_t SparseNode::activityBytes() const {
  return layout.isList ? cells / capacity() * int64_t(sizeof(int32_t))
                       : (cells + 63) / 64 * int64_t(sizeof(uint64_t));
}

void SparseNode::forEachActive(const std::function<void(int64_t)> &body) const {
  std::vector<int64_t> found;
  collectInto(found, 0, numMarks);
  for (int64_t cell : found)
    body(cell);
}
