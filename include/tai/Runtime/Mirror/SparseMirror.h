//===- SparseMirror.h - A sparse tree on a device ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A sparse tree has device memory for all of its cells, zero where nothing is
// active. Device code changes activity and computes lists of active cells
// there; the host fetches the activity on demand. Only parts of the tree that
// have ever been active are copied between host and device.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_MIRROR_SPARSEMIRROR_H
#define TAI_RUNTIME_MIRROR_SPARSEMIRROR_H

#include "tai/ABI/DeviceSparse.h"
#include "tai/Runtime/Mirror/DeviceLists.h"
#include "tai/Runtime/Storage/Field.h"
#include "tai/Runtime/Threads/Section.h"
#include <array>
#include <functional>
#include <map>

namespace mlir::tai::runtime {

class CellElements;
class CellMover;

class SparseMirror final : public SparseOnDevice {
public:
  SparseMirror(DeviceContext &context, Tree &tree);
  ~SparseMirror() override;
  SparseMirror(const SparseMirror &) = delete;
  SparseMirror &operator=(const SparseMirror &) = delete;

  /// Fails if a sparse tree of this size cannot be on the device.
  static Status check(const DeviceContext &context, const std::string &name,
                      int64_t bytes, const std::vector<SparseInfo> &levels);

  /// Allocates zeroed memory for the tree, with its descriptor (TaiDeviceTree).
  Status allocate(DevicePtr &base);
  Status upload();
  /// Copies the tree to the host, after fetching its activity.
  Status download();

  /// Notes that queued work may change activity; `removes`: it may deactivate
  /// cells.
  void deviceActivates(bool removes) {
    state.change(removes);
    state.behind.store(true, std::memory_order_release);
  }
  void hostChanges(bool removes) override;
  /// Queues a snapshot of the activity so far on the device, without waiting:
  /// when the host later fetches activity, it first adopts the snapshot, and
  /// calls `seen` in that state. False if the host must fetch at once.
  bool keepActivity(std::function<void()> seen);
  bool canKeepActivity() const;
  bool isBehind() const override { return state.isBehind(); }
  uint64_t getGeneration() const override { return state.generation; }
  uint64_t getLastRemoval() const override { return state.lastRemoval; }
  /// Fetches the activity from the device, if the host's copy is stale.
  Status fetchActivity() { return isBehind() ? fetch() : Status::success(); }
  void bringActivity() override { context.note(fetchActivity()); }

  bool isCurrent() const override;
  bool deactivateAll(SparseNode &node) override;
  void uploadActivity(const SparseNode &node,
                      const std::vector<int64_t> &changed) override;

  /// Fills the elements of a field in all active cells, on the device. False if
  /// that is better done on the host.
  bool fillActive(const Field &field, const CellElements &elements,
                  const void *scalarBytes);

  DeviceLists &lists() { return cellLists; }
  /// True if the list of active cells is known to be up to date.
  bool isShownBy(const DeviceCells &cells) const {
    return state.isShownBy(cells);
  }

  /// The cell mover of a field, shared by fields of the same place.
  std::shared_ptr<CellMover> &moverOf(const Field &field);

private:
  Status fetch();
  Status fetchLevel(SparseNode &node, bool removes);
  Status adoptKept(bool &any);
  int64_t keptBytes() const;
  Status allocateBlock(int64_t bytes);
  Status countPieces();
  Status writeDescriptor();
  Status sendActivity();
  Status sendAccount();
  Status sendWords(const SparseNode &node, const std::vector<int64_t> &changed);
  /// Uploads the activity of a level to the device, except unchanged parts.
  Status sendBits(const SparseNode &node);
  void touch(int64_t begin, int64_t end);
  void touchOutside(int64_t begin, int64_t end, const SparseNode *above,
                    int64_t cell);
  void touchCell(const SparseNode &node, int64_t cell);
  Status
  forEachRun(const std::function<Status(int64_t offset, int64_t bytes)> &body);

  DeviceContext &context;
  Tree &tree;
  Section moving;
  DeviceActivity state;
  DeviceLists cellLists;
  DevicePtr block = 0, base = 0;
  /// True if the device memory is reserved, and committed on use; a bit for
  /// each committed piece then follows the memory account.
  bool isReserved = false;
  int64_t pieceBytes = 0, numPieces = 0;
  /// Device memory that follows the tree: a TaiDeviceActivity, removed cells
  /// and marks for each level; the memory account; bits of the committed
  /// pieces.
  DevicePtr activity = 0, account = 0, pieces = 0;
  std::vector<DevicePtr> removed, marks;
  /// For each level, the epoch at which host and device had the same activity.
  std::vector<uint64_t> sharedEpochs;
  /// Snapshots of activity in order, and their device memory, which is reused
  /// in the same order, so that repeated work has the same addresses.
  std::vector<std::function<void()>> kept;
  std::vector<DevicePtr> keptMemory;
  uint64_t keptGeneration = 0;
  bool isFetching = false;
  /// Ranges of the tree (begin to end) that may be non-zero on either side.
  std::map<int64_t, int64_t> touched;
  /// Memory of the descriptor.
  std::vector<DevicePtr> descriptions;
  std::map<std::array<int64_t, 3>, std::shared_ptr<CellMover>> movers;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_MIRROR_SPARSEMIRROR_H
