//===- Slabs.cpp - Parts of fields in buffers -----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Mirror/Slabs.h"
#include "tai/Runtime/Mirror/Mirror.h"
#include "tai/Runtime/Storage/Scalars.h"
#include <algorithm>
#include <cstring>
#include <iterator>

using namespace mlir::tai::runtime;

struct Slabs::Numbers {
  std::unique_ptr<DeviceBlock> memory;
  int64_t count = 0, capacity = 0;
};

/// True if `dimensions` are the leading dimensions of a field.
static bool areFirst(const std::vector<int> &dimensions) {
  return dimensions.empty() ||
         dimensions.back() + 1 == static_cast<int>(dimensions.size());
}

std::vector<int> Slabs::choose(const Field &field,
                               const std::vector<FixedIndex> &fixed) {
  // The minimum size of a slab (a part of a field with some leading indices
  // fixed) in bytes: the data kept for each smaller slab would take more memory
  // than smaller slabs save.
  constexpr int64_t fewestBytes = 64;
  std::vector<int> chosen;
  chosen.reserve(fixed.size());
  int64_t slabBytes = field.hostBytes();
  for (const FixedIndex &index : fixed) {
    int64_t extent = std::max<int64_t>(field.shape()[index.dimension], 1);
    chosen.push_back(static_cast<int>(index.dimension));
    slabBytes /= extent;
    bool isGood = slabBytes >= fewestBytes && !field.sparseNode() &&
                  (!field.tree().mirror() || areFirst(chosen));
    if (chosen.size() > 1 && !isGood) {
      chosen.pop_back();
      break;
    }
  }
  return chosen;
}

Slabs::Slabs(const Field &field, std::vector<int> dimensions, bool byCell)
    : field(&field), slowDimensions(std::move(dimensions)),
      isRowMajor(areFirst(slowDimensions)),
      bytes(field.numComponents() * byteSize(field.scalar())),
      isEven(!byCell &&
             (isRowMajor ? field.evenStep() != 0 : field.contiguous())),
      isContiguous(field.contiguous() && isRowMajor) {
  if (byCell) {
    cells = std::make_shared<CellElements>(field);
    bytes = cells->bytes();
    Status status = CellMover::find(field, *cells, mover);
    if (!status)
      field.tree().mirror()->context().note(std::move(status));
    numbersOnDevice = std::make_shared<Numbers>();
    // In a sparse field, each slab must consist of whole cells.
    slowDimensions.resize(std::min<size_t>(slowDimensions.size(), 1));
    if (!slowDimensions.empty() && !cells->separates(slowDimensions.front()))
      slowDimensions.clear();
    if (!slowDimensions.empty()) {
      slabs = field.shape()[slowDimensions.front()];
      slabCells.resize(static_cast<size_t>(slabs));
    }
    return;
  }
  for (int d : slowDimensions)
    slabs *= field.shape()[d];
  slabElements = slabs ? field.numElements() / slabs : 0;
  if (isContiguous)
    return;
  auto add = [&](int d) {
    const std::vector<LayoutLevel> &levels = field.layout().indices[d];
    Dimension entry{field.shape()[d], 0, {}};
    if (!findConstantStep(levels, entry.step)) {
      entry.table.resize(entry.extent);
      for (int64_t i = 0; i < entry.extent; ++i)
        for (const LayoutLevel &level : levels)
          entry.table[i] += i / level.divisor % level.extent * level.stride;
    }
    order.push_back(std::move(entry));
  };
  for (int d : slowDimensions)
    add(d);
  for (int d = 0; d < field.rank(); ++d)
    if (std::find(slowDimensions.begin(), slowDimensions.end(), d) ==
        slowDimensions.end())
      add(d);
}

/// Gives the numbers of cells in device memory, after appending the numbers
/// that are new.
Status Slabs::bringNumbers(int64_t first, int64_t count,
                           CellMover::Cells &found) const {
  Numbers &there = *numbersOnDevice;
  Mirror &mirror = *field->tree().mirror();
  constexpr int64_t each = sizeof(int64_t);
  Status status;
  if (numCells() > there.capacity) {
    int64_t capacity = std::max<int64_t>(2 * there.capacity, numCells());
    status = DeviceBlock::make(mirror.sharedContext(), capacity * each,
                               "numbers of cells", there.memory);
    there.capacity = status ? capacity : 0;
    there.count = 0;
  }
  if (status && numCells() > there.count) {
    status = mirror.device().copyIn(
        there.memory->get() + static_cast<DevicePtr>(there.count * each),
        numbered.data() + there.count, (numCells() - there.count) * each);
    if (status)
      there.count = numCells();
  }
  if (status)
    found = {there.memory->get() + static_cast<DevicePtr>(first * each), count};
  return status;
}

int64_t Slabs::addCells(const ActiveListPtr &list) {
  int64_t before = numCells();
  if (list == lastAdded)
    return before;
  lastAdded = list;
  std::set_difference(list->cells.begin(), list->cells.end(), known.begin(),
                      known.end(), std::back_inserter(numbered));
  if (numCells() == before)
    return before;
  std::vector<int64_t> all(numbered.size());
  std::merge(known.begin(), known.end(), numbered.begin() + before,
             numbered.end(), all.begin());
  known = std::move(all);
  if (!slowDimensions.empty())
    for (int64_t i = before; i < numCells(); ++i)
      slabCells[cells->position(numbered[i], slowDimensions.front())].push_back(
          i);
  return before;
}

/// Calls visit(cell, offset in the buffer) for each cell of some slabs until
/// `visit` returns false.
template <typename Visit>
bool Slabs::forEachCell(int64_t first, int64_t count,
                        const Visit &visit) const {
  for (int64_t i = 0; i < count; ++i)
    if (!visit(numbered[first + i], i * bytes))
      return false;
  return true;
}

/// Calls run(address, bytes, offset in the buffer) for each run of bytes that
/// is contiguous in the field and in the buffer, until `run` returns false.
/// `data` is the address of the field. Common numbers of bytes are passed as
/// constants.
template <typename Data, typename Run>
bool Slabs::forEachRun(Data *data, int64_t first, int64_t count,
                       const Run &run) const {
  if (count == 0)
    return true;
  if (isContiguous)
    return run(data + first * bytes, count * bytes, int64_t(0));
  int64_t scalar = byteSize(field->scalar());
  int64_t stride = field->layout().componentStride;
  bool dense = stride == scalar || field->numComponents() == 1;
  auto element = [&](Data *address, int64_t offset) {
    if (dense) {
      switch (bytes) {
      case 4:
        return run(address, std::integral_constant<int64_t, 4>(), offset);
      case 8:
        return run(address, std::integral_constant<int64_t, 8>(), offset);
      case 12:
        return run(address, std::integral_constant<int64_t, 12>(), offset);
      case 16:
        return run(address, std::integral_constant<int64_t, 16>(), offset);
      case 24:
        return run(address, std::integral_constant<int64_t, 24>(), offset);
      default:
        return run(address, bytes, offset);
      }
    }
    for (int64_t c = 0; c < field->numComponents(); ++c)
      if (!run(address + c * stride, scalar, offset + c * scalar))
        return false;
    return true;
  };
  if (order.empty())
    return element(data, 0);
  std::vector<int64_t> index(order.size());
  int64_t rest = first;
  for (size_t d = index.size(); d-- > 0;) {
    index[d] = rest % order[d].extent;
    rest /= order[d].extent;
  }
  size_t last = index.size() - 1;
  const Dimension &row = order[last];
  for (int64_t done = 0; done < count;) {
    Data *base = data;
    for (size_t d = 0; d < last; ++d)
      base += order[d].at(index[d]);
    int64_t length = std::min(count - done, row.extent - index[last]);
    if (dense && row.table.empty() && row.step == bytes) {
      if (!run(base + index[last] * bytes, length * bytes, done * bytes))
        return false;
    } else {
      for (int64_t k = 0; k < length; ++k)
        if (!element(base + row.at(index[last] + k), (done + k) * bytes))
          return false;
    }
    done += length;
    index[last] = 0;
    for (size_t d = last; d-- > 0;) {
      if (++index[d] < order[d].extent)
        break;
      index[d] = 0;
    }
  }
  return true;
}

void Slabs::load(int64_t first, int64_t count, char *to) const {
  if (cells) {
    forEachCell(first, count, [&](int64_t cell, int64_t offset) {
      cells->load(cell, to + offset);
      return true;
    });
    return;
  }
  forEachRun(field->readable(), first, count,
             [&](const char *address, auto size, int64_t offset) {
               std::memcpy(to + offset, address, static_cast<size_t>(size));
               return true;
             });
}

void Slabs::store(int64_t first, int64_t count, const char *from) const {
  if (cells) {
    forEachCell(first, count, [&](int64_t cell, int64_t offset) {
      cells->store(cell, from + offset);
      return true;
    });
    return;
  }
  forEachRun(field->writable(), first, count,
             [&](char *address, auto size, int64_t offset) {
               std::memcpy(address, from + offset, static_cast<size_t>(size));
               return true;
             });
}

bool Slabs::equal(int64_t first, int64_t count, const char *expected) const {
  if (cells)
    return forEachCell(first, count, [&](int64_t cell, int64_t offset) {
      return cells->equal(cell, expected + offset);
    });
  return forEachRun(field->readable(), first, count,
                    [&](const char *address, auto size, int64_t offset) {
                      return std::memcmp(address, expected + offset,
                                         static_cast<size_t>(size)) == 0;
                    });
}

void Slabs::exchange(int64_t first, int64_t count, char *contents) const {
  forEachCell(first, count, [&](int64_t cell, int64_t offset) {
    cells->exchange(cell, contents + offset);
    return true;
  });
}

bool Slabs::isZero(int64_t first, int64_t count) const {
  return forEachCell(
      first, count, [&](int64_t cell, int64_t) { return cells->isZero(cell); });
}

void Slabs::clear(int64_t first, int64_t count) const {
  if (mover) {
    CellMover::Cells found{};
    const uint64_t zero = 0;
    Status status = bringNumbers(first, count, found);
    if (status)
      status = mover->fill(found, &zero);
    field->tree().mirror()->context().note(std::move(status));
    return;
  }
  forEachCell(first, count, [&](int64_t cell, int64_t) {
    cells->clear(cell);
    return true;
  });
}

void Slabs::zero(int64_t first, int64_t count) const {
  Mirror *mirror = field->tree().mirror();
  if (mirror && isEven && mirror->onDevice()) {
    mirror->deviceWrites();
    const char zeros[8] = {};
    mirror->context().note(
        mirror->device().fillRows(rowsOf(first, count), zeros,
                                  static_cast<int>(byteSize(field->scalar()))));
    return;
  }
  // This code bypasses the field's accessors, because the field may be storing
  // its owed zeros now.
  char *data = field->tree().writable() + field->layout().placeOffset;
  forEachRun(data, first, count, [](char *address, auto size, int64_t) {
    std::memset(address, 0, static_cast<size_t>(size));
    return true;
  });
}
