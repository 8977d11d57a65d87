//===- CudaWork.cpp - Code, launches, graphs and events of a GPU ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "CudaDevice.h"
#include "tai/Runtime/Threads/PollPause.h"
#include "tai/Runtime/Threads/Safepoint.h"
#include <algorithm>
#include <chrono>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::cuda;

//===----------------------------------------------------------------------===//
// Code
//===----------------------------------------------------------------------===//

namespace {
/// Keeps the primary context of a device alive, and makes it current for the
/// calling thread within a scope.
class ContextShare {
public:
  ContextShare(const Driver &cu, int number) : cu(cu), number(number) {
    if (cu.primaryCtxRetain(&context, number) != kSuccess)
      context = nullptr;
  }
  ~ContextShare() {
    if (context)
      (void)cu.primaryCtxRelease(number);
  }
  ContextShare(const ContextShare &) = delete;
  ContextShare &operator=(const ContextShare &) = delete;

  /// Runs `work` with the device's context current; returns false if the
  /// context cannot be used.
  template <typename Work> bool within(const Work &work) const {
    Context before = nullptr;
    if (!context || cu.ctxGetCurrent(&before) != kSuccess ||
        cu.ctxSetCurrent(context) != kSuccess)
      return false;
    work();
    (void)cu.ctxSetCurrent(before);
    return true;
  }

  const Driver &cu;

private:
  int number;
  Context context = nullptr;
};
} // namespace

/// Assembles PTX with the driver's linker. In contrast to a module load, it
/// does not block the launches of other threads.
static void assemble(const Driver &cu, DeviceImage &image) {
  LinkState state = nullptr;
  if (cu.linkCreate(0, nullptr, nullptr, &state) != kSuccess)
    return;
  void *code = nullptr;
  size_t bytes = 0;
  // The driver reads a PTX text up to its terminating zero.
  if (cu.linkAddData(state, kJitInputPtx, image.bytes.data(),
                     image.bytes.size() + 1, "tai", 0, nullptr,
                     nullptr) == kSuccess &&
      cu.linkComplete(state, &code, &bytes) == kSuccess)
    image.machineCode.assign(static_cast<const char *>(code), bytes);
  (void)cu.linkDestroy(state);
}

DeviceAssembler CudaDevice::assembler() const {
  auto share = std::make_shared<ContextShare>(cu, number);
  return [share](DeviceImage &image) {
    if (image.kind == DeviceKind::Cuda && image.machineCode.empty())
      (void)share->within([&] { assemble(share->cu, image); });
  };
}

Status CudaDevice::load(const DeviceImage &image,
                        std::unique_ptr<DeviceModule> &module) {
  if (image.kind != DeviceKind::Cuda)
    return Status::failure(StatusCode::Internal,
                           "a CUDA device cannot load this code");
  Status status = enter();
  if (!status)
    return status;
  if (!image.machineCode.empty()) {
    auto loaded = std::make_unique<CudaModule>(*this);
    if (cu.moduleLoadDataEx(&loaded->handle, image.machineCode.data(), 0,
                            nullptr, nullptr) == kSuccess) {
      module = std::move(loaded);
      return status;
    }
    // Cached machine code may be for another driver, so it is tried first; the
    // PTX, which is loaded below, runs on all drivers.
    loaded->handle = nullptr;
  }
  constexpr unsigned logBytes = 16 << 10;
  std::vector<char> info(logBytes), errors(logBytes);
  int options[] = {kJitInfoBuffer, kJitInfoBytes, kJitErrorBuffer,
                   kJitErrorBytes};
  // Sizes are passed in the place of pointers.
  auto *size = reinterpret_cast<void *>(uintptr_t(logBytes));
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
  found.repeated = std::make_unique<RepeatedLaunch>(cu);
  CudaFunction &kept = loaded.functions[name];
  kept = std::move(found);
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
  // The maximum number of parameters of a launch: the driver takes 4096 bytes
  // of them.
  constexpr int mostParameters = 512;
  void *parameters[mostParameters];
  if (__builtin_expect(count > mostParameters, false))
    return Status::failure(StatusCode::Usage,
                           "a loop uses more values than a GPU takes as "
                           "parameters; put some of them into a field");
  for (int i = 0; i < count; ++i)
    parameters[i] = const_cast<uint64_t *>(slots + i);
  auto &called = static_cast<CudaFunction &>(function);
  Function handle = called.handle;
  if (__builtin_expect(shape.cluster > 1 || shape.overlaps, false)) {
    Status status = enter();
    if (!status)
      return status;
    return shape.cluster > 1 ? launchCluster(handle, shape, parameters)
                             : launchOverlapped(handle, shape, parameters);
  }
  isAfterKernel = true;
  // For a thread without a CUDA context, the driver rejects a kernel, but
  // crashes on a graph, so graphs need a check.
  if (Status status = enterOnce(); !status)
    return status;
  if (!capture.isOpen && !shape.cooperative &&
      called.repeated->queue(handle, stream, shape, slots, count, parameters))
    return Status::success();
  unsigned threads = shape.threads;
  auto launchOnce = [&] {
    return shape.cooperative
               ? cu.launchCooperativeKernel(handle, shape.blocks, 1, 1, threads,
                                            1, 1, shape.sharedBytes, stream,
                                            parameters)
               : cu.launchKernel(handle, shape.blocks, 1, 1, threads, 1, 1,
                                 shape.sharedBytes, stream, parameters,
                                 nullptr);
  };
  // If another library has set another context meanwhile, the driver rejects
  // the launch, so that launches need not query the context first.
  Result result = launchOnce();
  if (__builtin_expect(result != kSuccess, false) && !isCurrent()) {
    Status status = enter();
    if (!status)
      return status;
    result = launchOnce();
  }
  // The limits of a function do not count resources that tools and other
  // contexts take, so the blocks are shrunk until the driver accepts them.
  constexpr unsigned warp = 32;
  while (__builtin_expect(result == kLaunchOutOfResources, false) &&
         shape.canShrink && threads > warp) {
    threads = std::max(threads / 2 / warp * warp, warp);
    result = launchOnce();
  }
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

/// Launches a kernel that can be made ready while the previous kernel runs.
/// After work other than a kernel, the launch waits for the end of that work.
Status CudaDevice::launchOverlapped(Function handle, const LaunchShape &shape,
                                    void **parameters) {
  LaunchAttribute early{kLaunchOverlapped};
  early.values[0] = 1;
  LaunchConfiguration configuration{{shape.blocks, 1, 1},
                                    {shape.threads, 1, 1},
                                    shape.sharedBytes,
                                    stream,
                                    &early,
                                    isAfterKernel ? 1u : 0u};
  isAfterKernel = true;
  return check(cu.launchKernelEx(&configuration, handle, parameters, nullptr),
               "a kernel cannot be launched while another one runs");
}

//===----------------------------------------------------------------------===//
// Graphs
//===----------------------------------------------------------------------===//

Status CudaDevice::beginCapture(size_t changeable, bool overlaps) {
  Status status = enter();
  capture.overlaps = overlaps && most.hasOverlaps;
  isAfterKernel = false;
  numChangeable = changeable;
  if (status)
    status = check(cu.streamBeginCapture(stream, kCaptureThreadLocal),
                   "no graph can be recorded");
  capture.isOpen = bool(status);
  return status;
}

Status CudaDevice::endCapture(std::unique_ptr<DeviceGraph> &graph) {
  Graph recorded = nullptr;
  // The driver refuses to end a recording while work of the second stream has
  // not been joined to the first.
  (void)joinAside();
  capture.isOpen = false;
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
    if (status && numChangeable > 0) {
      made->recorded = recorded;
      made->findNodes(numChangeable);
      recorded = nullptr;
    }
    if (status)
      graph = std::move(made);
  }
  if (recorded)
    (void)cu.graphDestroy(recorded);
  return status;
}

void CudaGraph::findNodes(size_t count) {
  const Driver &cu = device.cu;
  Node node = nullptr;
  size_t found = 1;
  int kind = 0;
  // A stream that was captured gives a chain of graph nodes: one root, and one
  // dependent node for each node.
  if (cu.graphGetRootNodes(recorded, nullptr, &found) != kSuccess ||
      found != 1 || cu.graphGetRootNodes(recorded, &node, &found) != kSuccess)
    return;
  while (cu.graphNodeGetType(node, &kind) == kSuccess && kind == kNodeKernel) {
    nodes.push_back(node);
    if (nodes.size() == count ||
        cu.graphNodeGetDependentNodes(node, nullptr, &found) != kSuccess ||
        found != 1 ||
        cu.graphNodeGetDependentNodes(node, &node, &found) != kSuccess)
      return;
  }
}

Status CudaDevice::change(DeviceGraph &graph, size_t number,
                          DeviceFunction &function, const LaunchShape &shape,
                          const uint64_t *slots, int count) {
  auto &made = static_cast<CudaGraph &>(graph);
  if (number >= made.nodes.size())
    return Status::failure(StatusCode::Internal,
                           "this launch of a graph cannot be changed");
  std::vector<void *> parameters(static_cast<size_t>(count));
  for (size_t i = 0; i < parameters.size(); ++i)
    parameters[i] = const_cast<uint64_t *>(slots + i);
  KernelNodeParameters node = nodeOf(
      static_cast<CudaFunction &>(function).handle, shape, parameters.data());
  Status status = enter();
  return status ? check(cu.graphExecKernelNodeSetParams(
                            made.handle, made.nodes[number], &node),
                        "a launch of a graph cannot be changed")
                : std::move(status);
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

void CudaDevice::setStopWord(DevicePtr word) {
  std::lock_guard<std::mutex> lock(stopMutex);
  stopWord = 0;
  if (!enter() ||
      (!stopStream &&
       cu.streamCreate(&stopStream, kStreamNonBlocking) != kSuccess))
    return;
  void *memory = nullptr;
  if (!stopSource &&
      cu.memAllocHost(&memory, 2 * sizeof(*stopSource)) == kSuccess)
    stopSource = static_cast<uint32_t *>(memory);
  if (stopSource)
    stopWord = word;
}

template <typename Query> void CudaDevice::stopLoops(const Query &query) {
  std::lock_guard<std::mutex> lock(stopMutex);
  if (!stopWord)
    return;
  // Zero and the thread's number have separate places, since an earlier copy
  // may still read one of them. The number is copied on a stream of its own, so
  // that it overtakes the kernels.
  stopSource[0] = 0;
  stopSource[1] = safepoint::threadNumber();
  if (cu.memcpyHtoDAsync(stopWord, &stopSource[1], sizeof(uint32_t),
                         stopStream) != kSuccess)
    return;
  // Kernels that are queued from now on must not stop: zero is queued before
  // them, and after all kernels that must stop. The copy of zero may be seconds
  // late on a GPU that other processes use, too.
  (void)cu.memcpyHtoDAsync(stopWord, &stopSource[0], sizeof(uint32_t), stream);
  // Kernels that see the stop word end soon. Other work need not end in this
  // time.
  constexpr std::chrono::milliseconds patience(500);
  auto end = std::chrono::steady_clock::now() + patience;
  PollPause pause;
  while (query() == kNotReady && std::chrono::steady_clock::now() < end)
    pause();
}

/// Waits for the device. An interrupted wait ends kernels that poll the stop
/// word. Other work stays in the queue, and the next wait waits for it.
template <typename Query>
Status CudaDevice::waitUntilReady(const Query &query, Result &result) {
  safepoint::Watch watch;
  PollPause pause;
  bool hasStopped = false;
  while ((result = query()) == kNotReady) {
    bool goesOn = watch.look();
    if (!goesOn || (safepoint::Unstoppable::wasAsked() && !hasStopped)) {
      hasStopped = true;
      stopLoops(query);
    }
    if (!goesOn)
      return failAsInterrupted();
    pause();
  }
  return Status::success();
}

Status CudaDevice::wait(DeviceEvent &event) {
  Status status = enter();
  Result result = kSuccess;
  if (status)
    status = waitUntilReady(
        [&] { return cu.eventQuery(static_cast<CudaEvent &>(event).handle); },
        result);
  return status ? check(result, "a kernel has failed on the device")
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
  Result result = kSuccess;
  status = waitUntilReady([&] { return cu.streamQuery(stream); }, result);
  return status ? check(result, "a kernel has failed on the device")
                : std::move(status);
}

//===----------------------------------------------------------------------===//
// The order of the device's stream and streams of other libraries
//===----------------------------------------------------------------------===//

// A launch that takes tensors of another library comes after the work that the
// library has queued, and before the library's later work. Every such launch
// orders the streams again, which takes two calls of the driver each way, and
// none for the default stream.

/// The device's own stream is a blocking stream: the driver itself keeps it in
/// order with the default stream.
static bool isDefault(uint64_t stream) {
  return stream == 0 || stream == kLegacyStream;
}

Status CudaDevice::waitForStream(uint64_t other) {
  // The next kernel must not start early by programmatic dependent launch,
  // before the work of the other stream.
  isAfterKernel = false;
  return isDefault(other) ? Status::success()
                          : order(reinterpret_cast<Stream>(other), stream);
}

Status CudaDevice::letStreamWait(uint64_t other) {
  return isDefault(other) ? Status::success()
                          : order(stream, reinterpret_cast<Stream>(other));
}

Status CudaDevice::order(Stream first, Stream second) {
  Status status = enter();
  if (!status)
    return status;
  // A wait refers to the last record of the event before the wait was queued,
  // so the event can be recorded again at once.
  std::lock_guard<std::mutex> lock(orderMutex);
  if (!orderEvent)
    status = check(cu.eventCreate(&orderEvent, kEventNoTiming),
                   "no event can be made");
  if (status)
    status = check(cu.eventRecord(orderEvent, first),
                   "the stream of another library cannot be used");
  if (status)
    status = check(cu.streamWaitEvent(second, orderEvent, 0),
                   "the stream of another library cannot be used");
  return status;
}

//===----------------------------------------------------------------------===//
// Beside other work
//===----------------------------------------------------------------------===//

/// Runs fills in a branch of the graph: a second stream records them while
/// `stream` is recorded.
Status CudaDevice::fillAside(const std::vector<DeviceFill> &fills) {
  if (!side || !capture.isOpen || branch != Branch::None)
    return fillAll(fills);
  Status status = order(stream, side);
  if (!status)
    return status;
  bool wasAfterKernel = isAfterKernel, overlapped = capture.overlaps;
  branch = Branch::Capturing;
  capture.overlaps = false;
  std::swap(stream, side);
  status = fillAll(fills);
  std::swap(stream, side);
  capture.overlaps = overlapped;
  isAfterKernel = wasAfterKernel;
  branch = Branch::Captured;
  return status;
}

/// Later work depends on two branches rather than on one kernel, so the next
/// kernel does not start early by programmatic dependent launch.
Status CudaDevice::joinAside() {
  if (branch == Branch::None)
    return Status::success();
  branch = Branch::None;
  isAfterKernel = false;
  return order(side, stream);
}
