//===- ExportedBuffer.cpp - Field memory used by others -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Host/ExportedBuffer.h"
#include "tai/Runtime/Mirror/Mirror.h"
#include "tai/Runtime/Storage/Scalars.h"

using namespace mlir::tai::runtime;

std::atomic<int> ExportedBuffer::count{0};

ExportedBuffer::ExportedBuffer(const TreePtr &tree)
    : tree(tree), memory(tree->sharedMemory()), mirror(tree->sharedMirror()) {
  count.fetch_add(1, std::memory_order_relaxed);
  tree->countExport(1);
  if (mirror)
    mirror->addExport();
}

ExportedBuffer::~ExportedBuffer() {
  if (mirror)
    mirror->removeExport();
  tree->countExport(-1);
  count.fetch_sub(1, std::memory_order_relaxed);
}

/// Finds the bytes of the tree that the field spans; false if an index has no
/// constant stride, so that the field cannot be exported.
static bool findExtent(const Field &field, uint64_t &begin, uint64_t &end) {
  const FieldLayout &layout = field.layout();
  int64_t last = byteSize(field.scalar());
  if (field.numComponents() > 1)
    last += (field.numComponents() - 1) * layout.componentStride;
  for (int d = 0; d < field.rank(); ++d) {
    auto at = static_cast<size_t>(d);
    int64_t step = 0;
    if (!findConstantStep(layout.indices[at], step))
      return false;
    last += (field.shape()[at] - 1) * step;
  }
  begin = static_cast<uint64_t>(layout.placeOffset);
  end = begin + static_cast<uint64_t>(last);
  return true;
}

bool ExportedBuffer::findBytes(const Field &field, uint64_t &begin,
                               uint64_t &end) {
  if (!field.valid() || !field.tree().isExported() ||
      !findExtent(field, begin, end))
    return false;
  const Mirror *mirror = field.tree().mirror();
  uint64_t base =
      mirror ? mirror->at(0) : reinterpret_cast<uint64_t>(field.tree().base());
  begin += base;
  end += base;
  return true;
}

Status ExportedBuffer::make(Field &field, DeviceHost &devices,
                            ExportedField &exported) {
  auto refuse = [&](const char *why) {
    return Status::failure(StatusCode::Usage, "field '" + field.name() +
                                                  "' cannot be shared: " + why);
  };
  if (!field.valid())
    return refuse("its tree has been destroyed");
  if (field.sparseNode())
    return refuse("it is sparse; copy it, by to_numpy or to_torch");
  const FieldLayout &layout = field.layout();
  exported.strides.clear();
  for (int d = 0; d < field.rank(); ++d) {
    int64_t step = 0;
    if (!findConstantStep(layout.indices[static_cast<size_t>(d)], step))
      return refuse("its layout divides an index in blocks; copy it, by "
                    "to_numpy or to_torch");
    exported.strides.push_back(step);
  }
  size_t first = exported.strides.size();
  int64_t step = field.numComponents() > 1 ? layout.componentStride
                                           : byteSize(field.scalar());
  for (size_t d = layout.elementShape.size(); d-- > 0;) {
    exported.strides.insert(
        exported.strides.begin() + static_cast<ptrdiff_t>(first), step);
    step *= layout.elementShape[d];
  }
  Mirror *mirror = field.tree().mirror();
  exported.onDevice = mirror != nullptr;
  if (mirror) {
    Status status =
        devices.addressOf(field.tree(), layout.placeOffset, exported.address);
    if (!status)
      return status;
  } else {
    exported.address = field.writable();
  }
  exported.buffer = std::make_unique<ExportedBuffer>(field.sharedTree());
  return devices.takeFailure();
}
