//===- SlabSet.h - A set of elements, by fixed indices ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A slab is the set of all elements of a field with given positions along some
// of its dimensions: x[t, b, :]. Launches access slabs, and a set of elements
// is a union of them. Two slabs have elements in common if their positions
// agree along the dimensions that both fix. So, for each pair of shapes (sets
// of fixed dimensions), slabs are counted by their positions along the common
// ones.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_PLAN_SLABSET_H
#define TAI_LIB_RUNTIME_TAPE_PLAN_SLABSET_H

#include "tai/Runtime/Launch/Kernel.h"
#include <array>
#include <unordered_map>

namespace mlir::tai::runtime {

class SlabSet {
  /// Limits for shapes (sets of fixed dimensions) and for dimensions in them;
  /// accesses beyond the limits count as accesses to the whole field.
  static constexpr unsigned mostShapes = 8, mostDimensions = 8;

public:
  explicit SlabSet(const Field &field) : field(&field) { addShape({}); }

  /// Returns the number of the shape (the set of dimensions that an access
  /// fixes). Must be called for all accesses before the first slab is added.
  unsigned addShape(const std::vector<FixedIndex> &fixed);

  class Slab {
  public:
    bool isWhole() const { return shape == 0; }

  private:
    friend class SlabSet;
    unsigned shape = 0;
    std::array<int64_t, mostDimensions> positions;
  };
  /// Returns the slab that an access reaches in a launch; the whole field if an
  /// index is out of range.
  Slab locate(unsigned shape, const std::vector<FixedIndex> &fixed,
              const uint64_t *args) const;
  Slab whole() const { return {}; }

  void add(const Slab &slab);
  /// Removes elements of the slab from the set, but is allowed to keep any of
  /// them.
  void remove(const Slab &slab);
  /// True if the slab may have elements that are in the set.
  bool meets(const Slab &slab) const;

private:
  /// The numbers of slabs in the set, by their positions along the dimensions
  /// of `mask`.
  class Counts {
  public:
    Counts(unsigned mask, int64_t size);
    unsigned mask;
    bool has(uint64_t key) const;
    void change(uint64_t key, int by);

  private:
    std::vector<uint32_t> dense;
    std::unordered_map<uint64_t, uint32_t> sparse;
  };
  struct Shape {
    /// The dimensions that the shape fixes, as a bit mask over `dimensions`.
    unsigned mask;
    /// Counts of slabs of this shape (set of fixed dimensions) by their
    /// positions along the dimensions in common with each shape:
    /// counts[shared[i]] for shape i, and counts[own] for this shape.
    std::vector<Counts> counts;
    std::vector<unsigned> shared;
    unsigned own = 0;
  };
  uint64_t keyOf(const Slab &slab, unsigned mask) const;
  void change(Shape &shape, const Slab &slab, int by);
  void prepare();

  const Field *field;
  /// The dimensions of the field that some shape fixes.
  std::vector<int64_t> dimensions;
  std::vector<Shape> shapes;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_PLAN_SLABSET_H
