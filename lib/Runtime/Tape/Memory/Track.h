//===- Track.h - The history of a field's memory ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// For each slab of a field (the elements with the same indices along dimensions
// of fixed indices): the last record whose adjoint reads it, and when its cells
// were saved. Stamps order these events. A cell must be saved if its last read
// is not older than its last save: a save at a record serves all reads before
// it.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_MEMORY_TRACK_H
#define TAI_LIB_RUNTIME_TAPE_MEMORY_TRACK_H

#include "StoredSlabs.h"
#include "tai/Runtime/Launch/Runtime.h"
#include "tai/Runtime/Mirror/DeviceContext.h"
#include "tai/Runtime/Mirror/Slabs.h"
#include <algorithm>
#include <optional>

namespace mlir::tai::runtime {

/// The history of the contents of one place in a tree, shared by all fields at
/// that place.
struct Track {
  Track(FieldPtr field, std::vector<int> dimensions);

  FieldPtr field;
  Slabs slabs;
  /// The number of elements of a cell, the unit in which contents are saved: a
  /// slab or a part of one or, in a sparse field, the elements in a cell of the
  /// sparse level above.
  int64_t cellElements;
  int64_t cellsPerSlab;

  /// Stamps (numbers) of the last record that reads each slab of the field, a
  /// slab that is not known, and any slab.
  std::vector<uint32_t> readAt;
  uint32_t readAnywhere = 0;
  uint32_t lastRead = 0;
  /// The stamp of the last save of each cell.
  std::vector<uint32_t> savedAt;
  /// The last snapshot that copied each cell, and temporary marks of cells.
  std::vector<uint32_t> loggedBy, marks;
  bool everSaved = false;
  /// See tangentIn.
  std::unique_ptr<Track> tangent;
  /// If the field is a dual: the primal field that it belongs to. Set in
  /// forward mode only.
  std::optional<FieldPtr> ofPrimal;
  /// A list of all cells of the level, if all cells are kept; see refresh.
  ActiveListPtr everyCell;

  /// The stored outputs of kernels in this field that adjoints may load.
  StoredSlabs stored;

  /// The track of the field's dual, or null. In forward mode the dual is saved
  /// and restored wherever the field is.
  Track *tangentIn(const Runtime &runtime);

  /// Makes the host's copy of the field current, if its contents are saved from
  /// there and not from the device.
  Status bring() const;

  void markRead(SlabRange range, uint32_t stamp) {
    lastRead = stamp;
    if (__builtin_expect(range.count == 1 && !readAt.empty(), true))
      readAt[range.first] = stamp;
    else
      markSlabs(range, stamp);
  }
  uint32_t readStamp(SlabRange range) const {
    if (range.isAll())
      return lastRead;
    uint32_t last = readAnywhere;
    if (!readAt.empty())
      for (int64_t slab = range.first; slab < range.end(); ++slab)
        last = std::max(last, readAt[slab]);
    return last;
  }
  int64_t numCells() const {
    return slabs.byCell() ? slabs.numCells() : slabs.count() * cellsPerSlab;
  }
  /// Adds the currently active cells to the known cells of a sparse field.
  /// Returns the number of cells known before.
  int64_t refresh();
  /// Calls body(begin, end) for runs of cells in the given slabs for which
  /// `wanted` holds, none longer than longestRun().
  template <typename Wanted, typename Body>
  Status forEachRun(SlabRange range, const Wanted &wanted,
                    const Body &body) const;
  int64_t longestRun() const;
  void markSlabs(SlabRange range, uint32_t stamp);
  int64_t bytesOf(SlabRange range) const {
    if (!slabs.byCell())
      return (range.isAll() ? slabs.count() : range.count) * slabs.elements() *
             slabs.elementBytes();
    return (range.isAll()
                ? slabs.numCells()
                : static_cast<int64_t>(slabs.cellsOf(range.first).size())) *
           slabs.elementBytes();
  }
  int64_t firstElement(int64_t cell) const {
    if (slabs.byCell())
      return cell;
    return cell / cellsPerSlab * slabs.elements() +
           cell % cellsPerSlab * cellElements;
  }
};

/// Saved contents of consecutive elements of a field, in `data` on the host or
/// `block` on the device; zeros if both are null.
struct Piece {
  Track *track;
  uint32_t record;
  /// True if the piece is restored before the adjoint of its record, not after
  /// it.
  bool before;
  int64_t cell, endCell;
  std::unique_ptr<char[]> data;
  std::unique_ptr<DeviceBlock> block = nullptr;

  int64_t first() const { return track->firstElement(cell); }
  int64_t count() const { return track->firstElement(endCell) - first(); }
  int64_t bytes() const { return count() * track->slabs.elementBytes(); }
  int64_t keptBytes() const { return data || block ? bytes() : 0; }
  /// Copies the contents of the field; fails if the tape would exceed the
  /// memory limit. `kept`: bytes that the tape has saved so far.
  Status allocate(Runtime &runtime, int64_t kept);
  /// True if the field still has the saved contents. False on a device, where
  /// the comparison is not worth the wait.
  bool holds() const {
    if (block || track->slabs.onDevice())
      return false;
    return data ? track->slabs.equal(first(), count(), data.get())
                : track->slabs.isZero(first(), count());
  }
  void putBack() const {
    if (block)
      track->slabs.storeOnDevice(first(), count(), *block);
    else if (data)
      track->slabs.store(first(), count(), data.get());
    else
      track->slabs.clear(first(), count());
  }
};

template <typename Wanted, typename Body>
Status Track::forEachRun(SlabRange range, const Wanted &wanted,
                         const Body &body) const {
  int64_t longest = longestRun();
  // In a field with sparse cells, `range` is the whole field or one slab.
  if (!range.isAll() && slabs.byCell()) {
    const std::vector<int64_t> &cells = slabs.cellsOf(range.first);
    for (size_t i = 0; i < cells.size();) {
      size_t first = i;
      while (i < cells.size() && wanted(cells[i]) &&
             cells[i] - cells[first] == int64_t(i - first) &&
             int64_t(i - first) < longest)
        ++i;
      if (i == first) {
        ++i;
        continue;
      }
      Status status = body(cells[first], cells[i - 1] + 1);
      if (!status)
        return status;
    }
    return Status::success();
  }
  int64_t cell = range.isAll() ? 0 : range.first * cellsPerSlab;
  int64_t end = range.isAll() ? numCells() : range.end() * cellsPerSlab;
  while (cell < end) {
    if (!wanted(cell)) {
      ++cell;
      continue;
    }
    int64_t first = cell;
    while (cell < end && cell - first < longest && wanted(cell))
      ++cell;
    Status status = body(first, cell);
    if (!status)
      return status;
  }
  return Status::success();
}

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_MEMORY_TRACK_H
