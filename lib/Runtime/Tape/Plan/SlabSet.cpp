//===- SlabSet.cpp - A set of elements, by fixed indices ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "SlabSet.h"
#include <algorithm>

using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Counts
//===----------------------------------------------------------------------===//

SlabSet::Counts::Counts(unsigned mask, int64_t size) : mask(mask) {
  constexpr int64_t mostDense = 1 << 14;
  if (size <= mostDense)
    dense.resize(static_cast<size_t>(size));
}

bool SlabSet::Counts::has(uint64_t key) const {
  if (!dense.empty())
    return dense[key] != 0;
  return !sparse.empty() && sparse.count(key) != 0;
}

void SlabSet::Counts::change(uint64_t key, int by) {
  if (!dense.empty()) {
    dense[key] += static_cast<uint32_t>(by);
    return;
  }
  auto at = sparse.try_emplace(key, 0).first;
  at->second += static_cast<uint32_t>(by);
  if (at->second == 0)
    sparse.erase(at);
}

//===----------------------------------------------------------------------===//
// Shapes
//===----------------------------------------------------------------------===//

unsigned SlabSet::addShape(const std::vector<FixedIndex> &fixed) {
  unsigned mask = 0;
  for (const FixedIndex &index : fixed) {
    auto at = std::find(dimensions.begin(), dimensions.end(), index.dimension);
    if (at == dimensions.end()) {
      if (dimensions.size() == mostDimensions)
        return 0;
      at = dimensions.insert(at, index.dimension);
    }
    mask |= 1U << (at - dimensions.begin());
  }
  auto known =
      std::find_if(shapes.begin(), shapes.end(),
                   [&](const Shape &shape) { return shape.mask == mask; });
  if (known != shapes.end())
    return static_cast<unsigned>(known - shapes.begin());
  if (shapes.size() == mostShapes)
    return 0;
  shapes.push_back({mask, {}, {}});
  return static_cast<unsigned>(shapes.size() - 1);
}

/// Allocates the counts of slabs for all shapes. Must be called after all
/// shapes (sets of fixed dimensions) have been added.
void SlabSet::prepare() {
  for (Shape &shape : shapes) {
    for (const Shape &other : shapes) {
      unsigned mask = shape.mask & other.mask;
      auto at = std::find_if(
          shape.counts.begin(), shape.counts.end(),
          [&](const Counts &counts) { return counts.mask == mask; });
      shape.shared.push_back(static_cast<unsigned>(at - shape.counts.begin()));
      if (&other == &shape)
        shape.own = shape.shared.back();
      if (at != shape.counts.end())
        continue;
      int64_t size = 1;
      for (size_t d = 0; d < dimensions.size(); ++d)
        if (mask >> d & 1)
          size *= std::max<int64_t>(field->shape()[dimensions[d]], 1);
      shape.counts.emplace_back(mask, size);
    }
  }
}

SlabSet::Slab SlabSet::locate(unsigned shape,
                              const std::vector<FixedIndex> &fixed,
                              const uint64_t *args) const {
  Slab slab;
  if (shape == 0)
    return slab;
  for (const FixedIndex &index : fixed) {
    int64_t position =
        index.evaluate(args) - field->firstIndex(index.dimension);
    if (position < 0 || position >= field->shape()[index.dimension])
      return slab;
    auto at = std::find(dimensions.begin(), dimensions.end(), index.dimension);
    slab.positions[at - dimensions.begin()] = position;
  }
  slab.shape = shape;
  return slab;
}

uint64_t SlabSet::keyOf(const Slab &slab, unsigned mask) const {
  uint64_t key = 0;
  for (size_t d = 0; d < dimensions.size(); ++d)
    if (mask >> d & 1)
      key = key * static_cast<uint64_t>(field->shape()[dimensions[d]]) +
            static_cast<uint64_t>(slab.positions[d]);
  return key;
}

//===----------------------------------------------------------------------===//
// Elements
//===----------------------------------------------------------------------===//

void SlabSet::change(Shape &shape, const Slab &slab, int by) {
  for (Counts &counts : shape.counts)
    counts.change(keyOf(slab, counts.mask), by);
}

void SlabSet::add(const Slab &slab) {
  Shape &shape = shapes[slab.shape];
  if (shape.shared.empty())
    prepare();
  const Counts &own = shape.counts[shape.own];
  if (!own.has(keyOf(slab, own.mask)))
    change(shape, slab, 1);
}

void SlabSet::remove(const Slab &slab) {
  if (slab.shape == 0) {
    for (Shape &shape : shapes) {
      shape.counts.clear();
      shape.shared.clear();
    }
    return;
  }
  Shape &shape = shapes[slab.shape];
  if (shape.shared.empty())
    return;
  const Counts &own = shape.counts[shape.own];
  if (own.has(keyOf(slab, own.mask)))
    change(shape, slab, -1);
}

bool SlabSet::meets(const Slab &slab) const {
  return std::any_of(shapes.begin(), shapes.end(), [&](const Shape &shape) {
    if (shape.shared.empty())
      return false;
    const Counts &counts = shape.counts[shape.shared[slab.shape]];
    return counts.has(keyOf(slab, counts.mask));
  });
}
