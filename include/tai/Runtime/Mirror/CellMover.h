//===- CellMover.h - Cells of a field on a device ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The counterpart of CellElements on a device: copies many cells at once.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_MIRROR_CELLMOVER_H
#define TAI_RUNTIME_MIRROR_CELLMOVER_H

#include "tai/Runtime/Mirror/CellElements.h"
#include "tai/Runtime/Mirror/DeviceContext.h"

namespace mlir::tai::runtime {

class Mirror;

class CellMover {
public:
  /// Finds the object that moves cells of a field. Succeeds with null if the
  /// field is not on a device that can move cells.
  static Status find(const Field &field, const CellElements &elements,
                     std::shared_ptr<CellMover> &mover);

  /// Numbers of cells, stored in device memory at `numbers`; if `count` is
  /// negative, the word in front of the numbers is the count.
  struct Cells {
    DevicePtr numbers;
    int64_t count;
  };
  /// Copies the numbers of cells from the host to the device. `cells` is valid
  /// while `memory` lives.
  Status bring(const int64_t *numbers, int64_t count,
               std::unique_ptr<DeviceBlock> &memory, Cells &cells) const;

  // Copy the elements of these cells to or from a dense array in device memory,
  // or exchange them. The functions make the device current, and, except for
  // `load`, the host stale.
  Status load(Cells cells, DevicePtr to) const;
  Status store(Cells cells, DevicePtr from) const;
  Status exchange(Cells cells, DevicePtr with) const;
  /// Sets every scalar of the field in the given cells to one value.
  Status fill(Cells cells, const void *value) const;

  /// Copy the field's elements in cells to or from host memory, or zero them;
  /// `cells` lists the cells' numbers in host memory.
  Status load(const std::vector<int64_t> &cells, char *to) const;
  Status store(const std::vector<int64_t> &cells, const char *from) const;
  Status clear(const std::vector<int64_t> &cells) const;

  /// Bytes of one cell.
  int64_t bytes() const { return cellBytes; }

private:
  CellMover(Mirror &mirror, int64_t scalarBytes, int64_t cellBytes)
      : mirror(mirror), scalarBytes(scalarBytes), cellBytes(cellBytes) {}
  Status run(Cells cells, DevicePtr other, uint64_t what) const;
  /// Calls `move` with the cells and a dense array of their elements on the
  /// device.
  template <typename Move>
  Status moveDense(const std::vector<int64_t> &cells, const Move &move) const;

  Mirror &mirror;
  int64_t scalarBytes, cellBytes;
  /// Device memory that describes the field to the kernels that move cells: a
  /// TaiDeviceCellMove and its table.
  std::unique_ptr<DeviceBlock> description;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_MIRROR_CELLMOVER_H
