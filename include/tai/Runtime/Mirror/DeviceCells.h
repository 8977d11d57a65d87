//===- DeviceCells.h - Lists of active cells on a device --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A list that is computed and used on the device, and not copied to the host.
// Launches queued after the list was requested can use it.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_MIRROR_DEVICECELLS_H
#define TAI_RUNTIME_MIRROR_DEVICECELLS_H

#include "tai/ABI/DeviceSparse.h"
#include "tai/Runtime/Mirror/DeviceContext.h"
#include "tai/Runtime/Sparse/LoopLists.h"

namespace mlir::tai::runtime {

class DeviceCells {
public:
  /// Allocates a list for up to `capacity` cells, with version 0, which no
  /// state of activity has.
  static Status make(std::shared_ptr<DeviceContext> context, int64_t capacity,
                     std::shared_ptr<DeviceCells> &list);
  ~DeviceCells() { context->free(memory); }
  DeviceCells(const DeviceCells &) = delete;
  DeviceCells &operator=(const DeviceCells &) = delete;

  DevicePtr header() const { return cells() - sizeof(TaiDeviceListHeader); }
  DevicePtr cells() const { return memory + cellsOffset; }
  int64_t capacity() const { return most; }
  Device &device() const { return context->get(); }

  /// The value of DeviceActivity::generation when the list of cells was last
  /// requested.
  uint64_t generation = 0;

  static constexpr DevicePtr cellsOffset = 256;

private:
  DeviceCells(std::shared_ptr<DeviceContext> context, DevicePtr memory,
              int64_t most)
      : context(std::move(context)), memory(memory), most(most) {}

  std::shared_ptr<DeviceContext> context;
  DevicePtr memory;
  int64_t most;
};

/// Waits for the device, and copies a list of active cells from it.
Status fetchCells(const DeviceCells &list, std::vector<int64_t> &cells);

/// Sets `differs` if loops over the level have not all visited the same cells.
Status findDifference(const LoopLists &lists, const SparseNode &node,
                      bool &differs);

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_MIRROR_DEVICECELLS_H
