//===- Mirror.h - The memory of a tree on a device --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A tree has memory on the host and, from its first use there, on the device.
// At least one of them is current. Launches make the device current, and writes
// there make the host stale; a host access copies the tree back, or only the
// accessed elements.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_MIRROR_MIRROR_H
#define TAI_RUNTIME_MIRROR_MIRROR_H

#include "tai/Runtime/Mirror/DeviceContext.h"
#include "tai/Runtime/Mirror/SparseMirror.h"
#include "tai/Runtime/Storage/Field.h"
#include "tai/Runtime/Threads/Section.h"
#include <optional>
#include <utility>
#include <vector>

namespace mlir::tai::runtime {

/// The indices of a field along one dimension that the process owns, as a rank
/// of a mesh.
struct OwnedIndices {
  int dimension = 0;
  int64_t first = 0, count = 0;
};

class Mirror {
public:
  Mirror(std::shared_ptr<DeviceContext> context, Tree &tree)
      : deviceContext(std::move(context)), tree(tree),
        sparseTree(tree.sparseNodes().empty()
                       ? nullptr
                       : std::make_unique<SparseMirror>(*deviceContext, tree)) {
  }
  ~Mirror();

  DeviceContext &context() const { return *deviceContext; }
  const std::shared_ptr<DeviceContext> &sharedContext() const {
    return deviceContext;
  }
  Tree &mirrored() const { return tree; }
  /// The part of the mirror for sparse levels of the tree; null for a tree
  /// without them.
  SparseMirror *sparse() const { return sparseTree.get(); }
  Device &device() const { return deviceContext->get(); }
  bool onHost() const { return hostCurrent.load(std::memory_order_acquire); }
  bool onDevice() const {
    return deviceCurrent.load(std::memory_order_acquire);
  }

  /// Notes a field of the tree, before the tree has device memory, and the part
  /// of it that the process owns, if it owns no more. A large tree of which the
  /// process owns a part has memory for this part alone, and for the elements
  /// beside it that loops access.
  void noteField(const Field &field, std::optional<OwnedIndices> part);
  /// The part of a field that the process owns; null for all of it. Fills and
  /// saved values leave out other elements.
  const OwnedIndices *partOf(const Field &field) const {
    for (const auto &[known, part] : parts)
      if (known == &field)
        return &part;
    return nullptr;
  }

  /// Makes the host's copy of the tree current.
  Status toHost() { return onHost() ? Status::success() : download(); }
  /// Marks the device's copy as stale, before the host writes; the host's copy
  /// must be current.
  void hostWrites() {
    hostCurrent.store(true, std::memory_order_relaxed);
    deviceCurrent.store(false, std::memory_order_relaxed);
    pristine = false;
    ++changes;
  }
  /// Gets the tree's device memory, allocated if necessary and possibly stale.
  Status allocate(DevicePtr &address);
  /// Makes the device's copy of the tree current.
  Status toDevice() { return onDevice() ? Status::success() : upload(); }
  /// Marks the host's copy of the tree as stale, after work that writes it was
  /// queued on the device.
  void deviceWrites() {
    hostCurrent.store(false, std::memory_order_relaxed);
    reads = writes = 0;
    pristine.store(false, std::memory_order_relaxed);
    ++changes;
  }

  /// Other libraries have the tree's device address, and may write there at any
  /// time: the host's copy is then always stale.
  bool isExported() const {
    return exports.load(std::memory_order_relaxed) > 0;
  }
  /// Notes that another library gets the device address of the tree; the
  /// device's copy must be current.
  void addExport() {
    exports.fetch_add(1, std::memory_order_relaxed);
    deviceWrites();
    context().note(context().queue().share());
  }
  void removeExport() {
    exports.fetch_sub(1, std::memory_order_relaxed);
    context().queue().unshare();
  }

  /// Read or write a few bytes of the tree, on the host or the device,
  /// whichever is cheaper.
  Status read(int64_t offset, void *to, int64_t bytes);
  Status write(int64_t offset, const void *from, int64_t bytes);

  /// Copies a whole field to an array of the host, or fills it, on the device.
  /// False if that is better done on the host. A handler may destroy the tree
  /// in the middle of a copy, so the caller shares the mirror.
  bool copyOut(const Field &field, void *array);
  bool fill(const Field &field, const void *scalarBytes);
  /// Copies an array of the host to the field on the device. No value if the
  /// host should do all of the copy instead; false if the host has interrupted
  /// it, which needs `canStop`. Handlers run during the copy, whatever
  /// `canStop` is.
  std::optional<bool> copyIn(const Field &field, const void *array,
                             bool canStop);

  /// The elements that the process owns among [first, first + count), as
  /// rows(); all of them if the owned ones are no strided region.
  DeviceRows ownedRows(const Field &field, int64_t first, int64_t count) const;
  /// Elements [first, first + count) of a field with a uniform stride, as a
  /// strided region of the tree's device memory, which must be allocated.
  DeviceRows rows(const Field &field, int64_t first, int64_t count) const {
    int64_t bytes = field.numComponents() * byteSize(field.scalar());
    int64_t step = field.evenStep();
    DevicePtr address = at(field.layout().placeOffset + first * step);
    if (step == bytes)
      return {address, 0, count * bytes, 1};
    return {address, step, bytes, count};
  }
  /// The device address of the byte at `offset` in the tree; device memory must
  /// be allocated.
  DevicePtr at(int64_t offset) const {
    return memory + static_cast<DevicePtr>(offset);
  }

  /// True if elements that the process does not own have no memory.
  bool isPartial() const { return room == Room::Owned; }

private:
  /// `count` pieces of `bytes` bytes of the tree, with `step` bytes from the
  /// start of one to the start of the next.
  struct Pieces {
    int64_t first, bytes, step, count;
  };

  Status download();
  Status upload();
  Status allocateMemory();
  /// Calls move(offset, bytes) for all bytes of the tree that the process owns,
  /// until one fails.
  template <typename Move> Status forEachPiece(const Move &move) const;

  std::shared_ptr<DeviceContext> deviceContext;
  Tree &tree;
  std::unique_ptr<SparseMirror> sparseTree;
  Section moving;
  std::atomic<bool> hostCurrent{true}, deviceCurrent{false};
  std::atomic<int> exports{0};
  /// True until the tree is first written: until then, it holds zeros.
  std::atomic<bool> pristine{true};
  /// The numbers of single elements read and written since the last launch.
  int64_t reads = 0, writes = 0;
  /// Counts writes on either side, so that a copy notices a handler's writes.
  uint64_t changes = 0;
  DevicePtr memory = 0;
  std::vector<Pieces> owned;
  std::vector<std::pair<const Field *, OwnedIndices>> parts;
  /// The elements that have memory on the device.
  enum class Room { All, OwnedIfLarge, Owned };
  Room room = Room::All;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_MIRROR_MIRROR_H
