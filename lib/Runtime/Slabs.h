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
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_SLABS_H
#define TAI_LIB_RUNTIME_SLABS_H

#include "tai/Runtime/Field.h"

namespace mlir::tai::runtime {

class Slabs {
public:
  /// One slab for each position along the dimension; a single one for -1.
  Slabs(const Field &field, int dimension);

  int dimension() const { return slowDimension; }
  /// Number of slabs, and of elements in each.
  int64_t count() const { return slabs; }
  int64_t elements() const { return slabElements; }
  int64_t elementBytes() const { return bytes; }

  /// Copies `count` elements from number `first` on, densely.
  void load(int64_t first, int64_t count, char *to) const;
  void store(int64_t first, int64_t count, const char *from) const;
  /// True where they hold these bytes.
  bool equal(int64_t first, int64_t count, const char *expected) const;

private:
  template <typename Run>
  bool forEachRun(int64_t first, int64_t count, const Run &run) const;

  const Field *field;
  int slowDimension;
  int64_t slabs = 1;
  int64_t slabElements = 1;
  int64_t bytes;
  /// Numbers count up in row-major order.
  bool isContiguous;
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
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_SLABS_H
