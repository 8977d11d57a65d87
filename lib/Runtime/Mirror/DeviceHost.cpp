//===- DeviceHost.cpp - The device of a runtime ---------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Mirror/DeviceHost.h"
#include "tai/Runtime/Mirror/Mirror.h"
#include <algorithm>

using namespace mlir::tai::runtime;

DeviceHost::DeviceHost(const DeviceServices &services)
    : services(services), sharedProfiler(std::make_shared<Profiler>()) {}

DeviceHost::~DeviceHost() = default;

void DeviceHost::use(std::unique_ptr<Device> device, int64_t memoryLimit) {
  context = device
                ? std::make_shared<DeviceContext>(services, std::move(device),
                                                  memoryLimit, sharedProfiler)
                : nullptr;
}

Device *DeviceHost::device() const {
  return context ? &context->get() : nullptr;
}

DeviceQueue *DeviceHost::queue() const {
  return context ? &context->queue() : nullptr;
}

//===----------------------------------------------------------------------===//
// Trees
//===----------------------------------------------------------------------===//

Status DeviceHost::check(const std::string &name, int64_t bytes,
                         const std::vector<SparseInfo> &levels) const {
  return context ? SparseMirror::check(*context, name, bytes, levels)
                 : Status::success();
}

std::shared_ptr<Mirror> DeviceHost::make(Tree &tree, SparseOnDevice *&levels) {
  if (!context)
    return nullptr;
  auto made = std::make_shared<Mirror>(context, tree);
  levels = made->sparse();
  return made;
}

Status DeviceHost::addressOf(const Tree &tree, int64_t offset, void *&address) {
  Mirror *mirror = tree.mirror();
  if (!mirror)
    return Status::failure(StatusCode::Usage,
                           "tree '" + tree.name() + "' is not on a device");
  DevicePtr memory = 0;
  Status status = mirror->toDevice();
  if (status)
    status = mirror->allocate(memory);
  address = reinterpret_cast<void *>(memory + static_cast<DevicePtr>(offset));
  return status;
}

//===----------------------------------------------------------------------===//
// Failures
//===----------------------------------------------------------------------===//

Status DeviceHost::checkHandler() const {
  return context ? context->queue().checkHandler() : Status::success();
}

Status DeviceHost::synchronize() {
  if (!context)
    return Status::success();
  Status status = context->get().synchronize();
  if (status)
    status = context->take();
  return status ? context->report() : std::move(status);
}

void DeviceHost::noteFailure(Status status) {
  if (!status && context)
    context->note(std::move(status));
}

bool DeviceHost::hasNoted() const { return context->hasNoted(); }

Status DeviceHost::takeNoted() { return context->take(); }

//===----------------------------------------------------------------------===//
// The profiler
//===----------------------------------------------------------------------===//

void DeviceHost::setProfiler(bool on) {
  sharedProfiler->setOn(on);
  if (context)
    context->queue().setOneByOne(on);
}

bool DeviceHost::wantsPlaces() const {
  return sharedProfiler->isOn() || (context && context->watch().wantsPlaces());
}

Profiler &DeviceHost::collectedProfiler() {
  if (context) {
    noteFailure(context->get().synchronize());
    noteFailure(context->watch().collect());
  }
  return *sharedProfiler;
}

//===----------------------------------------------------------------------===//
// Other libraries
//===----------------------------------------------------------------------===//

Status DeviceHost::waitForStream(uint64_t stream) {
  return context ? context->get().waitForStream(stream) : Status::success();
}

Status DeviceHost::letStreamWait(uint64_t stream) {
  return context ? context->get().letStreamWait(stream) : Status::success();
}

static Status hasNoDevice() {
  return Status::failure(StatusCode::Usage,
                         "there is no device that arrays could be kept on");
}

Status DeviceHost::allocate(int64_t bytes, void *&address) {
  address = nullptr;
  if (!context)
    return hasNoDevice();
  DevicePtr memory = 0;
  Status status = context->allocate(std::max<int64_t>(bytes, 1),
                                    "copies of arrays", memory);
  address = reinterpret_cast<void *>(memory);
  return status;
}

void DeviceHost::free(void *address) {
  if (context && address)
    context->free(reinterpret_cast<DevicePtr>(address));
}

Status DeviceHost::copy(void *to, const void *from, int64_t bytes) {
  if (!context)
    return hasNoDevice();
  return bytes == 0
             ? Status::success()
             : context->get().copy(reinterpret_cast<DevicePtr>(to),
                                   reinterpret_cast<DevicePtr>(from), bytes);
}

Status DeviceHost::read(const void *from, int64_t step, int64_t bytes,
                        int64_t rows, void *to) {
  if (!context)
    return hasNoDevice();
  auto address = reinterpret_cast<DevicePtr>(from);
  if (rows == 1)
    return context->get().copyOut(to, address, bytes);
  std::unique_ptr<DeviceBlock> dense;
  Status status =
      DeviceBlock::make(context, rows * bytes, "samples of fields", dense);
  if (status)
    status = context->get().copyRows({dense->get(), bytes, bytes, rows},
                                     address, step);
  return status ? context->get().copyOut(to, dense->get(), rows * bytes)
                : std::move(status);
}

bool DeviceHost::isThere(const void *address) const {
  return context && context->get().isDeviceMemory(address);
}
