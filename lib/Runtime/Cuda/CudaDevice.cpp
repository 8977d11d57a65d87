//===- CudaDevice.cpp - A GPU behind the CUDA driver ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// One stream carries everything: launches, copies, fills and the end of memory
// are then in order without events. The context is the primary one of the
// device, which other libraries of the process use too.
//
//===----------------------------------------------------------------------===//

#include "../Launch.h"
#include "Driver.h"
#include "tai/Runtime/Device.h"
#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <map>
#include <mutex>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::cuda;

namespace mlir::tai {
// Made of Rows.cu when the project is built.
extern const unsigned char cudaRowKernels[];
extern const unsigned long cudaRowKernels_size;
} // namespace mlir::tai
using mlir::tai::cudaRowKernels;
using mlir::tai::cudaRowKernels_size;

namespace {
struct CudaModule;
struct CudaGraph;
struct CudaEvent;

struct CudaFunction : DeviceFunction {
  Function handle = nullptr;
  unsigned mostThreads = 0;
};

class CudaDevice final : public Device {
public:
  CudaDevice(const Driver &driver, int number) : cu(driver), number(number) {}
  ~CudaDevice() override;
  Status open();

  DeviceKind kind() const override { return DeviceKind::Cuda; }
  std::string name() const override { return label; }
  DeviceLimits limits() const override { return most; }
  std::string target() const override { return architecture; }

  Status allocate(int64_t bytes, DevicePtr &memory) override;
  void free(DevicePtr memory) override;
  int64_t allocatedBytes() const override {
    std::lock_guard<std::mutex> lock(mutex);
    return allocated;
  }
  int64_t freeBytes() const override;

  Status copyIn(DevicePtr to, const void *from, int64_t bytes) override;
  Status copyOut(void *to, DevicePtr from, int64_t bytes) override;
  Status copy(DevicePtr to, DevicePtr from, int64_t bytes) override;
  Status fill(DevicePtr to, const void *pattern, int patternBytes,
              int64_t count) override;
  Status copyRows(const DeviceRows &to, DevicePtr from,
                  int64_t fromStep) override;
  Status swapRows(const DeviceRows &one, DevicePtr other,
                  int64_t otherStep) override;
  Status fillRows(const DeviceRows &to, const void *pattern,
                  int patternBytes) override;
  bool isDeviceMemory(const void *address) const override;

  Status load(const DeviceImage &image,
              std::unique_ptr<DeviceModule> &module) override;
  Status find(DeviceModule &module, const std::string &name,
              DeviceFunction *&function) override;
  unsigned mostThreads(const DeviceFunction &function) const override {
    return static_cast<const CudaFunction &>(function).mostThreads;
  }
  unsigned residentBlocks(const DeviceFunction &function,
                          unsigned threads) const override;
  Status launch(DeviceFunction &function, const LaunchShape &shape,
                const uint64_t *slots, int count) override;
  Status beginCapture() override;
  Status endCapture(std::unique_ptr<DeviceGraph> &graph) override;
  Status run(DeviceGraph &graph) override;
  DeviceFunctionFacts facts(const DeviceFunction &function) const override;
  Status record(std::unique_ptr<DeviceEvent> &event) override;
  Status wait(DeviceEvent &event) override;
  Status elapsed(const DeviceEvent &from, const DeviceEvent &to,
                 int64_t &ns) override;
  Status synchronize() override;

private:
  friend struct CudaModule;
  friend struct CudaGraph;
  friend struct CudaEvent;

  Status launchCluster(Function handle, const LaunchShape &shape,
                       void **parameters);
  Status check(Result result, const char *what) const {
    if (__builtin_expect(result == kSuccess, true))
      return Status::success();
    return failure(result, what);
  }
  Status failure(Result result, const char *what) const;
  /// Another library may have made another context that of this thread.
  Status enter() const {
    Context current = nullptr;
    if (__builtin_expect(
            cu.ctxGetCurrent(&current) == kSuccess && current == context, true))
      return Status::success();
    return check(cu.ctxSetCurrent(context), "a thread cannot use the device");
  }
  Status allocateOnce(int64_t bytes, Address &address);
  /// Kernels of our own; see Rows.cu.
  Status loadRowKernels();
  enum RowKernel { CopyRows, SwapRows, FillRows };
  Status runRows(RowKernel kernel, bool words, int64_t units,
                 std::initializer_list<uint64_t> parameters);

  /// Small copies go through memory that the device reads and writes itself.
  static constexpr int64_t stagingBytes = 256 << 10;
  static constexpr int64_t largestStaged = 32 << 10;

  const Driver &cu;
  DeviceNumber number;
  Context context = nullptr;
  Stream stream = nullptr;
  Pool pool = nullptr;
  std::string label, architecture;
  DeviceLimits most;
  mutable std::mutex mutex;
  std::map<DevicePtr, int64_t> allocations;
  int64_t allocated = 0;

  std::unique_ptr<DeviceModule> rowsModule;
  DeviceFunction *rowFunctions[2][3] = {};

  std::mutex stagingMutex;
  char *staging = nullptr;
  int64_t staged = 0;
};

struct CudaGraph : DeviceGraph {
  explicit CudaGraph(CudaDevice &device) : device(device) {}
  ~CudaGraph() override {
    if (handle && device.enter())
      (void)device.cu.graphExecDestroy(handle);
  }

  CudaDevice &device;
  ExecutableGraph handle = nullptr;
};

struct CudaEvent : DeviceEvent {
  explicit CudaEvent(CudaDevice &device) : device(device) {}
  ~CudaEvent() override {
    if (handle && device.enter())
      (void)device.cu.eventDestroy(handle);
  }

  CudaDevice &device;
  Event handle = nullptr;
};

struct CudaModule : DeviceModule {
  explicit CudaModule(CudaDevice &device) : device(device) {}
  ~CudaModule() override {
    if (handle && device.enter())
      (void)device.cu.moduleUnload(handle);
  }

  CudaDevice &device;
  Module handle = nullptr;
  std::map<std::string, CudaFunction> functions;
};
} // namespace

Status CudaDevice::failure(Result result, const char *what) const {
  return Status::failure(result == kOutOfMemory ? StatusCode::Memory
                                                : StatusCode::Internal,
                         std::string(what) + " (" + cu.describe(result) + ")");
}

//===----------------------------------------------------------------------===//
// Opening and closing
//===----------------------------------------------------------------------===//

static Status noDevice(const std::string &why) {
  std::string message = "no CUDA device: " + why;
  // The usual reason where there is one in the machine.
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
  int resident = 0;
  (void)cu.deviceGetAttribute(&resident, kMaxThreadsPerMultiprocessor, number);
  (void)cu.deviceTotalMem(&bytes, number);
  architecture = "sm_" + std::to_string(10 * major + minor);
  most.multiprocessors = static_cast<unsigned>(multiprocessors);
  most.threadsPerBlock = static_cast<unsigned>(threads);
  most.memoryBytes = static_cast<int64_t>(bytes);
  most.threadsPerMultiprocessor = static_cast<unsigned>(resident);
  int cooperative = 0, clusters = 0;
  (void)cu.deviceGetAttribute(&cooperative, kCooperativeLaunch, number);
  (void)cu.deviceGetAttribute(&clusters, kClusterLaunch, number);
  most.hasGraphs = true;
  most.hasGridBarriers = cooperative != 0;
  // What Hopper has at most; a kernel must ask for more than 8.
  most.mostClusterBlocks = clusters ? 16 : 1;
  if (major < 6)
    return Status::failure(
        StatusCode::Usage,
        label + " has compute capability " + std::to_string(major) + "." +
            std::to_string(minor) + ", and 6.0 or newer is needed");
  status = enter();
  // In order with the default stream, on which others hand over their arrays.
  Result made = status ? cu.streamCreate(&stream, 0) : kSuccess;
  if (status && made != kSuccess && made != kOutOfMemory) {
    // A kernel that failed earlier has taken the context with it: all of its
    // memory is gone, and so is everything that stands on it.
    (void)cu.primaryCtxReset(number);
    made = cu.streamCreate(&stream, 0);
  }
  if (status)
    status = check(made, "no stream can be made");
  // Memory that kernels ask for while they run: what loops record.
  if (status)
    (void)cu.ctxSetLimit(kLimitHeapBytes,
                         std::min<size_t>(bytes / 32, size_t(4) << 30));
  void *memory = nullptr;
  if (status)
    status = check(cu.memAllocHost(&memory, stagingBytes),
                   "no memory for copies can be had");
  staging = static_cast<char *>(memory);
  if (status)
    status = loadRowKernels();
  if (!status || !pools)
    return status;
  PoolProperties properties;
  properties.locationId = number;
  if (cu.memPoolCreate(&pool, &properties) != kSuccess) {
    pool = nullptr;
    return status;
  }
  // What was freed stays in the pool, for the next who asks.
  uint64_t threshold = UINT64_MAX;
  (void)cu.memPoolSetAttribute(pool, kPoolReleaseThreshold, &threshold);
  return status;
}

CudaDevice::~CudaDevice() {
  if (!context)
    return;
  rowsModule.reset();
  // At the end of a process the driver may have gone first.
  if (enter()) {
    if (stream)
      (void)cu.streamSynchronize(stream);
    for (const auto &[address, bytes] : allocations)
      (void)(pool ? cu.memFreeAsync(address, stream) : cu.memFree(address));
    if (staging)
      (void)cu.memFreeHost(staging);
    if (stream) {
      (void)cu.streamSynchronize(stream);
      (void)cu.streamDestroy(stream);
    }
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
    // What the pool holds may be in pieces that are too small.
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

void CudaDevice::free(DevicePtr memory) {
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
  if (bytes > largestStaged) {
    status = check(cu.memcpyHtoDAsync(to, from, size, stream),
                   "a copy to the device fails");
    // Of memory that is pinned, nothing has been read yet.
    return status ? synchronize() : std::move(status);
  }
  std::lock_guard<std::mutex> lock(stagingMutex);
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
  if (bytes > largestStaged) {
    status = check(cu.memcpyDtoHAsync(to, from, size, stream), what);
    return status ? synchronize() : std::move(status);
  }
  std::lock_guard<std::mutex> lock(stagingMutex);
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
  // All copies that were on their way have arrived.
  staged = 0;
  std::memcpy(to, piece, size);
  return status;
}

Status CudaDevice::copy(DevicePtr to, DevicePtr from, int64_t bytes) {
  Status status = enter();
  if (!status || bytes <= 0)
    return status;
  return check(cu.memcpyDtoDAsync(to, from, static_cast<size_t>(bytes), stream),
               "a copy on the device fails");
}

Status CudaDevice::fill(DevicePtr to, const void *pattern, int patternBytes,
                        int64_t count) {
  Status status = enter();
  if (!status || count <= 0)
    return status;
  auto size = static_cast<size_t>(count);
  const char *what = "device memory cannot be filled";
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
  return fillRows({to, 0, 8 * count, 1}, pattern, patternBytes);
}

//===----------------------------------------------------------------------===//
// Rows
//===----------------------------------------------------------------------===//

/// Not when they are first used: that may be while a graph is recorded.
Status CudaDevice::loadRowKernels() {
  DeviceImage image;
  image.bytes.assign(reinterpret_cast<const char *>(cudaRowKernels),
                     cudaRowKernels_size);
  Status status = load(image, rowsModule);
  const char *names[2][3] = {
      {"tai_copy_bytes", "tai_swap_bytes", "tai_fill_bytes"},
      {"tai_copy_words", "tai_swap_words", "tai_fill_words"}};
  for (int w = 0; w < 2; ++w)
    for (int k = 0; k < 3 && status; ++k)
      status = find(*rowsModule, names[w][k], rowFunctions[w][k]);
  return status;
}

Status CudaDevice::runRows(RowKernel kernel, bool words, int64_t units,
                           std::initializer_list<uint64_t> parameters) {
  if (units == 0)
    return Status::success();
  LaunchShape shape;
  shape.threads = 256;
  constexpr int64_t blocksEach = 8;
  shape.blocks = static_cast<unsigned>(
      std::clamp<int64_t>((units + shape.threads - 1) / shape.threads, 1,
                          blocksEach * most.multiprocessors));
  return launch(*rowFunctions[words][kernel], shape, parameters.begin(),
                static_cast<int>(parameters.size()));
}

/// Whether all of these are multiples of a word.
static bool areWords(std::initializer_list<uint64_t> numbers) {
  return std::all_of(numbers.begin(), numbers.end(),
                     [](uint64_t number) { return number % 4 == 0; });
}

Status CudaDevice::copyRows(const DeviceRows &to, DevicePtr from,
                            int64_t fromStep) {
  auto bytes = static_cast<uint64_t>(to.rowBytes);
  auto step = static_cast<uint64_t>(to.step);
  auto otherStep = static_cast<uint64_t>(fromStep);
  bool words = areWords({to.address, step, from, otherStep, bytes});
  uint64_t unit = words ? 4 : 1;
  return runRows(CopyRows, words, static_cast<int64_t>(bytes / unit) * to.rows,
                 {to.address, step / unit, from, otherStep / unit, bytes / unit,
                  static_cast<uint64_t>(to.rows)});
}

Status CudaDevice::swapRows(const DeviceRows &one, DevicePtr other,
                            int64_t otherStep) {
  auto bytes = static_cast<uint64_t>(one.rowBytes);
  auto step = static_cast<uint64_t>(one.step);
  auto stepThere = static_cast<uint64_t>(otherStep);
  bool words = areWords({one.address, step, other, stepThere, bytes});
  uint64_t unit = words ? 4 : 1;
  return runRows(SwapRows, words, static_cast<int64_t>(bytes / unit) * one.rows,
                 {one.address, step / unit, other, stepThere / unit,
                  bytes / unit, static_cast<uint64_t>(one.rows)});
}

Status CudaDevice::fillRows(const DeviceRows &to, const void *pattern,
                            int patternBytes) {
  auto bytes = static_cast<uint64_t>(to.rowBytes);
  auto step = static_cast<uint64_t>(to.step);
  auto size = static_cast<uint64_t>(patternBytes);
  auto outerStep = static_cast<uint64_t>(to.outerStep);
  bool words = areWords({to.address, step, bytes, size, outerStep});
  uint64_t unit = words ? 4 : 1, bits = 0;
  std::memcpy(&bits, pattern, size);
  return runRows(
      FillRows, words, static_cast<int64_t>(bytes / unit) * to.rows * to.outer,
      {to.address, step / unit, bytes / unit, static_cast<uint64_t>(to.rows),
       bits, size / unit, outerStep / unit, static_cast<uint64_t>(to.outer)});
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
// Code
//===----------------------------------------------------------------------===//

Status CudaDevice::load(const DeviceImage &image,
                        std::unique_ptr<DeviceModule> &module) {
  if (image.kind != DeviceKind::Cuda)
    return Status::failure(StatusCode::Internal,
                           "a CUDA device cannot load this code");
  Status status = enter();
  if (!status)
    return status;
  constexpr unsigned logBytes = 16 << 10;
  std::vector<char> info(logBytes), errors(logBytes);
  int options[] = {kJitInfoBuffer, kJitInfoBytes, kJitErrorBuffer,
                   kJitErrorBytes};
  // Sizes are passed in the place of pointers.
  auto size = reinterpret_cast<void *>(uintptr_t(logBytes));
  void *values[] = {info.data(), size, errors.data(), size};
  auto loaded = std::make_unique<CudaModule>(*this);
  Result result = cu.moduleLoadDataEx(&loaded->handle, image.bytes.c_str(), 4,
                                      options, values);
  if (result != kSuccess) {
    loaded->handle = nullptr;
    errors.back() = 0;
    std::string log = errors.data();
    while (!log.empty() && (log.back() == '\n' || log.back() == ' '))
      log.pop_back();
    std::string message = "the CUDA driver does not take the code of a kernel "
                          "for " +
                          architecture + " (" + cu.describe(result) + ")";
    if (result == kUnsupportedPtxVersion)
      message += "; install a newer NVIDIA driver";
    if (!log.empty())
      message += ":\n" + log;
    return Status::failure(StatusCode::Internal, std::move(message));
  }
  module = std::move(loaded);
  return status;
}

Status CudaDevice::find(DeviceModule &module, const std::string &name,
                        DeviceFunction *&function) {
  auto &loaded = static_cast<CudaModule &>(module);
  Status status = enter();
  CudaFunction found;
  int threads = 1;
  if (status)
    status =
        check(cu.moduleGetFunction(&found.handle, loaded.handle, name.c_str()),
              ("device code holds no function '" + name + "'").c_str());
  if (status)
    status =
        check(cu.funcGetAttribute(&threads, kFunctionMaxThreads, found.handle),
              "a device function cannot be examined");
  if (!status)
    return status;
  found.mostThreads = static_cast<unsigned>(std::max(threads, 1));
  CudaFunction &kept = loaded.functions[name];
  kept = found;
  function = &kept;
  return status;
}

unsigned CudaDevice::residentBlocks(const DeviceFunction &function,
                                    unsigned threads) const {
  int blocks = 0;
  if (!enter() ||
      cu.maxActiveBlocks(&blocks,
                         static_cast<const CudaFunction &>(function).handle,
                         static_cast<int>(threads), 0) != kSuccess)
    return 1;
  return most.multiprocessors * static_cast<unsigned>(std::max(blocks, 1));
}

Status CudaDevice::launch(DeviceFunction &function, const LaunchShape &shape,
                          const uint64_t *slots, int count) {
  // All that the driver takes: parameters fill 4096 bytes at most.
  constexpr int mostParameters = 512;
  void *parameters[mostParameters];
  if (__builtin_expect(count > mostParameters, false))
    return Status::failure(StatusCode::Usage,
                           "a loop uses more values than a GPU takes as "
                           "parameters; put some of them into a field");
  for (int i = 0; i < count; ++i)
    parameters[i] = const_cast<uint64_t *>(slots + i);
  Status status = enter();
  if (!status)
    return status;
  Function handle = static_cast<CudaFunction &>(function).handle;
  if (__builtin_expect(shape.cluster > 1, false))
    return launchCluster(handle, shape, parameters);
  Result result =
      shape.cooperative
          ? cu.launchCooperativeKernel(handle, shape.blocks, 1, 1,
                                       shape.threads, 1, 1, shape.sharedBytes,
                                       stream, parameters)
          : cu.launchKernel(handle, shape.blocks, 1, 1, shape.threads, 1, 1,
                            shape.sharedBytes, stream, parameters, nullptr);
  return check(result, "a kernel cannot be launched");
}

Status CudaDevice::launchCluster(Function handle, const LaunchShape &shape,
                                 void **parameters) {
  Status status = check(cu.funcSetAttribute(handle, kFunctionAnyCluster, 1),
                        "a kernel cannot have a cluster of blocks");
  if (!status)
    return status;
  LaunchAttribute cluster{kLaunchCluster};
  cluster.values[0] = shape.cluster;
  cluster.values[1] = cluster.values[2] = 1;
  LaunchConfiguration configuration{{shape.blocks, 1, 1},
                                    {shape.threads, 1, 1},
                                    shape.sharedBytes,
                                    stream,
                                    &cluster,
                                    1};
  return check(cu.launchKernelEx(&configuration, handle, parameters, nullptr),
               "a kernel with a cluster of blocks cannot be launched");
}

//===----------------------------------------------------------------------===//
// Graphs
//===----------------------------------------------------------------------===//

Status CudaDevice::beginCapture() {
  Status status = enter();
  return status ? check(cu.streamBeginCapture(stream, kCaptureThreadLocal),
                        "no graph can be recorded")
                : std::move(status);
}

Status CudaDevice::endCapture(std::unique_ptr<DeviceGraph> &graph) {
  Graph recorded = nullptr;
  Status status = check(cu.streamEndCapture(stream, &recorded),
                        "a graph cannot be recorded");
  if (!status || !recorded)
    return status;
  GraphUpdate update;
  auto *known = static_cast<CudaGraph *>(graph.get());
  if (!known ||
      cu.graphExecUpdate(known->handle, recorded, &update) != kSuccess) {
    auto made = std::make_unique<CudaGraph>(*this);
    status = check(cu.graphInstantiate(&made->handle, recorded, 0),
                   "a graph cannot be made ready to run");
    if (status)
      graph = std::move(made);
  }
  (void)cu.graphDestroy(recorded);
  return status;
}

Status CudaDevice::run(DeviceGraph &graph) {
  Status status = enter();
  return status ? check(cu.graphLaunch(static_cast<CudaGraph &>(graph).handle,
                                       stream),
                        "a graph cannot be launched")
                : std::move(status);
}

//===----------------------------------------------------------------------===//
// Times
//===----------------------------------------------------------------------===//

DeviceFunctionFacts CudaDevice::facts(const DeviceFunction &function) const {
  DeviceFunctionFacts found;
  Function handle = static_cast<const CudaFunction &>(function).handle;
  auto get = [&](int attribute, int &value) {
    if (!enter() || cu.funcGetAttribute(&value, attribute, handle) != kSuccess)
      value = -1;
  };
  get(kFunctionRegisters, found.registers);
  get(kFunctionSharedBytes, found.sharedBytes);
  get(kFunctionLocalBytes, found.localBytes);
  get(kFunctionConstantBytes, found.constantBytes);
  return found;
}

Status CudaDevice::record(std::unique_ptr<DeviceEvent> &event) {
  Status status = enter();
  if (status && !event) {
    auto made = std::make_unique<CudaEvent>(*this);
    status = check(cu.eventCreate(&made->handle, kEventDefault),
                   "no event can be made");
    if (status)
      event = std::move(made);
  }
  return status ? check(cu.eventRecord(static_cast<CudaEvent &>(*event).handle,
                                       stream),
                        "an event cannot be queued")
                : std::move(status);
}

Status CudaDevice::wait(DeviceEvent &event) {
  Status status = enter();
  return status ? check(cu.eventSynchronize(
                            static_cast<CudaEvent &>(event).handle),
                        "a kernel has failed on the device")
                : std::move(status);
}

Status CudaDevice::elapsed(const DeviceEvent &from, const DeviceEvent &to,
                           int64_t &ns) {
  float ms = 0;
  Status status = enter();
  if (status)
    status = check(
        cu.eventElapsedTime(&ms, static_cast<const CudaEvent &>(from).handle,
                            static_cast<const CudaEvent &>(to).handle),
        "the time of a kernel cannot be read");
  ns = static_cast<int64_t>(double(ms) * 1e6);
  return status;
}

Status CudaDevice::synchronize() {
  Status status = enter();
  if (!status)
    return status;
  return check(cu.streamSynchronize(stream),
               "a kernel has failed on the device");
}
