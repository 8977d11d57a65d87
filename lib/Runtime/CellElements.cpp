//===- CellElements.cpp - The elements of a field in its cells ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "CellElements.h"
#include <algorithm>
#include <cstring>

using namespace mlir::tai::runtime;

/// True if consecutive cells are evenly spaced, at this distance.
static bool areEvenlySpaced(const SparseInfo &info, int64_t &stride) {
  stride = info.steps.back().stride;
  int64_t span = 1;
  for (auto step = info.steps.rbegin(); step != info.steps.rend(); ++step) {
    if (step->cells != 1 && step->stride != stride * span)
      return false;
    span *= step->cells;
  }
  return true;
}

CellElements::CellElements(const Field &field) : field(&field) {
  const FieldLayout &layout = field.layout();
  uniform = areEvenlySpaced(field.sparseNode()->info(), cellStride);
  inner = {{0, 0}};
  int64_t row = field.numElements();
  for (size_t d = 0; d < layout.indices.size(); ++d) {
    row /= field.shape()[d];
    for (const LayoutLevel &level : layout.indices[d]) {
      if (level.cells != 0) {
        outer.push_back(level);
        outer.back().divisor *= row;
        continue;
      }
      std::vector<Element> all;
      all.reserve(inner.size() * static_cast<size_t>(level.extent));
      for (int64_t i = 0; i < level.extent; ++i)
        for (const Element &element : inner)
          all.push_back({element.offset + i * level.stride,
                         element.number + i * level.divisor * row});
      inner = std::move(all);
    }
  }
  std::sort(inner.begin(), inner.end(), [](const Element &a, const Element &b) {
    return a.offset < b.offset;
  });
  int64_t scalar = byteSize(field.scalar());
  for (const Element &element : inner)
    for (int64_t c = 0; c < field.numComponents(); ++c) {
      int64_t offset = element.offset + c * layout.componentStride;
      if (!pieces.empty() &&
          pieces.back().offset + pieces.back().bytes == offset)
        pieces.back().bytes += scalar;
      else
        pieces.push_back({offset, scalar});
    }
  total = static_cast<int64_t>(inner.size()) * field.numComponents() * scalar;
}

void CellElements::load(int64_t cell, char *to) const {
  const char *address = base(cell);
  for (const Run &run : pieces) {
    std::memcpy(to, address + run.offset, static_cast<size_t>(run.bytes));
    to += run.bytes;
  }
}

void CellElements::store(int64_t cell, const char *from) const {
  char *address = base(cell);
  for (const Run &run : pieces) {
    std::memcpy(address + run.offset, from, static_cast<size_t>(run.bytes));
    from += run.bytes;
  }
}

bool CellElements::equal(int64_t cell, const char *expected) const {
  const char *address = base(cell);
  for (const Run &run : pieces) {
    if (std::memcmp(address + run.offset, expected,
                    static_cast<size_t>(run.bytes)) != 0)
      return false;
    expected += run.bytes;
  }
  return true;
}

void CellElements::clear(int64_t cell) const {
  char *address = base(cell);
  for (const Run &run : pieces)
    std::memset(address + run.offset, 0, static_cast<size_t>(run.bytes));
}

bool CellElements::isZero(int64_t cell) const {
  const char *address = base(cell);
  return std::all_of(pieces.begin(), pieces.end(), [&](const Run &run) {
    const char *at = address + run.offset;
    int64_t left = run.bytes;
    for (; left >= 64; left -= 64, at += 64) {
      uint64_t words[8], any = 0;
      std::memcpy(words, at, sizeof(words));
      for (uint64_t word : words)
        any |= word;
      if (any)
        return false;
    }
    return std::all_of(at, at + left, [](char byte) { return byte == 0; });
  });
}

int64_t CellElements::firstNumber(int64_t cell) const {
  int64_t number = 0;
  for (const LayoutLevel &level : outer)
    number += cell / level.cells % level.extent * level.divisor;
  return number;
}

bool CellElements::separates(int dimension) const {
  const std::vector<LayoutLevel> &levels = field->layout().indices[dimension];
  return std::all_of(levels.begin(), levels.end(), [](const LayoutLevel &l) {
    return l.cells != 0 || l.extent == 1;
  });
}

int64_t CellElements::position(int64_t cell, int dimension) const {
  int64_t position = 0;
  for (const LayoutLevel &level : field->layout().indices[dimension])
    if (level.cells != 0)
      position += cell / level.cells % level.extent * level.divisor;
  return position;
}
