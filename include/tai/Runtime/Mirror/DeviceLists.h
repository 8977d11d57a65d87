//===- DeviceLists.h - Lists of active cells on a device --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Lists that the device computes from its activity, and lists that the host has
// computed and uploaded.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_MIRROR_DEVICELISTS_H
#define TAI_RUNTIME_MIRROR_DEVICELISTS_H

#include "tai/Runtime/Mirror/DeviceCells.h"
#include "tai/Runtime/Storage/Field.h"
#include "tai/Runtime/Threads/Section.h"

namespace mlir::tai::runtime {

/// The host's knowledge of the activity on a device. States are numbered: the
/// current state, the oldest state known to be equal to the current one, and
/// the last state at which cells were deactivated.
struct DeviceActivity {
  std::atomic<bool> behind{false};
  uint64_t generation = 1, unchangedFrom = 1, lastRemoval = 0;

  bool isBehind() const { return behind.load(std::memory_order_acquire); }
  void change(bool removes) {
    ++generation;
    if (removes)
      lastRemoval = generation;
  }
  /// True if the list `cells` is known to hold the cells that are active now.
  bool isShownBy(const DeviceCells &cells) const {
    return isBehind() ? cells.generation == generation
                      : cells.generation >= unchangedFrom;
  }
};

/// The position of a sparse level among the sparse levels of its tree.
size_t numberOf(const Tree &tree, const SparseNode &node);

class DeviceLists {
public:
  DeviceLists(DeviceContext &context, const Tree &tree,
              const DeviceActivity &activity)
      : context(context), tree(tree), activity(activity),
        pools(tree.sparseNodes().size()) {}
  ~DeviceLists();
  DeviceLists(const DeviceLists &) = delete;
  DeviceLists &operator=(const DeviceLists &) = delete;

  /// Sets the device address of the tree, and scratch memory for sums of tiles.
  void setMemory(DevicePtr treeBase, DevicePtr tileSums) {
    base = treeBase;
    sums = tileSums;
  }
  /// Gives the device address of an uploaded list of cells, preceded by its
  /// length. The caller keeps `list` alive.
  Status find(const ActiveListPtr &list, DevicePtr &address);
  /// Queues the computation of the list of active cells, after the work queued
  /// before; the host does not wait. `cells` is null if the device cannot
  /// compute lists.
  Status list(SparseNode &node, DeviceCellsPtr &cells);
  /// An estimate of the number of active cells, to choose the size of a grid.
  int64_t guessActive(const SparseNode &node) const;

private:
  Status queueList(const SparseNode &node, DeviceCells &cells);

  DeviceContext &context;
  const Tree &tree;
  const DeviceActivity &activity;
  Section making;
  DevicePtr base = 0, sums = 0;
  struct Pool {
    std::vector<std::shared_ptr<DeviceCells>> all;
    std::shared_ptr<DeviceCells> current;
  };
  std::vector<Pool> pools;
  struct Uploaded {
    ActiveListPtr list;
    DevicePtr memory;
  };
  std::vector<Uploaded> uploaded;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_MIRROR_DEVICELISTS_H
