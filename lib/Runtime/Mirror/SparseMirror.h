//===- SparseMirror.h - A sparse tree on a device ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A sparse tree has memory for all of its cells on the device, zero where
// nothing is active. Device code changes activity there and makes lists of
// active cells; the host gets to know of it when it asks. What moves between
// them is what may hold something: pieces of the tree that have ever been
// active.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_MIRROR_SPARSEMIRROR_H
#define TAI_LIB_RUNTIME_MIRROR_SPARSEMIRROR_H

#include "DeviceLists.h"
#include "tai/ABI/DeviceSparse.h"
#include "tai/Runtime/Storage/Field.h"
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

  /// Whether the tree can be on this device at all.
  static Status check(const DeviceContext &context, const std::string &name,
                      int64_t bytes, const std::vector<SparseInfo> &levels);

  /// Zeroed memory for the tree, with what device code must know around it.
  Status allocate(DevicePtr &base);
  Status upload();
  /// Activity is brought along.
  Status download();

  /// Work has been queued that may change activity, or `removes` cells.
  void deviceActivates(bool removes) {
    state.change(removes);
    state.behind.store(true, std::memory_order_release);
  }
  void hostChanges(bool removes) override;
  /// Keeps what has happened to activity so far on the device, without waiting:
  /// when somebody asks, the host goes to that state first, and `seen` is
  /// called while it is there. False where the host has to look at once.
  bool keepActivity(std::function<void()> seen);
  bool canKeepActivity() const;
  bool isBehind() const override { return state.isBehind(); }
  uint64_t getGeneration() const override { return state.generation; }
  uint64_t getLastRemoval() const override { return state.lastRemoval; }
  /// Makes what the host knows of activity current.
  Status fetchActivity() { return isBehind() ? fetch() : Status::success(); }
  void bringActivity() override { context.note(fetchActivity()); }

  bool isCurrent() const override;
  bool deactivateAll(SparseNode &node) override;
  void uploadActivity(const SparseNode &node,
                      const std::vector<int64_t> &changed) override;

  /// Where it is, sets the elements of all active cells of a field there. False
  /// where that is better done on the host.
  bool fillActive(const Field &field, const CellElements &elements,
                  const void *scalarBytes);

  DeviceLists &lists() { return cellLists; }
  /// Whether a list is known to show what is active.
  bool isShownBy(const DeviceCells &cells) const {
    return state.isShownBy(cells);
  }

  DeviceContext &getContext() const { return context; }
  /// What moves the elements of a field and of those in the same place; see
  /// CellMover.
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
  /// Copies the activity of a level, without parts that nobody has changed.
  Status sendBits(const SparseNode &node);
  void touch(int64_t begin, int64_t end);
  void touchOutside(int64_t begin, int64_t end, const SparseNode *above,
                    int64_t cell);
  void touchCell(const SparseNode &node, int64_t cell);
  Status
  forEachRun(const std::function<Status(int64_t offset, int64_t bytes)> &body);

  DeviceContext &context;
  Tree &tree;
  std::recursive_mutex mutex;
  DeviceActivity state;
  DeviceLists cellLists;
  DevicePtr block = 0, base = 0;
  /// The memory takes room where it is touched; then, which pieces are known to
  /// have done so lies behind the account.
  bool isReserved = false;
  int64_t pieceBytes = 0, numPieces = 0;
  /// Behind the tree: a TaiDeviceActivity of each level, then what was removed
  /// from each, its marks, and sums of tiles of the largest.
  DevicePtr activity = 0, account = 0, pieces = 0;
  std::vector<DevicePtr> removed, marks;
  /// Epochs of the levels for which both sides have the same activity.
  std::vector<uint64_t> sharedEpochs;
  /// States that are kept, in their order, and memory for them, which serves
  /// the next ones again: the same work is then the same.
  std::vector<std::function<void()>> kept;
  std::vector<DevicePtr> keptMemory;
  uint64_t keptGeneration = 0;
  bool isFetching = false;
  /// Parts of the tree that may hold something else than zeros on either side:
  /// where each begins, and where it ends.
  std::map<int64_t, int64_t> touched;
  /// What device code knows of the tree.
  std::vector<DevicePtr> descriptions;
  std::map<std::array<int64_t, 3>, std::shared_ptr<CellMover>> movers;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_MIRROR_SPARSEMIRROR_H
