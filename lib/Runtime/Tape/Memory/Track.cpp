//===- Track.cpp - The history of a field's memory ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Track.h"
#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Mirror/Mirror.h"
#include "tai/Runtime/Text/Format.h"
#include <algorithm>
#include <new>
#include <numeric>

using namespace mlir::tai::runtime;

/// The size in bytes of a cell, the unit of saving a field's contents, and of a
/// saved piece, in a field that is larger.
static constexpr int64_t cellBytes = 8 << 10;

Track::Track(FieldPtr fieldPtr, std::vector<int> dimensions)
    : field(std::move(fieldPtr)),
      slabs(*field, std::move(dimensions), field->sparseNode() != nullptr) {
  if (slabs.byCell()) {
    cellElements = 1;
    cellsPerSlab = 0; // not known
    return;
  }
  if (slabs.onDevice()) {
    // The saved contents are not compared with the field on a device, so a slab
    // is saved as one piece.
    cellElements = std::max<int64_t>(slabs.elements(), 1);
    cellsPerSlab = 1;
    return;
  }
  cellElements = std::clamp<int64_t>(cellBytes / slabs.elementBytes(), 1,
                                     std::max<int64_t>(slabs.elements(), 1));
  cellsPerSlab = (slabs.elements() + cellElements - 1) / cellElements;
}

Track *Track::tangentIn(const Runtime &runtime) {
  if (!tangent && field->dual())
    if (FieldPtr dual = runtime.store().findField(field->dual()->name()))
      tangent = std::make_unique<Track>(std::move(dual), slabs.dimensions());
  return tangent.get();
}

Status Track::bring() const {
  Mirror *mirror = field->tree().mirror();
  return mirror && !slabs.onDevice() ? mirror->toHost() : Status::success();
}

int64_t Track::longestRun() const {
  if (slabs.onDevice())
    return !slabs.inRowMajorOrder() && !slabs.byCell()
               ? 1
               : std::max<int64_t>(numCells(), 1);
  return std::max<int64_t>(cellBytes / (cellElements * slabs.elementBytes()),
                           1);
}

int64_t Track::refresh() {
  if (!slabs.byCell())
    return numCells();
  SparseNode &node = *field->sparseNode();
  // All cells of a small field are kept: to list the active cells, the host
  // would wait for the device. Inactive cells are kept as zeros.
  constexpr int64_t fewBytes = 256 << 10;
  if (slabs.onDevice() && slabs.dimensions().empty() &&
      node.numCells() * slabs.elementBytes() <= fewBytes &&
      field->tree().mirror()->sparse()->canKeepActivity()) {
    if (!everyCell) {
      auto every = std::make_shared<ActiveList>();
      every->cells.resize(static_cast<size_t>(node.numCells()));
      std::iota(every->cells.begin(), every->cells.end(), int64_t(0));
      everyCell = std::move(every);
    }
    return slabs.addCells(everyCell);
  }
  return slabs.addCells(node.list());
}

void Track::markSlabs(SlabRange range, uint32_t stamp) {
  if (range.isAll()) {
    readAnywhere = stamp;
    return;
  }
  if (readAt.empty())
    readAt.resize(static_cast<size_t>(slabs.count()));
  std::fill(readAt.begin() + range.first, readAt.begin() + range.end(), stamp);
}

Status Piece::allocate(Runtime &runtime, int64_t kept) {
  if (track->slabs.onDevice())
    return track->slabs.keepOnDevice(first(), count(), block);
  int64_t size = bytes();
  if (size <= runtime.memory().limit() - runtime.memory().reserved() - kept)
    data.reset(new (std::nothrow) char[static_cast<size_t>(size)]);
  if (!data)
    return Status::failure(
        StatusCode::Memory,
        "out of memory: the tape keeps " + formatBytes(kept) +
            " of values that were overwritten, and needs " + formatBytes(size) +
            " more for field '" + track->field->name() +
            "'; with a memory budget it recomputes values instead");
  Status status = track->bring();
  if (status)
    track->slabs.load(first(), count(), data.get());
  return status;
}
