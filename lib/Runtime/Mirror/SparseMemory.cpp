//===- SparseMemory.cpp - Memory of sparse trees on a device --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A small tree is allocated for all of its cells at once. A tree that would
// take a large part of the device's memory, or more, reserves addresses
// instead, and the device commits pieces on first use. No code here may iterate
// over all cells or all bits of such a tree.
//
// If memory is exhausted, the driver pages pieces to the host and back, which
// is extremely slow. So pieces with active cells are counted, and a kernel that
// would exceed the limit fails.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Mirror/Mirror.h"
#include "tai/Runtime/Text/Format.h"
#include <algorithm>
#include <cstddef>

using namespace mlir::tai;
using namespace mlir::tai::runtime;

static constexpr int64_t wordBytes = sizeof(uint64_t);

//===----------------------------------------------------------------------===//
// Allocation or reservation
//===----------------------------------------------------------------------===//

Status SparseMirror::check(const DeviceContext &context,
                           const std::string &name, int64_t bytes,
                           const std::vector<SparseInfo> &levels) {
  DeviceLimits limits = context.get().limits();
  if (bytes <= limits.memoryBytes || limits.reservedPieceBytes > 0)
    return Status::success();
  return Status::failure(
      StatusCode::Memory,
      "tree '" + name + "' spans " + formatBytes(bytes) +
          " with all cells active (" + levels.back().label +
          "), and the device '" + context.get().name() + "' has " +
          formatBytes(limits.memoryBytes) +
          " and cannot give it to cells one by one: make the levels smaller, "
          "or use the CPU for this program");
}

Status SparseMirror::allocateBlock(int64_t bytes) {
  std::string owner = "tree '" + tree.name() + "' (all cells of " +
                      tree.sparseNodes().back()->info().label + ")";
  // A tree that needs at most one part in `share` of the device's memory is
  // committed at once, so that no access waits for a commitment.
  constexpr int64_t share = 8;
  bool canReserve = pieceBytes > 0;
  Status status;
  if (!canReserve || bytes <= context.mostBytes() / share) {
    status = context.allocate(bytes, owner, block);
    if (status || status.code() != StatusCode::Memory || !canReserve)
      return status;
  }
  isReserved = true;
  return context.reserve(bytes, owner, block);
}

//===----------------------------------------------------------------------===//
// Pieces
//===----------------------------------------------------------------------===//

/// Counts the committed pieces of reserved memory, and those that the host's
/// data will need, before the data is copied to the device.
Status SparseMirror::countPieces() {
  if (!isReserved)
    return Status::success();
  Device &device = context.get();
  std::vector<uint64_t> known(static_cast<size_t>((numPieces + 63) / 64));
  int64_t bytes = static_cast<int64_t>(known.size()) * wordBytes;
  Status status = device.copyOut(known.data(), pieces, bytes);
  if (!status)
    return status;
  auto count = [&] {
    int64_t sum = 0;
    for (uint64_t word : known)
      sum += __builtin_popcountll(word);
    return sum * pieceBytes;
  };
  int64_t before = count();
  DevicePtr origin = block / static_cast<DevicePtr>(pieceBytes) *
                     static_cast<DevicePtr>(pieceBytes);
  status = forEachRun([&](int64_t offset, int64_t size) {
    auto from = static_cast<int64_t>(base - origin) + offset;
    for (int64_t piece = from / pieceBytes; piece * pieceBytes < from + size;
         ++piece)
      known[static_cast<size_t>(piece / 64)] |= uint64_t(1) << (piece % 64);
    return Status::success();
  });
  int64_t now = count(), left = context.leftToReserved(before);
  if (now - before > left)
    return Status::failure(
        StatusCode::Memory,
        "out of memory on the device '" + device.name() + "': what tree '" +
            tree.name() + "' holds lies in pieces of " +
            formatBytes(pieceBytes) + " that take " + formatBytes(now) +
            ", and the device has " + formatBytes(before + left) + " for them");
  TaiDeviceAccount fresh = {};
  fresh.pieces = reinterpret_cast<uint64_t *>(pieces);
  fresh.origin = origin;
  fresh.pieceBytes = pieceBytes;
  fresh.inPieces = now;
  fresh.mostInPieces = before + left;
  constexpr int64_t skipped = offsetof(TaiDeviceAccount, pieces);
  status = device.copyIn(account + skipped,
                         reinterpret_cast<const char *>(&fresh) + skipped,
                         sizeof(fresh) - skipped);
  return status ? device.copyIn(pieces, known.data(), bytes)
                : std::move(status);
}

//===----------------------------------------------------------------------===//
// Bits and lengths
//===----------------------------------------------------------------------===//

/// Calls body(offset, bytes) for the parts of a level's activity bits or list
/// lengths that may be non-zero according to `marks`, or for all of them if
/// they are few.
template <typename Marks, typename Body>
static Status forEachPart(const SparseNode &node, int64_t numMarks,
                          const Marks &marks, const Body &body) {
  constexpr int64_t shortRow = 1 << 20, smallGap = 32 << 10;
  int64_t all = node.activityBytes();
  if (all < shortRow)
    return body(0, all);
  // A mark stands for 64 words of activity bits, or for 64 lengths of lists.
  int64_t group =
      64 * (node.info().isList ? int64_t(sizeof(int32_t)) : wordBytes);
  int64_t begin = 0, end = 0;
  Status status;
  for (int64_t i = 0; i < numMarks && status; ++i) {
    if (!marks(i))
      continue;
    if (end > 0 && i * group - end > smallGap) {
      status = body(begin, end - begin);
      end = 0;
    }
    if (end == 0)
      begin = i * group;
    end = std::min((i + 1) * group, all);
  }
  return end > 0 && status ? body(begin, end - begin) : std::move(status);
}

Status SparseMirror::sendBits(const SparseNode &node) {
  int64_t offset = node.info().activityOffset;
  // Marks of non-zero words are never removed: without a mark, bits are zero on
  // both sides.
  auto mark = [&](int64_t i) {
    return node.marked()[i].load(std::memory_order_relaxed);
  };
  return forEachPart(
      node, node.numMarked(), mark, [&](int64_t at, int64_t bytes) {
        return context.get().copyIn(base + static_cast<DevicePtr>(offset + at),
                                    tree.base() + offset + at, bytes);
      });
}

void SparseMirror::uploadActivity(const SparseNode &node,
                                  const std::vector<int64_t> &changed) {
  constexpr size_t few = 64;
  // A copy from the host would end the collection of work, so few changed words
  // are sent by fills.
  if (context.queue().isCollecting() && changed.size() <= few) {
    context.note(sendWords(node, changed));
    return;
  }
  Status status = sendBits(node);
  if (status)
    status = sendActivity();
  context.note(std::move(status));
}

/// Sends changed words of activity to the device by fills, one for each word.
Status SparseMirror::sendWords(const SparseNode &node,
                               const std::vector<int64_t> &changed) {
  int64_t unit = node.info().isList ? int64_t(sizeof(int32_t)) : wordBytes;
  Status status;
  for (int64_t i : changed) {
    int64_t offset = node.info().activityOffset + i * unit;
    if (status)
      status =
          context.get().fill(base + static_cast<DevicePtr>(offset),
                             tree.base() + offset, static_cast<int>(unit), 1);
  }
  size_t number = numberOf(tree, node);
  sharedEpochs[number] = node.knownEpoch();
  state.unchangedFrom = ++state.generation;
  const uint32_t isNew = 1;
  if (status)
    status = context.get().fill(activity + number * sizeof(TaiDeviceActivity) +
                                    offsetof(TaiDeviceActivity, isNew),
                                &isNew, sizeof(isNew), 1);
  return status ? sendAccount() : std::move(status);
}

/// Makes the host's copy of the activity of one level current. `removes`: also
/// takes the bits of deactivated cells, and clears them on the device.
Status SparseMirror::fetchLevel(SparseNode &node, bool removes) {
  Device &device = context.get();
  size_t number = numberOf(tree, node);
  std::vector<uint64_t> found(static_cast<size_t>(node.numMarked()));
  Status status =
      device.copyOut(found.data(), marks[number], node.numMarked() * wordBytes);
  if (!status)
    return status;
  int64_t unit = node.info().isList ? int64_t(sizeof(int32_t)) : wordBytes;
  DevicePtr row = base + static_cast<DevicePtr>(node.info().activityOffset);
  SparseNode::Adopted adopted;
  std::vector<uint64_t> now, gone;
  auto mark = [&](int64_t i) { return found[static_cast<size_t>(i)]; };
  status =
      forEachPart(node, node.numMarked(), mark, [&](int64_t at, int64_t bytes) {
        // The size is rounded up to whole words, because the length of a last
        // list takes only half of its word.
        now.assign(static_cast<size_t>((bytes + 7) / 8), 0);
        Status copied =
            device.copyOut(now.data(), row + static_cast<DevicePtr>(at), bytes);
        if (copied && removes) {
          gone.assign(now.size(), 0);
          DevicePtr there = removed[number] + static_cast<DevicePtr>(at);
          copied = device.copyOut(gone.data(), there, bytes);
          const char zero = 0;
          if (copied)
            copied = device.fill(there, &zero, 1, bytes);
        }
        if (copied)
          node.adopt({at / unit, bytes / unit, now.data(),
                      removes ? gone.data() : nullptr},
                     adopted, [&](int64_t cell) { touchCell(node, cell); });
        return copied;
      });
  if (adopted.differs || adopted.removes)
    node.changed(adopted.by, adopted.removes);
  return status;
}

/// Sends to the device the bytes of the active cells that the host knows of,
/// and their limit.
Status SparseMirror::sendAccount() {
  const MemoryAccount &memory = context.host().memory;
  int64_t used = 0;
  for (const std::unique_ptr<SparseNode> &node : tree.sparseNodes())
    if (node->isInnermost())
      used += node->knownActive() * node->cellBytes();
  int64_t others = memory.activeCellBytes() - used;
  const int64_t now[] = {used, memory.left() - others};
  static_assert(offsetof(TaiDeviceAccount, limit) == sizeof(int64_t), "");
  if (!context.queue().isCollecting())
    return context.get().copyIn(account, now, sizeof(now));
  Status status = context.get().fill(account, &now[0], sizeof(int64_t), 1);
  return status ? context.get().fill(account + sizeof(int64_t), &now[1],
                                     sizeof(int64_t), 1)
                : std::move(status);
}

/// Sends to the device the marks of levels whose activity the host has changed,
/// and makes lists of their cells stale.
Status SparseMirror::sendActivity() {
  const auto &nodes = tree.sparseNodes();
  Status status;
  bool any = false;
  for (size_t i = 0; i < nodes.size() && status; ++i) {
    uint64_t epoch = nodes[i]->knownEpoch();
    if (epoch == sharedEpochs[i])
      continue;
    sharedEpochs[i] = epoch;
    any = true;
    state.unchangedFrom = ++state.generation;
    status = context.get().copyIn(marks[i], nodes[i]->marked(),
                                  nodes[i]->numMarked() *
                                      static_cast<int64_t>(sizeof(uint64_t)));
    const uint32_t isNew = 1;
    if (status)
      status = context.get().fill(activity + i * sizeof(TaiDeviceActivity) +
                                      offsetof(TaiDeviceActivity, isNew),
                                  &isNew, sizeof(isNew), 1);
  }
  return status && any ? sendAccount() : std::move(status);
}

//===----------------------------------------------------------------------===//
// Snapshots of activity
//===----------------------------------------------------------------------===//

/// Bytes of the bits or lengths of a level, rounded up to whole words.
static int64_t keptRow(const SparseNode &node) {
  return (node.activityBytes() + wordBytes - 1) / wordBytes * wordBytes;
}

int64_t SparseMirror::keptBytes() const {
  int64_t bytes = 0;
  for (const std::unique_ptr<SparseNode> &node : tree.sparseNodes())
    bytes += wordBytes + 2 * keptRow(*node);
  return bytes;
}

bool SparseMirror::canKeepActivity() const {
  // While the host does not know the number of active cells, the list of a loop
  // has room for all cells, and a tape keeps a list for each launch.
  constexpr int64_t mostCells = 1 << 13;
  for (const std::unique_ptr<SparseNode> &node : tree.sparseNodes())
    if (node->numCells() > mostCells)
      return false;
  return true;
}

bool SparseMirror::keepActivity(std::function<void()> seen) {
  Section::Entry entry(moving);
  constexpr size_t mostStates = 1 << 10;
  if (entry.isAgain() || !base || isFetching || kept.size() == mostStates ||
      !canKeepActivity())
    return false;
  // No launch since the last snapshot of activity can have changed it, so no
  // new snapshot is taken.
  if (!kept.empty() && keptGeneration == state.generation)
    return true;
  bool isThere = false;
  Status status = context.library().load(isThere);
  if (!status || !isThere)
    return false;
  if (keptMemory.size() == kept.size()) {
    DevicePtr memory = 0;
    if (!context.allocate(keptBytes(), "activity that tapes keep", memory))
      return false;
    keptMemory.push_back(memory);
    // Bits of removed cells are written only if cells were removed, but are
    // always fetched, so they are zeroed first.
    char zero = 0;
    context.note(context.get().fill(memory, &zero, 1, keptBytes()));
  }
  constexpr unsigned threads = 1024;
  context.note(context.library().launch(LibraryKernel::KeepActivity,
                                        /*blocks=*/1, threads,
                                        {base, keptMemory[kept.size()]}));
  kept.push_back(std::move(seen));
  keptGeneration = state.generation;
  return true;
}

/// Adopts all kept snapshots of activity in order, and calls the function that
/// was kept with each.
Status SparseMirror::adoptKept(bool &any) {
  std::vector<std::function<void()>> states;
  states.swap(kept);
  const auto &nodes = tree.sparseNodes();
  std::vector<uint64_t> state(static_cast<size_t>(keptBytes() / wordBytes));
  for (size_t i = 0; i < states.size(); ++i) {
    Status status =
        context.get().copyOut(state.data(), keptMemory[i],
                              static_cast<int64_t>(state.size()) * wordBytes);
    if (!status)
      return status;
    const uint64_t *at = state.data() + nodes.size();
    for (size_t n = 0; n < nodes.size(); ++n) {
      SparseNode &node = *nodes[n];
      int64_t unit = node.info().isList ? int64_t(sizeof(int32_t)) : wordBytes;
      const uint64_t *now = at, *gone = at + keptRow(node) / wordBytes;
      at = gone + keptRow(node) / wordBytes;
      if (!state[n])
        continue;
      any = true;
      SparseNode::Adopted adopted;
      node.adopt({0, node.activityBytes() / unit, now,
                  state[n] & TAI_DEVICE_CELLS_REMOVED ? gone : nullptr},
                 adopted, [&](int64_t cell) { touchCell(node, cell); });
      if (adopted.differs || adopted.removes)
        node.changed(adopted.by, adopted.removes);
      sharedEpochs[n] = node.knownEpoch();
    }
    states[i]();
  }
  return Status::success();
}
