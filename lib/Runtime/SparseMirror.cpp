//===- SparseMirror.cpp - A sparse tree on a device -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "SparseMirror.h"
#include "CellElements.h"
#include "Launch.h"
#include "Mirror.h"
#include <algorithm>
#include <cstring>

using namespace mlir::tai::runtime;

static int64_t alignUp(int64_t bytes) { return (bytes + 255) / 256 * 256; }

SparseMirror::SparseMirror(DeviceContext &context, Tree &tree)
    : context(context), tree(tree) {
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
  int64_t changesAt = bytes;
  bytes += alignUp(static_cast<int64_t>(nodes.size() * sizeof(uint32_t)));
  std::vector<int64_t> removedAt;
  for (const std::unique_ptr<SparseNode> &node : nodes) {
    removedAt.push_back(bytes);
    bytes += alignUp(node->activityBytes());
  }
  Status status = context.allocate(bytes,
                                   "tree '" + tree.name() + "' (all cells of " +
                                       nodes.back()->info().label + ")",
                                   block);
  if (!status)
    return status;
  base = block + TAI_DEVICE_TREE_HEADER;
  changes = block + static_cast<DevicePtr>(changesAt);
  for (int64_t offset : removedAt)
    removed.push_back(block + static_cast<DevicePtr>(offset));
  const char zero = 0;
  status = context.get().fill(block, &zero, 1, bytes);
  if (status)
    status = writeDescriptor();
  if (!status) {
    context.free(block);
    removed.clear();
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
  std::vector<std::pair<size_t, size_t>> textAt;
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
    DevicePtr change = changes + entries.size() * sizeof(uint32_t);
    entry.changes = reinterpret_cast<uint32_t *>(change);
    entry.removed = reinterpret_cast<void *>(removed[entries.size()]);
    size_t range = texts.size();
    texts += "index out of range: there is no cell {} in " + info.label +
             ", which has " + std::to_string(node->numCells());
    texts += '\0';
    textAt.push_back({range, texts.size()});
    texts += "append to a full list: " + info.label + " holds at most " +
             std::to_string(node->capacity()) + " cells";
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
        reinterpret_cast<const char *>(textsAt + textAt[i].first);
    entries[i].fullMessage =
        reinterpret_cast<const char *>(textsAt + textAt[i].second);
  }
  TaiDeviceTree header = {static_cast<int64_t>(entries.size()),
                          reinterpret_cast<const TaiDeviceNode *>(nodesAt),
                          reinterpret_cast<const TaiDeviceStep *>(stepsAt)};
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
  return forEachRun([&](int64_t offset, int64_t bytes) {
    return context.get().copyIn(base + static_cast<DevicePtr>(offset),
                                tree.base() + offset, bytes);
  });
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
  const auto &nodes = tree.sparseNodes();
  std::vector<uint32_t> happened(nodes.size());
  auto flagBytes = static_cast<int64_t>(nodes.size() * sizeof(uint32_t));
  Status status = device.copyOut(happened.data(), changes, flagBytes);
  bool any = false;
  for (size_t i = 0; i < nodes.size() && status; ++i) {
    if (!happened[i])
      continue;
    any = true;
    SparseNode &node = *nodes[i];
    int64_t bytes = node.activityBytes();
    // Whole words, of which the last of a row of lengths may be half.
    auto words = static_cast<size_t>((bytes + 7) / 8);
    std::vector<uint64_t> activity(words), gone;
    status = device.copyOut(
        activity.data(),
        base + static_cast<DevicePtr>(node.info().activityOffset), bytes);
    if (status && (happened[i] & TAI_DEVICE_CELLS_REMOVED)) {
      gone.resize(words);
      status = device.copyOut(gone.data(), removed[i], bytes);
      const char zero = 0;
      if (status)
        status = device.fill(removed[i], &zero, 1, bytes);
    }
    if (status)
      node.adopt(activity.data(), gone.empty() ? nullptr : gone.data(),
                 [&](int64_t cell) { touchCell(node, cell); });
  }
  const char zero = 0;
  if (status && any)
    status = device.fill(changes, &zero, 1, flagBytes);
  if (status)
    behind.store(false, std::memory_order_release);
  return status;
}

//===----------------------------------------------------------------------===//
// What the host changes on both sides
//===----------------------------------------------------------------------===//

bool SparseMirror::isCurrent() const { return tree.mirror()->onDevice(); }

static bool isBelow(const SparseNode *node, const SparseNode &above) {
  while (node && node != &above)
    node = node->above();
  return node;
}

bool SparseMirror::deactivateAll(SparseNode &node) {
  bringActivity();
  std::lock_guard<std::recursive_mutex> lock(mutex);
  if (!isCurrent() || behind.load(std::memory_order_acquire))
    return false;
  // Of few runs of cells each is zeroed, of many all that lies between.
  constexpr size_t mostRuns = 256;
  std::vector<std::pair<int64_t, int64_t>> runs;
  node.forEachActive([&](int64_t cell) {
    int64_t offset = node.offsetOf(cell), end = offset + node.cellBytes();
    if (!runs.empty() && runs.back().second == offset)
      runs.back().second = end;
    else if (runs.size() <= mostRuns)
      runs.push_back({offset, end});
  });
  if (runs.size() > mostRuns) {
    const std::vector<SparseInfo::Step> &steps = node.info().steps;
    if (steps.size() != 1)
      return false;
    int64_t begin = node.info().offset;
    runs = {{begin, begin + steps[0].cells * steps[0].stride}};
  }
  for (const std::unique_ptr<SparseNode> &other : tree.sparseNodes())
    if (isBelow(other.get(), node)) {
      int64_t begin = other->info().activityOffset;
      runs.push_back({begin, begin + other->activityBytes()});
    }
  const char zero = 0;
  for (auto [begin, end] : runs)
    context.note(context.get().fill(base + static_cast<DevicePtr>(begin), &zero,
                                    1, end - begin));
  return true;
}

void SparseMirror::uploadActivity(const SparseNode &node) {
  int64_t offset = node.info().activityOffset;
  context.note(context.get().copyIn(base + static_cast<DevicePtr>(offset),
                                    tree.base() + offset,
                                    node.activityBytes()));
}

bool SparseMirror::fillActive(const Field &field, const CellElements &elements,
                              const void *scalarBytes) {
  bringActivity();
  std::lock_guard<std::recursive_mutex> lock(mutex);
  int64_t stride = elements.evenCellStride();
  if (!isCurrent() || stride == 0 || behind.load(std::memory_order_acquire))
    return false;
  // Runs of neighbours among the active cells; for zeros, all cells, where
  // there are too many.
  constexpr size_t mostFills = 256;
  const SparseNode &node = *field.sparseNode();
  const std::vector<CellElements::Run> &pieces = elements.runs();
  struct Cells {
    int64_t first, count;
  };
  std::vector<Cells> runs;
  size_t mostRuns = std::max<size_t>(mostFills / pieces.size(), 1);
  node.forEachActive([&](int64_t cell) {
    if (!runs.empty() && runs.back().first + runs.back().count == cell)
      ++runs.back().count;
    else if (runs.size() <= mostRuns)
      runs.push_back({cell, 1});
  });
  auto scalar = static_cast<int>(byteSize(field.scalar()));
  const auto *bytes = static_cast<const char *>(scalarBytes);
  if (runs.size() > mostRuns) {
    if (std::any_of(bytes, bytes + scalar, [](char b) { return b != 0; }))
      return false;
    runs = {{0, node.numCells()}};
  }
  // Pieces that are as far from each other as those of neighbouring cells are
  // rows of one block.
  auto count = static_cast<int64_t>(pieces.size());
  int64_t step = count > 1 ? pieces[1].offset - pieces[0].offset : stride;
  bool even = step * count == stride;
  for (int64_t i = 0; i < count; ++i)
    even &= pieces[i].bytes == pieces[0].bytes &&
            pieces[i].offset == pieces[0].offset + i * step;
  if (!even && pieces.size() > mostFills)
    return false;
  DevicePtr first = base + static_cast<DevicePtr>(field.layout().placeOffset);
  auto fill = [&](int64_t offset, int64_t rowStep, int64_t rowBytes,
                  int64_t rows) {
    DevicePtr address = first + static_cast<DevicePtr>(offset);
    context.note(
        rowStep == rowBytes
            ? context.get().fill(address, scalarBytes, scalar,
                                 rows * rowBytes / scalar)
            : context.get().fillRows({address, rowStep, rowBytes, rows},
                                     scalarBytes, scalar));
  };
  for (const Cells &run : runs) {
    int64_t start = run.first * stride;
    if (even) {
      fill(start + pieces[0].offset, step, pieces[0].bytes, run.count * count);
      continue;
    }
    for (const CellElements::Run &piece : pieces)
      fill(start + piece.offset, stride, piece.bytes, run.count);
  }
  if (!runs.empty())
    tree.mirror()->deviceWrites();
  return true;
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

void SparseNode::prepareChange() {
  // Nobody changes it in two places.
  (void)tree.writable();
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

//===----------------------------------------------------------------------===//
// Lists
//===----------------------------------------------------------------------===//

Status SparseMirror::find(const ActiveListPtr &list, DevicePtr &address) {
  std::lock_guard<std::recursive_mutex> lock(mutex);
  address = 0;
  if (list->cells.empty())
    return Status::success();
  for (const Uploaded &known : lists)
    if (known.list == list) {
      address = known.memory;
      return Status::success();
    }
  // Those that nobody else has any more are not asked for again; of others the
  // oldest go.
  constexpr size_t mostLists = 64;
  auto isOld = [&](const Uploaded &known) {
    bool old =
        known.list && (known.list.use_count() == 1 ||
                       (lists.size() > mostLists &&
                        &known - lists.data() <
                            ptrdiff_t(lists.size()) - ptrdiff_t(mostLists)));
    if (old)
      context.free(known.memory);
    return old;
  };
  std::vector<Uploaded> kept;
  for (const Uploaded &known : lists)
    if (!isOld(known))
      kept.push_back(known);
  lists = std::move(kept);
  auto bytes = static_cast<int64_t>(list->cells.size() * sizeof(int64_t));
  Status status = context.allocate(bytes, "lists of active cells", address);
  if (!status)
    return status;
  lists.push_back({list, address});
  return context.get().copyIn(address, list->cells.data(), bytes);
}
