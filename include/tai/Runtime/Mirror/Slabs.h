//===- Slabs.h - Parts of fields in buffers ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Numbers the elements of a field so that all elements with the same indices
// along some dimensions are consecutive, and copies ranges of such numbers, for
// any layout.
//
// In a sparse field, only elements in cells that have ever been active are
// numbered, in the order in which the cells were first seen. All other elements
// are zero.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_MIRROR_SLABS_H
#define TAI_RUNTIME_MIRROR_SLABS_H

#include "tai/Runtime/Mirror/CellMover.h"

namespace mlir::tai::runtime {

struct DeviceRows;

/// Consecutive slabs (parts of a field with some leading indices fixed) or, if
/// `first` is negative, the whole field.
struct SlabRange {
  int64_t first = -1, count = 0;

  static SlabRange one(int64_t slab) { return {slab, 1}; }
  bool isAll() const { return first < 0; }
  int64_t end() const { return first + count; }
  bool operator==(const SlabRange &other) const {
    return first == other.first && count == other.count;
  }
};

class Slabs {
public:
  /// Makes a slab for each position along `dimensions`, which ascend, in
  /// row-major order; one slab without dimensions. `byCell`: for a sparse
  /// field, whose slabs consist of whole cells, along one dimension at most.
  explicit Slabs(const Field &field, std::vector<int> dimensions = {},
                 bool byCell = false);
  /// Chooses the leading dimensions of `fixed`, the indices that an access
  /// fixes, along which the field is cut into slabs.
  static std::vector<int> choose(const Field &field,
                                 const std::vector<FixedIndex> &fixed);

  const std::vector<int> &dimensions() const { return slowDimensions; }
  /// The number of slabs of the field, and the number of elements in each slab.
  int64_t count() const { return slabs; }
  int64_t elements() const { return slabElements; }
  int64_t elementBytes() const { return bytes; }

  /// byCell: whether elements are numbered by cells of a sparse level.
  /// numCells: the number of numbered cells. cellsOf: the cells of a slab.
  bool byCell() const { return cells != nullptr; }
  int64_t numCells() const { return static_cast<int64_t>(numbered.size()); }
  const std::vector<int64_t> &cellsOf(int64_t slab) const {
    return slabCells[slab];
  }
  /// Numbers those cells of the list that have no number yet. Returns the
  /// number of cells that already had one.
  int64_t addCells(const ActiveListPtr &list);

  /// Copies `count` elements of the field, from number `first` on, to or from a
  /// dense buffer.
  void load(int64_t first, int64_t count, char *to) const;
  void store(int64_t first, int64_t count, const char *from) const;
  /// True if `count` elements from number `first` on equal the bytes at
  /// `expected`.
  bool equal(int64_t first, int64_t count, const char *expected) const;
  /// For fields below a sparse level only: exchange `count` elements with a
  /// buffer, compare them with zero, or zero them.
  void exchange(int64_t first, int64_t count, char *contents) const;
  bool isZero(int64_t first, int64_t count) const;
  void clear(int64_t first, int64_t count) const;
  /// Zeroes `count` elements from number `first` on; only for fields without a
  /// sparse level above.
  void zero(int64_t first, int64_t count) const;

  /// onDevice: true if the field is on a device that can save ranges of it in
  /// device memory, by the functions below. Unless inRowMajorOrder(), a range
  /// must be one slab.
  bool inRowMajorOrder() const { return isRowMajor; }
  bool onDevice() const {
    return mover || (isEven && field->tree().mirror() != nullptr);
  }
  Status keepOnDevice(int64_t first, int64_t count,
                      std::unique_ptr<DeviceBlock> &block) const;
  /// Gives zeroed device memory for such a range.
  Status zerosOnDevice(int64_t first, int64_t count,
                       std::unique_ptr<DeviceBlock> &block) const;
  void storeOnDevice(int64_t first, int64_t count,
                     const DeviceBlock &block) const;
  void exchangeOnDevice(int64_t first, int64_t count,
                        const DeviceBlock &block) const;

private:
  DeviceRows rowsOf(int64_t first, int64_t count) const;
  /// Changes a range of elements on the device: by `moveCells` if elements are
  /// numbered by cells, else by `moveRows`.
  template <typename MoveCells, typename MoveRows>
  void changeOnDevice(int64_t first, int64_t count, const MoveCells &moveCells,
                      const MoveRows &moveRows) const;
  template <typename Visit>
  bool forEachCell(int64_t first, int64_t count, const Visit &visit) const;
  template <typename Data, typename Run>
  bool forEachRun(Data *data, int64_t first, int64_t count,
                  const Run &run) const;

  const Field *field;
  std::vector<int> slowDimensions;
  /// True if elements are numbered in row-major order.
  bool isRowMajor;
  int64_t slabs = 1;
  int64_t slabElements = 1;
  int64_t bytes;
  /// isEven: whether elements have a uniform stride, as onDevice() requires.
  /// isContiguous: whether elements lie in memory in the order of their
  /// numbers, without gaps.
  bool isEven, isContiguous;
  /// A dimension of the field, the slowest in the numbering first: its extent,
  /// and the address offset of each index, by a constant step or a table.
  struct Dimension {
    int64_t extent;
    int64_t step;
    std::vector<int64_t> table;

    int64_t at(int64_t index) const {
      return table.empty() ? index * step : table[index];
    }
  };
  std::vector<Dimension> order;

  std::shared_ptr<CellElements> cells;
  /// For fields whose elements are numbered by cells, on a device: the object
  /// that moves cells, and the cell numbers `numbered` in device memory.
  std::shared_ptr<CellMover> mover;
  struct Numbers;
  std::shared_ptr<Numbers> numbersOnDevice;
  Status bringNumbers(int64_t first, int64_t count,
                      CellMover::Cells &found) const;
  /// numbered: the cells in the order of their numbers. known: the same cells,
  /// sorted.
  std::vector<int64_t> numbered, known;
  ActiveListPtr lastAdded;
  /// For each slab, the numbers of its cells.
  std::vector<std::vector<int64_t>> slabCells;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_MIRROR_SLABS_H
