//===- CellMover.h - Cells of a field on a device ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What CellElements does for one cell in the memory of the host, for many cells
// in the memory of a device.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_MIRROR_CELLMOVER_H
#define TAI_LIB_RUNTIME_MIRROR_CELLMOVER_H

#include "CellElements.h"
#include "DeviceContext.h"

namespace mlir::tai::runtime {

class Mirror;

class CellMover {
public:
  /// The one for a field. Null where it is not on a device that can do this,
  /// which is no failure.
  static Status find(const Field &field, const CellElements &elements,
                     std::shared_ptr<CellMover> &mover);

  /// Cells by their numbers, in memory of the device; for a negative count, it
  /// stands in the word in front of them.
  struct Cells {
    DevicePtr numbers;
    int64_t count;
  };
  /// A copy of numbers of the host's, for as long as `memory` lives.
  Status bring(const int64_t *numbers, int64_t count,
               std::unique_ptr<DeviceBlock> &memory, Cells &cells) const;

  // The elements of these cells, to or from a dense array in the memory of the
  // device, or both at once. The device is made current, and with all but
  // `load` the host is not.
  Status load(Cells cells, DevicePtr to) const;
  Status store(Cells cells, DevicePtr from) const;
  Status exchange(Cells cells, DevicePtr with) const;
  /// Every scalar of them becomes this one.
  Status fill(Cells cells, const void *value) const;

  /// The same with numbers and contents in the memory of the host.
  Status load(const std::vector<int64_t> &cells, char *to) const;
  Status store(const std::vector<int64_t> &cells, const char *from) const;
  Status clear(const std::vector<int64_t> &cells) const;

  /// Of one cell.
  int64_t bytes() const { return cellBytes; }

private:
  CellMover(Mirror &mirror, int64_t scalarBytes, int64_t cellBytes)
      : mirror(mirror), scalarBytes(scalarBytes), cellBytes(cellBytes) {}
  Status run(Cells cells, DevicePtr other, uint64_t what) const;
  /// Calls `move` with the cells, and an array for them, on the device.
  template <typename Move>
  Status moveDense(const std::vector<int64_t> &cells, const Move &move) const;

  Mirror &mirror;
  int64_t scalarBytes, cellBytes;
  /// A TaiDeviceCellMove and its table.
  std::unique_ptr<DeviceBlock> description;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_MIRROR_CELLMOVER_H
