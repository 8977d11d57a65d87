//===- Loan.cpp - Fields in the hands of other libraries ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A library that has the address of a field writes to it without a word. On a
// device, what the host holds of the tree is therefore never current while the
// tree is lent, unless the host is the last that wrote.
//
//===----------------------------------------------------------------------===//

#include "../Mirror/DeviceContext.h"
#include "../Mirror/Mirror.h"
#include "../Storage/Scalars.h"
#include "tai/Runtime/Launch/Runtime.h"
#include <algorithm>

using namespace mlir::tai::runtime;

std::atomic<int> Loan::count{0};

Loan::Loan(const TreePtr &tree)
    : tree(tree), memory(tree->memory), mirror(tree->mirrored) {
  count.fetch_add(1, std::memory_order_relaxed);
  tree->loans.fetch_add(1, std::memory_order_relaxed);
  if (mirror)
    mirror->lend();
}

Loan::~Loan() {
  if (mirror)
    mirror->takeBack();
  tree->loans.fetch_sub(1, std::memory_order_relaxed);
  count.fetch_sub(1, std::memory_order_relaxed);
}

/// The bytes of the tree that the field lies in, where it can be lent.
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

Status Runtime::checkLentFields(const Kernel &kernel,
                                const uint64_t *args) const {
  for (const Access &access : kernel.summary()) {
    const Field &field = *access.field;
    uint64_t begin = 0, end = 0;
    if (!field.valid() || !field.tree().isLent() ||
        !findExtent(field, begin, end))
      continue;
    const Mirror *mirror = field.tree().mirror();
    uint64_t base = mirror ? mirror->at(0)
                           : reinterpret_cast<uint64_t>(field.tree().base());
    for (const ArrayArgument &array : kernel.arrays()) {
      uint64_t from = args[array.slot];
      uint64_t bytes = static_cast<uint64_t>(array.elementBytes);
      for (int64_t d = 1; d <= array.rank; ++d)
        bytes *= args[array.slot + d];
      if (bytes > 0 && from < base + end && base + begin < from + bytes)
        return Status::failure(
            StatusCode::Usage,
            "kernel '" + kernel.name() + "' uses field '" + field.name() +
                "' and is given an array that shares its memory; give it a "
                "copy, or let it use one of them alone",
            kernel.place());
    }
  }
  return Status::success();
}

Status Runtime::lend(Field &field, LentField &lent) {
  auto refuse = [&](const char *why) {
    return Status::failure(StatusCode::Usage, "field '" + field.name() +
                                                  "' cannot be shared: " + why);
  };
  if (!field.valid())
    return refuse("its tree has been destroyed");
  if (field.sparseNode())
    return refuse("it is sparse; copy it, by to_numpy or to_torch");
  const FieldLayout &layout = field.layout();
  lent.strides.clear();
  for (int d = 0; d < field.rank(); ++d) {
    int64_t step = 0;
    if (!findConstantStep(layout.indices[static_cast<size_t>(d)], step))
      return refuse("its layout divides an index in blocks; copy it, by "
                    "to_numpy or to_torch");
    lent.strides.push_back(step);
  }
  size_t first = lent.strides.size();
  int64_t step = field.numComponents() > 1 ? layout.componentStride
                                           : byteSize(field.scalar());
  for (size_t d = layout.elementShape.size(); d-- > 0;) {
    lent.strides.insert(lent.strides.begin() + static_cast<ptrdiff_t>(first),
                        step);
    step *= layout.elementShape[d];
  }
  // Others look at the memory of the whole tree from now on.
  settleZeros();
  Mirror *mirror = field.tree().mirror();
  lent.onDevice = mirror != nullptr;
  if (mirror) {
    Status status =
        deviceAddress(field.tree(), layout.placeOffset, lent.address);
    if (!status)
      return status;
  } else {
    lent.address = field.writable();
  }
  lent.loan = std::make_unique<Loan>(field.owner);
  return takeDeviceFailure();
}

Status Runtime::noteOutsideWrite(Field &field) {
  if (recordingTape() && !field.isAdjoint())
    return Status::failure(
        StatusCode::Usage,
        "field '" + field.name() +
            "' is written from outside while a tape records");
  ++field.hostVersion;
  field.markDirty();
  return Status::success();
}

Status Runtime::waitForStream(uint64_t stream) {
  return device ? device->get().waitForStream(stream) : Status::success();
}

Status Runtime::letStreamWait(uint64_t stream) {
  return device ? device->get().letStreamWait(stream) : Status::success();
}

static Status hasNoDevice() {
  return Status::failure(StatusCode::Usage,
                         "there is no device that arrays could be kept on");
}

Status Runtime::allocateOnDevice(int64_t bytes, void *&address) {
  address = nullptr;
  if (!device)
    return hasNoDevice();
  DevicePtr memory = 0;
  Status status =
      device->allocate(std::max<int64_t>(bytes, 1), "copies of arrays", memory);
  address = reinterpret_cast<void *>(memory);
  return status;
}

void Runtime::freeOnDevice(void *address) {
  if (device && address)
    device->free(reinterpret_cast<DevicePtr>(address));
}

Status Runtime::copyOnDevice(void *to, const void *from, int64_t bytes) {
  if (!device)
    return hasNoDevice();
  return bytes == 0
             ? Status::success()
             : device->get().copy(reinterpret_cast<DevicePtr>(to),
                                  reinterpret_cast<DevicePtr>(from), bytes);
}

bool Runtime::isOnDevice(const void *address) const {
  return device && device->get().isDeviceMemory(address);
}
