//===- CellElements.cpp - The elements of a field in its cells ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Mirror/CellElements.h"
#include <algorithm>
#include <cstring>

using namespace mlir::tai::runtime;

/// True if consecutive cells are evenly spaced in memory; `stride` is then
/// their distance.
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
  if (pieces.size() > 1)
    step = pieces[1].offset - pieces[0].offset;
  for (size_t i = 0; i < pieces.size(); ++i)
    if (pieces[i].bytes != pieces[0].bytes ||
        pieces[i].offset - pieces[0].offset != int64_t(i) * step)
      step = 0;
  total = static_cast<int64_t>(inner.size()) * field.numComponents() * scalar;
}

template <typename Body> bool CellElements::forEachRun(const Body &body) const {
  auto count = static_cast<int64_t>(pieces.size());
  auto evenly = [&](auto size) {
    int64_t offset = pieces.front().offset;
    for (int64_t i = 0; i < count; ++i, offset += step)
      if (!body(offset, size, i * static_cast<int64_t>(size)))
        return false;
    return true;
  };
  if (step)
    switch (pieces.front().bytes) {
    case 4:
      return evenly(std::integral_constant<size_t, 4>());
    case 8:
      return evenly(std::integral_constant<size_t, 8>());
    case 12:
      return evenly(std::integral_constant<size_t, 12>());
    case 16:
      return evenly(std::integral_constant<size_t, 16>());
    case 24:
      return evenly(std::integral_constant<size_t, 24>());
    }
  int64_t position = 0;
  for (const Run &run : pieces) {
    if (!body(run.offset, static_cast<size_t>(run.bytes), position))
      return false;
    position += run.bytes;
  }
  return true;
}

void CellElements::load(int64_t cell, char *to) const {
  const char *address = base(cell);
  forEachRun([&](int64_t offset, auto size, int64_t position) {
    std::memcpy(to + position, address + offset, size);
    return true;
  });
}

void CellElements::store(int64_t cell, const char *from) const {
  (void)field->writable();
  char *address = base(cell);
  forEachRun([&](int64_t offset, auto size, int64_t position) {
    std::memcpy(address + offset, from + position, size);
    return true;
  });
}

bool CellElements::equal(int64_t cell, const char *expected) const {
  const char *address = base(cell);
  return forEachRun([&](int64_t offset, auto size, int64_t position) {
    return std::memcmp(address + offset, expected + position, size) == 0;
  });
}

void CellElements::exchange(int64_t cell, char *contents) const {
  (void)field->writable();
  char *address = base(cell);
  forEachRun([&](int64_t offset, auto size, int64_t position) {
    char *mine = address + offset, *other = contents + position;
    std::swap_ranges(mine, mine + static_cast<size_t>(size), other);
    return true;
  });
}

void CellElements::clear(int64_t cell) const {
  (void)field->writable();
  char *address = base(cell);
  forEachRun([&](int64_t offset, auto size, int64_t) {
    std::memset(address + offset, 0, size);
    return true;
  });
}

/// True if all bytes are zero.
static bool areZero(const char *at, size_t bytes) {
  for (; bytes >= 64; bytes -= 64, at += 64) {
    uint64_t words[8], any = 0;
    std::memcpy(words, at, sizeof(words));
    for (uint64_t word : words)
      any |= word;
    if (any)
      return false;
  }
  for (; bytes >= 4; bytes -= 4, at += 4) {
    uint32_t word;
    std::memcpy(&word, at, sizeof(word));
    if (word)
      return false;
  }
  return std::all_of(at, at + bytes, [](char byte) { return byte == 0; });
}

bool CellElements::isZero(int64_t cell) const {
  const char *address = base(cell);
  return forEachRun([&](int64_t offset, auto size, int64_t) {
    return areZero(address + offset, size);
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
