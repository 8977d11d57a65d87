//===- HostWrite.cpp - Changes that the host makes to fields --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "HostWrite.h"
#include "../Launch/TangentFlows.h"
#include "../Mirror/Slabs.h"
#include "../Storage/Scalars.h"
#include "tai/Runtime/Launch/Runtime.h"
#include "tai/Runtime/Tape/Tape.h"
#include <algorithm>
#include <cstring>

using namespace mlir::tai::runtime;

void Runtime::perform(const HostWrite &write) {
  Field &field = *write.field;
  switch (write.what) {
  case HostWrite::What::Fill:
    fillWith(field, write.bytes);
    break;
  case HostWrite::What::Array:
    copyIn(field, write.bytes);
    break;
  case HostWrite::What::Element:
    noteFailure(
        field.storeBytes(field.elementOffset(write.index) +
                             write.component * field.layout().componentStride,
                         write.bytes));
    break;
  }
  field.markDirty();
}

/// Whether the write would change nothing. Of a fill, nobody has asked yet.
static bool isVain(const HostWrite &write) {
  const Field &field = *write.field;
  if (write.what == HostWrite::What::Array)
    return Slabs(field, -1).equal(0, field.numElements(),
                                  static_cast<const char *>(write.bytes));
  if (write.what == HostWrite::What::Fill)
    return false;
  char held[8] = {};
  int64_t offset = field.elementOffset(write.index) +
                   write.component * field.layout().componentStride;
  return field.loadBytes(offset, held).ok() &&
         std::memcmp(held, write.bytes,
                     static_cast<size_t>(byteSize(field.scalar()))) == 0;
}

/// True for adjoints and tangents of other fields.
bool Runtime::isPartner(const Field &field) const {
  return field.isAdjoint() || std::any_of(fieldList.begin(), fieldList.end(),
                                          [&](const FieldPtr &other) {
                                            return other->dual() == &field ||
                                                   other->adjoint() == &field;
                                          });
}

/// What the host writes to becomes active. A fill is for what is active, and so
/// is an array of adjoints or tangents: what an inactive cell holds is a
/// constant.
Status Runtime::activateFor(const HostWrite &write) {
  SparseNode *node = write.field->sparseNode();
  if (!node || write.what == HostWrite::What::Fill)
    return Status::success();
  if (write.what == HostWrite::What::Element) {
    int64_t cell = write.field->cellNumber(write.index);
    Status status = checkActiveBytes(*node, node->isActive(cell) ? 0 : 1);
    if (status)
      node->activate(cell);
    return status;
  }
  if (isPartner(*write.field))
    return Status::success();
  return activateNonzero(*write.field, write.bytes);
}

Status Runtime::change(const HostWrite &write) {
  Field &field = *write.field;
  if (!field.valid())
    return Status::failure(StatusCode::Usage,
                           "field '" + field.name() + "' is gone: its tree '" +
                               field.tree().name() + "' has been destroyed");
  if (write.what == HostWrite::What::Element) {
    int64_t offset = 0;
    Status status = field.locate(write.index, write.component, offset);
    if (!status)
      return status;
  }
  Status free = checkHold(field, HoldKind::Write);
  if (free && field.sparseNode())
    free = checkHold(*firstOf(field.tree()), HoldKind::Write);
  if (!free)
    return free;
  Tape *tape = recordingTape();
  if (tape && field.sparseNode())
    tape->watch(field.owner);
  Status active = activateFor(write);
  if (!active)
    return active;
  // Gradients are no values that a program computes from.
  if (field.isAdjoint()) {
    perform(write);
    return takeDeviceFailure();
  }
  if (tangentFlows && isForward() && write.replacesAll())
    tangentFlows->overwrite(field);
  if (tape)
    return tape->write(write);
  // On a device it would take a copy, and a wait, to find out; only tapes that
  // need what the field held want to know.
  if ((device &&
       std::none_of(tapes.begin(), tapes.end(),
                    [&](const Tape *tape) { return tape->minds(field); })) ||
      !isVain(write))
    ++field.hostVersion;
  perform(write);
  return takeDeviceFailure();
}

Status Runtime::copyFromHost(Field &field, const void *array) {
  return change({HostWrite::What::Array, &field, array});
}

Status Runtime::fillF64(Field &field, double value) {
  char bytes[8];
  storeF64(field.scalar(), bytes, value);
  return change({HostWrite::What::Fill, &field, bytes});
}

Status Runtime::fillI64(Field &field, int64_t value) {
  char bytes[8];
  storeI64(field.scalar(), bytes, value);
  return change({HostWrite::What::Fill, &field, bytes});
}

Status Runtime::writeF64(Field &field, const int64_t *index, int64_t component,
                         double value) {
  char bytes[8];
  storeF64(field.scalar(), bytes, value);
  return change({HostWrite::What::Element, &field, bytes, index, component});
}

Status Runtime::writeI64(Field &field, const int64_t *index, int64_t component,
                         int64_t value) {
  char bytes[8];
  storeI64(field.scalar(), bytes, value);
  return change({HostWrite::What::Element, &field, bytes, index, component});
}
