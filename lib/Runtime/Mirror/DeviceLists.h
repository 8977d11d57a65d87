//===- DeviceLists.h - Lists of active cells on a device --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Those that the device makes of what is active there, and those that the host
// has made and sent.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_MIRROR_DEVICELISTS_H
#define TAI_LIB_RUNTIME_MIRROR_DEVICELISTS_H

#include "DeviceCells.h"
#include "tai/Runtime/Storage/Field.h"

namespace mlir::tai::runtime {

/// How far the host knows what is active on a device. States are numbered: the
/// last one, the one from which on they are known to be the same, and the one
/// at which cells were last made inactive.
struct DeviceActivity {
  std::atomic<bool> behind{false};
  uint64_t generation = 1, unchangedFrom = 1, lastRemoval = 0;

  bool isBehind() const { return behind.load(std::memory_order_acquire); }
  void change(bool removes) {
    ++generation;
    if (removes)
      lastRemoval = generation;
  }
  /// Whether a list is known to show what is active.
  bool isShownBy(const DeviceCells &cells) const {
    return isBehind() ? cells.generation == generation
                      : cells.generation >= unchangedFrom;
  }
};

/// The place of a level among those of its tree.
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

  /// Where the tree is on the device, and room for sums of its tiles.
  void setMemory(DevicePtr treeBase, DevicePtr tileSums) {
    base = treeBase;
    sums = tileSums;
  }
  /// Where the device finds a list, which the caller keeps, with its length in
  /// front.
  Status find(const ActiveListPtr &list, DevicePtr &address);
  /// The list of cells that are active when the work queued before is done,
  /// made there: the host waits for nothing. Null where this device cannot.
  Status list(SparseNode &node, DeviceCellsPtr &cells);
  /// How many cells may be active, for who decides how much should run.
  int64_t guessActive(const SparseNode &node) const;

private:
  Status queueList(const SparseNode &node, DeviceCells &cells);

  DeviceContext &context;
  const Tree &tree;
  const DeviceActivity &activity;
  std::mutex mutex;
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

#endif // TAI_LIB_RUNTIME_MIRROR_DEVICELISTS_H
