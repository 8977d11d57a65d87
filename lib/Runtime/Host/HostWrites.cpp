//===- HostWrites.cpp - Writes of the host to fields ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Host/HostWrites.h"
#include "tai/Runtime/Host/HostWrite.h"
#include "tai/Runtime/Mirror/Slabs.h"
#include "tai/Runtime/Storage/Scalars.h"
#include "tai/Runtime/Threads/Safepoint.h"
#include <algorithm>
#include <cstring>

using namespace mlir::tai::runtime;

bool HostWrites::perform(const HostWrite &write,
                         FieldCopies::Interrupts interrupts) {
  Field &field = *write.field;
  bool isWhole = true;
  switch (write.what) {
  case HostWrite::What::Fill:
    isWhole = copies.fill(field, write.bytes, interrupts);
    break;
  case HostWrite::What::Array:
    isWhole = copies.copyIn(field, write.bytes, interrupts);
    break;
  case HostWrite::What::Element:
    devices.noteFailure(
        field.storeBytes(field.elementOffset(write.index) +
                             write.component * field.layout().componentStride,
                         write.bytes));
    break;
  }
  field.markDirty();
  return isWhole;
}

/// Compares an array with the contents of a field, piece by piece. Also returns
/// false if the host has interrupted the comparison.
static bool isEqual(const Field &field, const char *array) {
  Slabs slabs(field);
  std::shared_ptr<void> memory = field.tree().sharedMemory();
  int64_t element = byteSize(field.scalar()) * field.numComponents();
  int64_t count = field.numElements();
  int64_t piece =
      std::max<int64_t>(FieldCopies::bytesPerSafepoint / element, 1);
  safepoint::Watch watch;
  if (count >= 2 * piece && !safepoint::look())
    return false;
  for (int64_t at = 0; at < count; at += piece)
    if (!slabs.equal(at, std::min(piece, count - at), array + at * element) ||
        !watch.look())
      return false;
  return true;
}

/// True if the write would not change the contents of the field. Returns false
/// for a fill, which is not compared with the contents.
static bool changesNothing(const HostWrite &write) {
  const Field &field = *write.field;
  if (write.what == HostWrite::What::Array)
    return isEqual(field, static_cast<const char *>(write.bytes));
  if (write.what == HostWrite::What::Fill)
    return false;
  char held[8] = {};
  int64_t offset = field.elementOffset(write.index) +
                   write.component * field.layout().componentStride;
  return field.loadBytes(offset, held).ok() &&
         std::memcmp(held, write.bytes,
                     static_cast<size_t>(byteSize(field.scalar()))) == 0;
}

/// Activates the cells that the host writes to. A fill applies to active cells
/// only, and so does an array of adjoints or tangents: the value of an inactive
/// cell is a constant.
Status HostWrites::activateFor(const HostWrite &write) {
  SparseNode *node = write.field->sparseNode();
  if (!node || write.what == HostWrite::What::Fill)
    return Status::success();
  if (write.what == HostWrite::What::Element) {
    int64_t cell = write.field->cellNumber(write.index);
    Status status = memory.checkCells(*node, node->isActive(cell) ? 0 : 1);
    if (status)
      node->activate(cell);
    return status;
  }
  if (store.isPartner(*write.field))
    return Status::success();
  return activateNonzero(*write.field, write.bytes);
}

Status HostWrites::activateNonzero(Field &field, const void *array) {
  SparseNode &node = *field.sparseNode();
  const std::vector<int64_t> &shape = field.shape();
  size_t rank = shape.size();
  int64_t bytes = byteSize(field.scalar()) * field.numComponents();
  const char *element = static_cast<const char *>(array);
  std::vector<int64_t> index(rank);
  for (size_t d = 0; d < rank; ++d)
    index[d] = field.firstIndex(static_cast<int64_t>(d));
  int64_t count = field.numElements();
  constexpr int64_t most = 1 << 18; // elements between two safepoints
  safepoint::Watch watch;
  bool goesOn = count < 2 * most || safepoint::look();
  for (int64_t i = 0; i < count; ++i, element += bytes) {
    if (i > 0 && i % most == 0)
      goesOn = goesOn && watch.look();
    if (!goesOn)
      return failAsInterrupted();
    if (std::any_of(element, element + bytes, [](char b) { return b != 0; })) {
      int64_t cell = field.cellNumber(index.data());
      if (!node.isActive(cell)) {
        Status status = memory.checkCells(node, 1);
        if (!status)
          return status;
        node.activate(cell);
      }
    }
    for (size_t d = rank; d-- > 0;) {
      int64_t first = field.firstIndex(static_cast<int64_t>(d));
      if (++index[d] < first + shape[d])
        break;
      index[d] = first;
    }
  }
  return Status::success();
}

void HostWrites::removeHalos(const Field &field) {
  // A write of the host copies the tree from the device and back, with the
  // halos of all of its fields, which the host's copy need not have.
  if (devices.isThere())
    halos.removeAll();
  else
    halos.remove(field.tree().base() + field.layout().placeOffset);
}

Status HostWrites::change(const HostWrite &write) {
  Field &field = *write.field;
  if (!field.valid())
    return Status::failure(StatusCode::Usage,
                           "field '" + field.name() + "' is gone: its tree '" +
                               field.tree().name() + "' has been destroyed");
  if (Status status = devices.checkHandler(); !status)
    return status;
  if (write.what == HostWrite::What::Element) {
    int64_t offset = 0;
    Status status = field.locate(write.index, write.component, offset);
    if (!status)
      return status;
  }
  Status free = recordings.check(field, HoldKind::Write);
  if (free && field.sparseNode())
    free = recordings.checkActivity(field.tree());
  if (!free)
    return free;
  removeHalos(field);
  Recorder *tape = recordings.current();
  if (tape && field.sparseNode())
    tape->watch(field.sharedTree());
  Status active = activateFor(write);
  if (!active)
    return active;
  auto performNow = [&] {
    bool isWhole = perform(write, FieldCopies::Interrupts::Stop);
    return isWhole ? devices.takeFailure() : failAsInterrupted();
  };
  // Tapes do not record writes to adjoints, since programs compute no values
  // from adjoints.
  if (field.isAdjoint())
    return performNow();
  if (watcher && recordings.isForward() && write.replacesAll())
    watcher->overwrite(field);
  if (tape) {
    Status status = tape->write(write);
    return status ? devices.takeFailure() : std::move(status);
  }
  // On a device, the comparison would take a copy and a wait. Unless a tape
  // needs the former values, the write counts as a change without a comparison.
  if ((devices.isThere() && !recordings.needsValues(field)) ||
      !changesNothing(write))
    field.countChange();
  return performNow();
}

Status HostWrites::copyIn(Field &field, const void *array) {
  return change({HostWrite::What::Array, &field, array});
}

Status HostWrites::fillF64(Field &field, double value) {
  char bytes[8];
  storeF64(field.scalar(), bytes, value);
  return change({HostWrite::What::Fill, &field, bytes});
}

Status HostWrites::fillI64(Field &field, int64_t value) {
  char bytes[8];
  storeI64(field.scalar(), bytes, value);
  return change({HostWrite::What::Fill, &field, bytes});
}

Status HostWrites::writeF64(Field &field, const int64_t *index,
                            int64_t component, double value) {
  char bytes[8];
  storeF64(field.scalar(), bytes, value);
  return change({HostWrite::What::Element, &field, bytes, index, component});
}

Status HostWrites::writeI64(Field &field, const int64_t *index,
                            int64_t component, int64_t value) {
  char bytes[8];
  storeI64(field.scalar(), bytes, value);
  return change({HostWrite::What::Element, &field, bytes, index, component});
}

Status HostWrites::writeElements(Field &field, const int64_t *indices,
                                 int64_t count, const void *values) {
  const char *from = static_cast<const char *>(values);
  for (int64_t i = 0; i < count; ++i, indices += field.rank())
    for (int64_t c = 0; c < field.numComponents(); ++c) {
      Status status =
          change({HostWrite::What::Element, &field, from, indices, c});
      if (!status)
        return status;
      from += byteSize(field.scalar());
    }
  return Status::success();
}

Status HostWrites::setActive(const TreePtr &tree, int64_t level, int64_t cell,
                             bool isActive) {
  auto change = [tree, level, cell, isActive]() {
    if (!tree->base())
      return Status::failure(StatusCode::Usage,
                             "tree '" + tree->name() + "' has been destroyed");
    SparseNode &node = *tree->sparseNodes()[level];
    if (isActive)
      node.activate(cell);
    else if (cell < 0)
      node.deactivateAll();
    else
      node.deactivate(cell);
    return Status::success();
  };
  if (Status status = devices.checkHandler(); !status)
    return status;
  if (Status free = recordings.checkActivity(*tree); !free)
    return free;
  if (Recorder *tape = recordings.current())
    return tape->changeActivity(tree, change);
  // Only tapes need to know which cells were deactivated; without tapes, the
  // host does not wait for a device to find out.
  SparseNode &node = *tree->sparseNodes()[level];
  uint64_t before = recordings.areThereTapes() ? node.lastRemoval() : 0;
  Status status = change();
  // Cells that were deactivated have become zero, which changes their fields.
  if (recordings.areThereTapes() && node.lastRemoval() != before)
    for (const FieldPtr &field : store.fields())
      if (field->sharedTree() == tree && field->sparseNode())
        field->countChange();
  return status;
}

Status HostWrites::noteOutside(Field &field) {
  if (recordings.current() && !field.isAdjoint())
    return Status::failure(
        StatusCode::Usage,
        "field '" + field.name() +
            "' is written from outside while a tape records");
  removeHalos(field);
  field.countChange();
  field.markDirty();
  return Status::success();
}
