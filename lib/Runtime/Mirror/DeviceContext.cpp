//===- DeviceContext.cpp - Device resources of a runtime ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Mirror/DeviceContext.h"
#include "tai/Runtime/Device/DeviceReport.h"
#include "tai/Runtime/Device/FailureNotice.h"
#include "tai/Runtime/Text/Format.h"
#include "tai/Runtime/Threads/Safepoint.h"
#include <algorithm>
#include <cstddef>
#include <utility>

using namespace mlir::tai::runtime;

/// The bytes of lines that kernels can print before the host waits for the
/// device.
static constexpr int64_t outputBytes = 1 << 20;
/// The maximum size of a stack on which a gradient kernel keeps the values of a
/// loop on the device.
static constexpr int64_t stackBytes = 256 << 20;

DeviceContext::DeviceContext(const DeviceServices &services,
                             std::unique_ptr<Device> device, int64_t limit,
                             std::shared_ptr<Profiler> profiler)
    : services(services), limit(limit) {
  bool profiles = profiler->isOn();
  auto made =
      std::make_unique<WatchedDevice>(std::move(device), std::move(profiler));
  watched = made.get();
  this->device =
      std::make_unique<DeviceQueue>(std::move(made), watched->unwatched());
  libraryKernels = std::make_unique<LibraryKernels>(*this->device);
  this->device->setOneByOne(profiles);
}

DeviceContext::~DeviceContext() {
  dropSpare();
  if (stateMemory)
    free(stateMemory);
}

//===----------------------------------------------------------------------===//
// Memory
//===----------------------------------------------------------------------===//

Status DeviceContext::allocate(int64_t bytes, const std::string &owner,
                               DevicePtr &memory) {
  std::lock_guard<std::recursive_mutex> lock(mutex);
  // At the memory limit, the pool of spare blocks is freed, because a recording
  // that would reuse them may never come.
  if (limit > 0 && bytes > limit - held)
    dropSpare();
  Status status;
  std::string why;
  if (limit > 0 && bytes > limit - held)
    why = "a limit of " + formatBytes(limit) + " is set";
  else if (status = allocateNow(bytes, memory); status) {
    try {
      holdings[memory] = {owner, bytes};
    } catch (const std::bad_alloc &) {
      device->free(memory);
      throw;
    }
    held += bytes;
    return status;
  } else if (status.code() != StatusCode::Memory)
    return status;
  else
    why = formatBytes(device->freeBytes()) + " of " +
          formatBytes(device->limits().memoryBytes) + " are free";
  std::string message = "out of memory on the device '" + device->name() +
                        "': " + owner + " needs " + formatBytes(bytes) + ", " +
                        why;
  if (holdings.empty())
    return Status::failure(StatusCode::Memory,
                           message + "; this program holds nothing else there");
  // For the message, the allocated bytes are summed by owner.
  std::map<std::string, int64_t> sums;
  for (const auto &[address, holding] : holdings)
    sums[holding.owner] += holding.bytes;
  std::vector<std::pair<std::string, int64_t>> rows(sums.begin(), sums.end());
  std::sort(rows.begin(), rows.end(), [](const auto &a, const auto &b) {
    return a.second != b.second ? a.second > b.second : a.first < b.first;
  });
  constexpr size_t mostRows = 8;
  message += "; this program holds " + formatBytes(held) + ": ";
  for (size_t i = 0; i < std::min(rows.size(), mostRows); ++i)
    message +=
        (i ? ", " : "") + rows[i].first + " " + formatBytes(rows[i].second);
  if (rows.size() > mostRows)
    message += " and " + std::to_string(rows.size() - mostRows) + " more";
  return Status::failure(StatusCode::Memory, std::move(message));
}

Status DeviceContext::reserve(int64_t bytes, const std::string &owner,
                              DevicePtr &memory) {
  std::lock_guard<std::recursive_mutex> lock(mutex);
  Status status = device->reserve(bytes, memory);
  if (status)
    holdings[memory] = {owner, 0};
  return status;
}

int64_t DeviceContext::mostBytes() const {
  int64_t all = device->limits().memoryBytes;
  return limit > 0 ? std::min(limit, all) : all;
}

int64_t DeviceContext::leftToReserved(int64_t taken) {
  std::lock_guard<std::recursive_mutex> lock(mutex);
  // If device memory runs out, pages move to the host, which is worse than a
  // failure. So keep some memory for lists, copies and kernels.
  int64_t kept = device->limits().memoryBytes / 32;
  int64_t left = device->freeBytes() - kept;
  if (limit > 0)
    left = std::min(left, limit - held - taken);
  return std::max<int64_t>(left, 0);
}

Status DeviceContext::allocateNow(int64_t bytes, DevicePtr &memory) {
  Status status = device->allocate(bytes, memory);
  if (status || spare.empty() || status.code() != StatusCode::Memory)
    return status;
  dropSpare();
  return device->allocate(bytes, memory);
}

void DeviceContext::dropSpare() {
  // Freeing a block may run queued work, and a signal handler may then add to
  // `spare`.
  auto dropped = std::exchange(spare, {});
  for (auto [bytes, memory] : dropped) {
    held -= bytes;
    holdings.erase(memory);
    device->free(memory);
  }
}

Status DeviceContext::take(int64_t bytes, const std::string &owner,
                           DevicePtr &memory) {
  {
    std::lock_guard<std::recursive_mutex> lock(mutex);
    // The block that was returned first is taken, so that requests in the same
    // order get the same memory again.
    if (auto found = spare.lower_bound(bytes);
        found != spare.end() && found->first == bytes) {
      memory = found->second;
      spare.erase(found);
      return Status::success();
    }
  }
  return allocate(bytes, owner, memory);
}

void DeviceContext::giveBack(int64_t bytes, DevicePtr memory) {
  // Queued work runs in order, so work of the block's next owner comes after
  // work of its present users.
  constexpr int often = 2;
  std::lock_guard<std::recursive_mutex> lock(mutex);
  try {
    spare.emplace(bytes, memory);
  } catch (const std::bad_alloc &) {
    free(memory);
    return;
  }
  if (numRecordings < often)
    dropSpare();
}

void DeviceContext::free(DevicePtr memory) {
  std::lock_guard<std::recursive_mutex> lock(mutex);
  auto found = holdings.find(memory);
  if (found == holdings.end())
    return;
  held -= found->second.bytes;
  holdings.erase(found);
  // Destructors call this function, so no exception may leave it.
  try {
    device->free(memory);
  } catch (const std::bad_alloc &) {
    noteOutOfMemory();
  }
}

void DeviceContext::noteOutOfMemory() noexcept {
  try {
    note(Status::failure(StatusCode::Memory, "out of memory"));
  } catch (const std::bad_alloc &) {
    // Without host memory to keep the block in a list, nothing is done: the
    // next allocation will fail and report the lack of memory.
  }
}

void DeviceContext::beginRecording() {
  ++numRecordings;
  if (!device->keepsLaunches())
    collections.fetch_add(1, std::memory_order_relaxed);
  note(device->beginRecording());
}

void DeviceContext::endRecording(bool isSwept) {
  note(device->endRecording(isSwept));
  if (device->expectsLaunches())
    collections.fetch_add(1, std::memory_order_relaxed);
  // Drops spare memory blocks that the recording did not need.
  std::lock_guard<std::recursive_mutex> lock(mutex);
  dropSpare();
}

//===----------------------------------------------------------------------===//
// Failures and output
//===----------------------------------------------------------------------===//

Status DeviceContext::state(DevicePtr &memory) {
  Section::Entry entry(makingState);
  if (entry.isAgain())
    return entry.check();
  if (!stateMemory) {
    DevicePtr made = 0;
    Status status =
        allocate(static_cast<int64_t>(sizeof(TaiDeviceState)) + outputBytes,
                 "failures and output of kernels", made);
    TaiDeviceState fresh = freshDeviceState(outputBytes, stackBytes);
    if (status) {
      status = device->copyIn(made, &fresh, sizeof(fresh));
      if (!status)
        free(made);
    }
    if (!status)
      return status;
    stateMemory = made;
    device->setStopWord(made + offsetof(TaiDeviceState, stop));
  }
  memory = stateMemory;
  return Status::success();
}

Status DeviceContext::report() {
  if (!stateUsed.exchange(false, std::memory_order_relaxed))
    return Status::success();
  TaiDeviceState found;
  Status status = device->copyOut(&found, stateMemory, sizeof(found));
  if (!status || !hasDeviceReport(found))
    return status;
  auto bytes = static_cast<int64_t>(deviceOutputBytes(found));
  std::vector<char> output(static_cast<size_t>(bytes));
  status = device->copyOut(output.data(), stateMemory + sizeof(found), bytes);
  TaiDeviceState fresh = freshDeviceState(outputBytes, stackBytes);
  if (status)
    status = device->copyIn(stateMemory, &fresh, sizeof(fresh));
  DeviceReport report;
  if (status)
    status = readDeviceReport(found, output.data(),
                              static_cast<uint64_t>(bytes), report);
  if (!status)
    return status;
  for (std::string &line : report.lines)
    services.printer.print(endPrinted(std::move(line)));
  if (report.lostLines)
    services.printer.print(
        "[tai] " + std::to_string(report.lostLines) +
        " lines that kernels printed were lost: there is room for " +
        formatBytes(outputBytes) +
        " of them on the device until the next wait for it\n");
  // The thread that asked the kernel to stop gets the failure of the kernel.
  // Another thread must know that it has waited for incomplete work.
  if (report.failure && report.stoppedBy &&
      report.stoppedBy != safepoint::threadNumber())
    return Status::failure(StatusCode::Interrupted,
                           "a kernel was interrupted by another thread: what "
                           "it has computed is not complete");
  if (!report.failure)
    noticeDeviceFailure(report.failure.message());
  return std::move(report.failure);
}

void DeviceContext::note(Status status) {
  if (status)
    return;
  std::lock_guard<std::recursive_mutex> lock(mutex);
  if (noted.load(std::memory_order_relaxed))
    return;
  failure = std::move(status);
  noted.store(true, std::memory_order_release);
}

Status DeviceContext::takeNoted() {
  std::lock_guard<std::recursive_mutex> lock(mutex);
  noted.store(false, std::memory_order_relaxed);
  return std::move(failure);
}

//===----------------------------------------------------------------------===//
// Launches
//===----------------------------------------------------------------------===//

DeviceLaunch::~DeviceLaunch() {
  if (block)
    context->free(block);
}

Status DeviceLaunch::scratch(int64_t bytes, DevicePtr &result) {
  constexpr int64_t smallestBlock = 1 << 20;
  const char zero = 0;
  memory = std::max(memory, Memory::Temporary);
  bytes = std::max<int64_t>((bytes + 255) / 256 * 256, 256);
  if (collection != context->numCollections()) {
    collection = context->numCollections();
    if (used > 0) {
      Status status = context->get().fill(block, &zero, 1, used);
      if (!status)
        return status;
    }
    start = used = 0;
  }
  if (bytes > blockBytes - used) {
    bool fresh = bytes > blockBytes || start < used;
    if (fresh) {
      int64_t size = std::max({smallestBlock, 2 * blockBytes, bytes});
      DevicePtr larger = 0;
      Status status =
          context->allocate(size, "scratch memory of kernels", larger);
      if (!status && size > bytes) {
        size = bytes;
        status = context->allocate(size, "scratch memory of kernels", larger);
      }
      if (!status)
        return status;
      if (block)
        outgrown.push_back(block);
      block = larger;
      used = blockBytes = size;
    }
    Status status = context->get().fill(block, &zero, 1, used);
    if (!status)
      return status;
    start = used = 0;
  }
  result = block + static_cast<DevicePtr>(used);
  used += bytes;
  return Status::success();
}

Status DeviceLaunch::array(void *host, int64_t bytes, bool written,
                           DevicePtr &result) {
  Device &device = context->get();
  // An empty array has no copy. An array of another library in device memory
  // is used in place.
  if (bytes == 0 || device.isDeviceMemory(host)) {
    result = reinterpret_cast<DevicePtr>(host);
    if (bytes > 0 && context->queue().mayKeep())
      memory = Memory::Others;
    return Status::success();
  }
  memory = std::max(memory, Memory::Temporary);
  // An array that is passed to a launch twice has one copy on the device.
  for (Array &known : arrays)
    if (known.host == host && known.bytes >= bytes) {
      known.written |= written;
      result = known.memory;
      return Status::success();
    }
  Status status = context->allocate(std::max<int64_t>(bytes, 1),
                                    "arrays given to kernels", result);
  if (!status)
    return status;
  arrays.push_back({host, result, bytes, written});
  return device.copyIn(result, host, bytes);
}

Status DeviceLaunch::finish() {
  Status status;
  for (const Array &array : arrays) {
    if (array.written && status) {
      status = context->get().copyOut(array.host, array.memory, array.bytes);
      waited = true;
    }
    context->free(array.memory);
  }
  arrays.clear();
  for (DevicePtr smaller : outgrown)
    context->free(smaller);
  outgrown.clear();
  start = used;
  // Another library reads its memory without queueing deferred launches first,
  // so they are queued now.
  if (memory == Memory::Others && status)
    status = context->queue().settle();
  memory = Memory::Trees;
  return status;
}
