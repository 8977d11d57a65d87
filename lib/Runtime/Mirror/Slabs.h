//===- Slabs.h - Parts of fields, moved to and from buffers -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Numbers the elements of a field so that all with the same index along one
// dimension stand together, and copies ranges of such numbers, whatever the
// layout is.
//
// Of a sparse field, only cells count that have ever been active: what is
// numbered is its part of each such cell, in the order in which they were first
// seen. The others hold zeros.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_MIRROR_SLABS_H
#define TAI_LIB_RUNTIME_MIRROR_SLABS_H

#include "CellMover.h"

namespace mlir::tai::runtime {

struct DeviceRows;

class Slabs {
public:
  /// One slab for each position along the dimension; a single one for -1.
  Slabs(const Field &field, int dimension, bool byCell = false);

  int dimension() const { return slowDimension; }
  /// Number of slabs, and of elements in each.
  int64_t count() const { return slabs; }
  int64_t elements() const { return slabElements; }
  int64_t elementBytes() const { return bytes; }

  /// Where cells are numbered: how many there are, and those of one slab.
  bool byCell() const { return cells != nullptr; }
  int64_t numCells() const { return static_cast<int64_t>(numbered.size()); }
  const std::vector<int64_t> &cellsOf(int64_t slab) const {
    return slabCells[slab];
  }
  /// Numbers the cells of the list that have no number yet. Returns how many
  /// had one.
  int64_t addCells(const ActiveListPtr &list);

  /// Copies `count` elements from number `first` on, densely.
  void load(int64_t first, int64_t count, char *to) const;
  void store(int64_t first, int64_t count, const char *from) const;
  /// True where they hold these bytes.
  bool equal(int64_t first, int64_t count, const char *expected) const;
  /// Stores elements and takes what they held, and compares with zeros or
  /// stores them; where cells are numbered.
  void exchange(int64_t first, int64_t count, char *contents) const;
  bool isZero(int64_t first, int64_t count) const;
  void clear(int64_t first, int64_t count) const;
  /// Stores zeros, where cells are not numbered.
  void zero(int64_t first, int64_t count) const;

  /// Whether a device has the field and can keep ranges of it in its own
  /// memory; how it does that, brings them back, or does both. Where the
  /// dimension is not the first, a range is one slab.
  bool onDevice() const {
    return mover || (isEven && field->tree().mirror() != nullptr);
  }
  Status keepOnDevice(int64_t first, int64_t count,
                      std::unique_ptr<DeviceBlock> &block) const;
  /// Memory for as many elements, holding zeros.
  Status zerosOnDevice(int64_t count,
                       std::unique_ptr<DeviceBlock> &block) const;
  void storeOnDevice(int64_t first, int64_t count,
                     const DeviceBlock &block) const;
  void exchangeOnDevice(int64_t first, int64_t count,
                        const DeviceBlock &block) const;

private:
  DeviceRows rowsOf(int64_t first, int64_t count) const;
  /// Changes a range there: by `moveCells` where cells are numbered.
  template <typename MoveCells, typename MoveRows>
  void changeOnDevice(int64_t first, int64_t count, const MoveCells &moveCells,
                      const MoveRows &moveRows) const;
  template <typename Visit>
  bool forEachCell(int64_t first, int64_t count, const Visit &visit) const;
  template <typename Data, typename Run>
  bool forEachRun(Data *data, int64_t first, int64_t count,
                  const Run &run) const;

  const Field *field;
  int slowDimension;
  int64_t slabs = 1;
  int64_t slabElements = 1;
  int64_t bytes;
  /// What `onDevice` asks of the layout; and whether numbers count up in
  /// row-major order, and elements lie without gaps.
  bool isEven, isContiguous;
  /// For each dimension, the slow one first: its extent, and how an index moves
  /// the address: by a constant step, or by a table.
  struct Dimension {
    int64_t extent;
    int64_t step;
    std::vector<int64_t> table;

    int64_t at(int64_t index) const {
      return table.empty() ? index * step : table[index];
    }
  };
  std::vector<Dimension> dimensions;

  std::shared_ptr<CellElements> cells;
  /// Where cells are numbered and a device has them; and `numbered` there.
  std::shared_ptr<CellMover> mover;
  struct Numbers;
  std::shared_ptr<Numbers> numbersOnDevice;
  Status bringNumbers(int64_t first, int64_t count,
                      CellMover::Cells &found) const;
  /// By number, and ascending.
  std::vector<int64_t> numbered, known;
  ActiveListPtr lastAdded;
  /// Numbers, for each slab.
  std::vector<std::vector<int64_t>> slabCells;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_MIRROR_SLABS_H
