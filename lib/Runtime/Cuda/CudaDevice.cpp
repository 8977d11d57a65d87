//===- CudaDevice.cpp - Opening a GPU, and its memory ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "CudaDevice.h"
#include "tai/Runtime/Device/DeviceHeap.h"
#include "tai/Runtime/Device/DeviceReport.h"
#include "tai/Runtime/Device/FillRun.h"
#include "tai/Runtime/Text/Format.h"
#include <algorithm>
#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <cstring>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::cuda;

thread_local uint64_t CudaDevice::enteredLast = 0;

uint64_t CudaDevice::nextIdentity() {
  static std::atomic<uint64_t> last{0};
  return ++last;
}

/// Whether `result` means that a kernel has accessed memory out of bounds, the
/// only cause of these error codes in compiled kernels.
static bool isFault(Result result) {
  return result == kIllegalAddress ||
         (result >= kHardwareStackError && result <= kLaunchFailed);
}

Status CudaDevice::failure(Result result, const char *what) const {
  if (isFault(result))
    return deviceWentOutOfRange(std::string(what) + ": " + cu.describe(result));
  return Status::failure(result == kOutOfMemory ? StatusCode::Memory
                                                : StatusCode::Internal,
                         std::string(what) + " (" + cu.describe(result) + ")");
}

//===----------------------------------------------------------------------===//
// Opening and closing
//===----------------------------------------------------------------------===//

static Status noDevice(const std::string &why) {
  std::string message = "no CUDA device: " + why;
  // If the machine has a GPU, CUDA_VISIBLE_DEVICES is the usual reason why none
  // is found.
  if (const char *visible = std::getenv("CUDA_VISIBLE_DEVICES"))
    message += "; the environment variable CUDA_VISIBLE_DEVICES is '" +
               std::string(visible) + "', which hides all others";
  return Status::failure(StatusCode::Usage, std::move(message));
}

Status mlir::tai::runtime::openCudaDevice(int ordinal,
                                          std::unique_ptr<Device> &device) {
  const Driver *driver = nullptr;
  Status status = Driver::get(driver);
  if (!status)
    return status;
  Result result = driver->init(0);
  if (result == kNoDevice)
    return noDevice("the driver finds none");
  if (result != kSuccess)
    return Status::failure(StatusCode::Usage,
                           "the CUDA driver does not start (" +
                               driver->describe(result) + ")");
  int count = 0;
  result = driver->deviceGetCount(&count);
  if (result != kSuccess || count == 0)
    return noDevice("the driver finds none");
  if (ordinal < 0 || ordinal >= count)
    return noDevice("number " + std::to_string(ordinal) +
                    " was asked for, and the driver finds " +
                    std::to_string(count));
  DeviceNumber number = 0;
  result = driver->deviceGet(&number, ordinal);
  if (result != kSuccess)
    return noDevice(driver->describe(result));
  auto made = std::make_unique<CudaDevice>(*driver, number);
  status = made->open();
  if (status)
    device = std::move(made);
  return status;
}

Status CudaDevice::open() {
  char text[256] = {};
  (void)cu.deviceGetName(text, sizeof(text) - 1, number);
  label = text;
  int major = 0, minor = 0, multiprocessors = 1, threads = 1, pools = 0;
  size_t bytes = 0;
  Status status = check(cu.primaryCtxRetain(&context, number),
                        "the CUDA device cannot be used");
  if (!status) {
    context = nullptr;
    return Status::failure(status.code(),
                           status.message() + ": " + label +
                               "; another process may hold all of its memory, "
                               "or have it to itself");
  }
  (void)cu.deviceGetAttribute(&major, kCapabilityMajor, number);
  (void)cu.deviceGetAttribute(&minor, kCapabilityMinor, number);
  (void)cu.deviceGetAttribute(&multiprocessors, kMultiprocessorCount, number);
  (void)cu.deviceGetAttribute(&threads, kMaxThreadsPerBlock, number);
  (void)cu.deviceGetAttribute(&pools, kMemoryPools, number);
  int resident = 0, managed = 0;
  (void)cu.deviceGetAttribute(&resident, kMaxThreadsPerMultiprocessor, number);
  (void)cu.deviceGetAttribute(&managed, kConcurrentManagedAccess, number);
  (void)cu.deviceTotalMem(&bytes, number);
  architecture = "sm_" + std::to_string(10 * major + minor);
  most.multiprocessors = static_cast<unsigned>(multiprocessors);
  most.threadsPerBlock = static_cast<unsigned>(threads);
  most.memoryBytes = static_cast<int64_t>(bytes);
  most.threadsPerMultiprocessor = static_cast<unsigned>(resident);
  // The bytes of reserved memory that the driver commits at the first access to
  // a distant address, as measured on an H200.
  most.reservedPieceBytes = managed ? int64_t(2) << 20 : 0;
  int cooperative = 0, clusters = 0;
  (void)cu.deviceGetAttribute(&cooperative, kCooperativeLaunch, number);
  (void)cu.deviceGetAttribute(&clusters, kClusterLaunch, number);
  most.hasGraphs = true;
  most.hasGridBarriers = cooperative != 0;
  // A cluster has at most 16 blocks on Hopper; a kernel must opt in to more
  // than 8.
  most.mostClusterBlocks = clusters ? 16 : 1;
  // Devices with clusters also have programmatic dependent launch.
  most.hasOverlaps = clusters != 0;
  if (major < 6)
    return Status::failure(
        StatusCode::Usage,
        label + " has compute capability " + std::to_string(major) + "." +
            std::to_string(minor) + ", and 6.0 or newer is needed");
  status = enter();
  // The device's stream is ordered with the default stream, on which other
  // libraries hand over their arrays.
  Result made = status ? cu.streamCreate(&stream, 0) : kSuccess;
  if (status && made != kSuccess && made != kOutOfMemory) {
    // A kernel that failed earlier has invalidated the context: all memory of
    // the context is lost, and so are all objects that depend on it. So a new
    // context is made.
    (void)cu.primaryCtxReset(number);
    made = cu.streamCreate(&stream, 0);
  }
  if (status)
    status = check(made, "no stream can be made");
  if (status && most.hasOverlaps &&
      cu.streamCreate(&side, kStreamNonBlocking) != kSuccess)
    side = nullptr;
  if (status)
    status = setHeap(bytes);
  void *memory = nullptr;
  if (status)
    status = check(cu.memAllocHost(&memory, stagingBytes),
                   "no memory for copies can be had");
  staging = static_cast<char *>(memory);
  if (status)
    status = kernels.load();
  if (!status || !pools)
    return status;
  PoolProperties properties;
  properties.locationId = number;
  if (cu.memPoolCreate(&pool, &properties) != kSuccess) {
    pool = nullptr;
    return status;
  }
  // Freed memory stays in the pool, for the next allocation.
  uint64_t threshold = UINT64_MAX;
  (void)cu.memPoolSetAttribute(pool, kPoolReleaseThreshold, &threshold);
  return status;
}

/// Sets the size of the heap from which running kernels allocate memory, for
/// the history of loops in gradients.
Status CudaDevice::setHeap(size_t memoryBytes) {
  auto wanted = static_cast<size_t>(deviceHeapBytes());
  size_t bytes =
      wanted ? wanted : std::min<size_t>(memoryBytes / 32, size_t(4) << 30);
  Result result = cu.ctxSetLimit(kLimitHeapBytes, bytes);
  size_t known = 0;
  // The heap cannot be resized after a kernel has used it; a heap that is large
  // enough stays.
  if (result == kSuccess || !wanted ||
      (cu.ctxGetLimit(&known, kLimitHeapBytes) == kSuccess && known >= wanted))
    return Status::success();
  return Status::failure(
      StatusCode::Usage,
      "the heap of kernels cannot have " + formatBytes(deviceHeapBytes()) +
          " (" + cu.describe(result) + "): it has " +
          formatBytes(static_cast<int64_t>(known)) +
          ", and can be changed until the first kernel that uses it is "
          "launched");
}

CudaDevice::~CudaDevice() {
  if (!context)
    return;
  kernels.unload();
  // At the end of a process, the driver may already have shut down.
  if (enter()) {
    if (stream)
      (void)cu.streamSynchronize(stream);
    for (const auto &[address, bytes] : allocations)
      (void)(pool ? cu.memFreeAsync(address, stream) : cu.memFree(address));
    for (DevicePtr address : reserved)
      (void)cu.memFree(address);
    if (staging)
      (void)cu.memFreeHost(staging);
    if (orderEvent)
      (void)cu.eventDestroy(orderEvent);
    if (stopSource)
      (void)cu.memFreeHost(stopSource);
    if (stopStream)
      (void)cu.streamDestroy(stopStream);
    if (stream) {
      (void)cu.streamSynchronize(stream);
      (void)cu.streamDestroy(stream);
    }
    if (side)
      (void)cu.streamDestroy(side);
    if (pool)
      (void)cu.memPoolDestroy(pool);
  }
  (void)cu.primaryCtxRelease(number);
}

//===----------------------------------------------------------------------===//
// Memory
//===----------------------------------------------------------------------===//

Status CudaDevice::allocateOnce(int64_t bytes, Address &address) {
  auto size = static_cast<size_t>(bytes);
  return check(pool ? cu.memAllocFromPoolAsync(&address, size, pool, stream)
                    : cu.memAlloc(&address, size),
               "the device has no memory left");
}

Status CudaDevice::allocate(int64_t bytes, DevicePtr &memory) {
  memory = 0;
  Status status = enter();
  if (!status)
    return status;
  bytes = std::max<int64_t>(bytes, 1);
  Address address = 0;
  status = allocateOnce(bytes, address);
  if (status.code() == StatusCode::Memory && pool) {
    // The free memory of the driver's pool can be fragmented, so it is returned
    // to the driver before a second attempt.
    (void)cu.streamSynchronize(stream);
    (void)cu.memPoolTrimTo(pool, 0);
    status = allocateOnce(bytes, address);
  }
  if (!status)
    return status;
  memory = address;
  std::lock_guard<std::mutex> lock(mutex);
  allocations.emplace(memory, bytes);
  allocated += bytes;
  return status;
}

// Managed memory that the host never accesses: the driver provides zeroed pages
// when device code touches them. With the device as their preferred location,
// pages that are far apart would be provided later, and no page sooner.
Status CudaDevice::reserve(int64_t bytes, DevicePtr &memory) {
  memory = 0;
  Status status = enter();
  if (!status)
    return status;
  Address address = 0;
  status = check(
      cu.memAllocManaged(&address, static_cast<size_t>(bytes), kAttachGlobal),
      "memory cannot be reserved");
  if (!status)
    return status;
  memory = address;
  std::lock_guard<std::mutex> lock(mutex);
  reserved.insert(memory);
  return status;
}

void CudaDevice::free(DevicePtr memory) {
  bool wasReserved = false;
  {
    std::lock_guard<std::mutex> lock(mutex);
    wasReserved = reserved.erase(memory) != 0;
  }
  if (wasReserved) {
    if (enter() && cu.streamSynchronize(stream) == kSuccess)
      (void)cu.memFree(memory);
    return;
  }
  {
    std::lock_guard<std::mutex> lock(mutex);
    auto found = allocations.find(memory);
    if (found == allocations.end())
      return;
    allocated -= found->second;
    allocations.erase(found);
  }
  if (enter())
    (void)(pool ? cu.memFreeAsync(memory, stream) : cu.memFree(memory));
}

int64_t CudaDevice::freeBytes() const {
  size_t left = 0, all = 0;
  if (!enter() || cu.memGetInfo(&left, &all) != kSuccess)
    return 0;
  return static_cast<int64_t>(left);
}

Status CudaDevice::copyIn(DevicePtr to, const void *from, int64_t bytes) {
  Status status = enter();
  if (!status || bytes <= 0)
    return status;
  auto size = static_cast<size_t>(bytes);
  Section::Entry entry(stagingCopies);
  // A copy made by a handler must not use the staging memory of the copy that
  // the handler has interrupted.
  if (bytes > largestStaged || entry.isAgain()) {
    status = check(cu.memcpyHtoDAsync(to, from, size, stream),
                   "a copy to the device fails");
    // If `from` is pinned memory, the copy call returns before the device has
    // read the memory, so the host waits.
    return status ? synchronize() : std::move(status);
  }
  int64_t room = (bytes + 63) / 64 * 64;
  if (staged + room > stagingBytes) {
    status = synchronize();
    if (!status)
      return status;
    staged = 0;
  }
  char *piece = staging + staged;
  staged += room;
  std::memcpy(piece, from, size);
  return check(cu.memcpyHtoDAsync(to, piece, size, stream),
               "a copy to the device fails");
}

Status CudaDevice::copyOut(void *to, DevicePtr from, int64_t bytes) {
  Status status = enter();
  if (!status || bytes <= 0)
    return status;
  auto size = static_cast<size_t>(bytes);
  const char *what = "a copy from the device fails";
  Section::Entry entry(stagingCopies);
  if (bytes > largestStaged || entry.isAgain()) {
    status = check(cu.memcpyDtoHAsync(to, from, size, stream), what);
    return status ? synchronize() : std::move(status);
  }
  int64_t room = (bytes + 63) / 64 * 64;
  if (staged + room > stagingBytes) {
    status = synchronize();
    staged = 0;
  }
  char *piece = staging + staged;
  if (status)
    status = check(cu.memcpyDtoHAsync(piece, from, size, stream), what);
  if (status)
    status = synchronize();
  if (!status)
    return status;
  // All queued copies have arrived, so that the staging memory is free again.
  staged = 0;
  std::memcpy(to, piece, size);
  return status;
}

Status CudaDevice::copy(DevicePtr to, DevicePtr from, int64_t bytes) {
  Status status = enter();
  if (!status || bytes <= 0)
    return status;
  // In contrast to the driver's copy, the runtime's own kernel can be made
  // ready while earlier work runs.
  constexpr int64_t fewBytes = 1 << 20;
  if (doesOverlap() && bytes <= fewBytes)
    return copyRows({to, 0, bytes, 1}, from, 0);
  isAfterKernel = false;
  return check(cu.memcpyDtoDAsync(to, from, static_cast<size_t>(bytes), stream),
               "a copy on the device fails");
}

Status CudaDevice::copyRows(const DeviceRows &to, DevicePtr from,
                            int64_t fromStep) {
  return kernels.runPairs(CudaKernels::CopyRows, to, from, fromStep,
                          doesOverlap());
}

Status CudaDevice::swapRows(const DeviceRows &one, DevicePtr other,
                            int64_t otherStep) {
  return kernels.runPairs(CudaKernels::SwapRows, one, other, otherStep,
                          doesOverlap());
}

bool CudaDevice::isDeviceMemory(const void *address) const {
  unsigned type = 0;
  return enter() &&
         cu.pointerGetAttribute(&type, kAddressMemoryType,
                                reinterpret_cast<Address>(address)) ==
             kSuccess &&
         (type == kMemoryTypeDevice || type == kMemoryTypeUnified);
}

//===----------------------------------------------------------------------===//
// Fills
//===----------------------------------------------------------------------===//

static int64_t bytesOf(const DeviceRows &rows) {
  return rows.rowBytes * rows.rows * rows.outer;
}

/// Fills by the driver, unless the pattern is too long for the driver. A call
/// of the driver takes a microsecond, however small the fill is.
Status CudaDevice::fill(DevicePtr to, const void *pattern, int patternBytes,
                        int64_t count) {
  Status status = enter();
  if (!status || count <= 0)
    return status;
  isAfterKernel = false;
  auto size = static_cast<size_t>(count);
  char what[96];
  std::snprintf(what, sizeof what,
                "%lld elements of %d bytes at %#llx cannot be filled",
                static_cast<long long>(count), patternBytes,
                static_cast<unsigned long long>(to));
  auto *bytes = static_cast<const char *>(pattern);
  bool zero =
      std::all_of(bytes, bytes + patternBytes, [](char b) { return !b; });
  if (zero || patternBytes == 1)
    return check(cu.memsetD8Async(to, static_cast<unsigned char>(bytes[0]),
                                  size * static_cast<size_t>(patternBytes),
                                  stream),
                 what);
  if (patternBytes == 2) {
    unsigned short value;
    std::memcpy(&value, pattern, sizeof(value));
    return check(cu.memsetD16Async(to, value, size, stream), what);
  }
  unsigned words[2] = {};
  std::memcpy(words, pattern, static_cast<size_t>(patternBytes));
  if (patternBytes == 4 || words[0] == words[1])
    return check(cu.memsetD32Async(to, words[0],
                                   size * static_cast<size_t>(patternBytes / 4),
                                   stream),
                 what);
  DeviceFill pairs{{to, 0, 8 * count, 1}, repeatPattern(pattern, 8), 8};
  return fillByKernel({&pairs});
}

/// In a branch of a graph, the fill kernel has one block on each
/// multiprocessor, which leaves room for concurrent launches.
Status CudaDevice::fillByKernel(const std::vector<const DeviceFill *> &fills) {
  return kernels.fill(fills, doesOverlap(),
                      branch == Branch::Capturing ? most.multiprocessors : 0);
}

Status CudaDevice::fillRows(const DeviceRows &to, const void *pattern,
                            int patternBytes) {
  DeviceFill fill{to, repeatPattern(pattern, patternBytes), patternBytes};
  return fillByKernel({&fill});
}

/// A large fill is left to the driver, since overlapping it with other launches
/// gains nothing.
Status CudaDevice::fillAlone(const DeviceFill &fill) {
  const DeviceRows &rows = fill.rows;
  bool byKernel = (doesOverlap() || branch == Branch::Capturing) &&
                  bytesOf(rows) < largeFillBytes();
  return isDense(rows) && !byKernel && !fill.isJoined
             ? this->fill(rows.address, &fill.pattern, fill.patternBytes,
                          rows.rowBytes / fill.patternBytes)
             : fillByKernel({&fill});
}

Status CudaDevice::fillAll(const std::vector<DeviceFill> &fills) {
  if (fills.size() == 1)
    return fillAlone(fills.front());
  // The small fills are combined in one kernel at the end; the device prepares
  // later work while that kernel runs.
  Status status;
  int64_t large = largeFillBytes();
  std::vector<const DeviceFill *> together;
  for (const DeviceFill &fill : fills)
    if (bytesOf(fill.rows) < large)
      together.push_back(&fill);
    else if (status)
      status = fillAlone(fill);
  if (status && together.size() == 1)
    return fillAlone(*together.front());
  return status ? fillByKernel(together) : std::move(status);
}
