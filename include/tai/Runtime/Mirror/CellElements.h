//===- CellElements.h - The elements of a field in its cells ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The addresses of a sparse field's elements, for each cell of the innermost
// sparse level above it, so that operations on the whole field can iterate over
// active cells.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_MIRROR_CELLELEMENTS_H
#define TAI_RUNTIME_MIRROR_CELLELEMENTS_H

#include "tai/Runtime/Storage/Field.h"

namespace mlir::tai::runtime {

class CellElements {
public:
  /// Describes the elements of a field in one cell. The field must lie below a
  /// sparse level.
  explicit CellElements(const Field &field);

  /// A contiguous piece of the field's elements in one cell; `offset` is from
  /// the address that `base` returns for the cell.
  struct Run {
    int64_t offset;
    int64_t bytes;
  };
  const std::vector<Run> &runs() const { return pieces; }
  int64_t bytes() const { return total; }

  /// The address of the first component of the first element in the cell. Call
  /// Field::writable before writing there.
  char *base(int64_t cell) const {
    char *address = const_cast<char *>(field->readable());
    if (uniform)
      return address + cell * cellStride;
    for (const LayoutLevel &level : outer)
      address += cell / level.cells % level.extent * level.stride;
    return address;
  }

  /// Copies the field's elements in a cell to or from a dense buffer of
  /// `bytes()` bytes.
  void load(int64_t cell, char *to) const;
  void store(int64_t cell, const char *from) const;
  bool equal(int64_t cell, const char *expected) const;
  void exchange(int64_t cell, char *contents) const;
  void clear(int64_t cell) const;
  bool isZero(int64_t cell) const;

  /// An element in a cell: its offset from the address that `base` returns, and
  /// its number relative to `firstNumber(cell)` in a row-major array of the
  /// field.
  struct Element {
    int64_t offset;
    int64_t number;
  };
  const std::vector<Element> &elements() const { return inner; }
  int64_t firstNumber(int64_t cell) const;

  /// True if all elements of one cell have the same index along the dimension.
  bool separates(int dimension) const;
  /// The index along a dimension that all elements of a cell have, counted from
  /// zero.
  int64_t position(int64_t cell, int dimension) const;

private:
  /// Calls body(offset, constant size, position in the buffer) for all
  /// contiguous pieces of a cell until `body` returns false.
  template <typename Body> bool forEachRun(const Body &body) const;

  const Field *field;
  std::vector<Run> pieces;
  int64_t total = 0;
  /// The distance of the contiguous pieces if there are many of one size at a
  /// uniform distance, as in an array of structures; else 0.
  int64_t step = 0;
  std::vector<Element> inner;
  /// The layout levels whose indices select a cell; `divisor` is the increment
  /// of an element's number when such an index grows by one.
  std::vector<LayoutLevel> outer;
  bool uniform = false;
  int64_t cellStride = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_MIRROR_CELLELEMENTS_H
