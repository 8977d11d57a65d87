//===- Device.h - time kernels, graphs and barriers ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The side of the floors that needs CUDA: checked calls, memory, capture of
// launches into a graph, times by events, and the barrier over a whole grid.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_BENCHMARKS_FLOOR_CUDA_DEVICE_H
#define TAI_BENCHMARKS_FLOOR_CUDA_DEVICE_H

#include "Common.h"
#include <algorithm>
#include <cuda_runtime.h>

namespace tai::floor {

inline void check(cudaError_t status, const char *what) {
  if (status == cudaSuccess)
    return;
  std::fprintf(stderr, "%s: %s\n", what, cudaGetErrorString(status));
  std::exit(1);
}

#define TAI_CHECK(call) ::tai::floor::check((call), #call)

/// Memory of the device, zero at first.
template <typename T> class Buffer {
public:
  explicit Buffer(size_t count) : count_(count) {
    TAI_CHECK(cudaMalloc(&memory_, bytes()));
    clear();
  }
  explicit Buffer(const std::vector<T> &values) : Buffer(values.size()) {
    set(values);
  }
  Buffer(const Buffer &) = delete;
  Buffer &operator=(const Buffer &) = delete;
  ~Buffer() { cudaFree(memory_); }

  T *get() const { return memory_; }
  size_t bytes() const { return count_ * sizeof(T); }
  void clear() { TAI_CHECK(cudaMemset(memory_, 0, bytes())); }
  void clear(cudaStream_t stream) {
    TAI_CHECK(cudaMemsetAsync(memory_, 0, bytes(), stream));
  }
  void set(const std::vector<T> &values) {
    TAI_CHECK(cudaMemcpy(memory_, values.data(), values.size() * sizeof(T),
                         cudaMemcpyHostToDevice));
  }
  std::vector<T> values(size_t first, size_t count) const {
    std::vector<T> result(count);
    TAI_CHECK(cudaMemcpy(result.data(), memory_ + first, count * sizeof(T),
                         cudaMemcpyDeviceToHost));
    return result;
  }

private:
  T *memory_ = nullptr;
  size_t count_;
};

/// The work that a function queues on a stream, kept as a graph.
class Graph {
public:
  template <typename Queue> Graph(cudaStream_t stream, const Queue &queue) {
    cudaGraph_t graph;
    TAI_CHECK(cudaStreamBeginCapture(stream, cudaStreamCaptureModeGlobal));
    queue();
    TAI_CHECK(cudaStreamEndCapture(stream, &graph));
    TAI_CHECK(cudaGraphInstantiate(&executable_, graph, 0));
    TAI_CHECK(cudaGraphDestroy(graph));
    TAI_CHECK(cudaGraphUpload(executable_, stream));
  }
  Graph(const Graph &) = delete;
  Graph &operator=(const Graph &) = delete;
  ~Graph() { cudaGraphExecDestroy(executable_); }
  void launch(cudaStream_t stream) const {
    TAI_CHECK(cudaGraphLaunch(executable_, stream));
  }

private:
  cudaGraphExec_t executable_ = nullptr;
};

/// Milliseconds per unit of `queue`, by events around each of `runs` runs.
template <typename Queue>
Times measure(cudaStream_t stream, int runs, double units, const Queue &queue) {
  for (int warmUp = 0; warmUp < 3; ++warmUp)
    queue();
  TAI_CHECK(cudaStreamSynchronize(stream));
  std::vector<cudaEvent_t> events(2 * size_t(runs));
  for (cudaEvent_t &event : events)
    TAI_CHECK(cudaEventCreate(&event));
  for (int run = 0; run < runs; ++run) {
    TAI_CHECK(cudaEventRecord(events[2 * size_t(run)], stream));
    queue();
    TAI_CHECK(cudaEventRecord(events[2 * size_t(run) + 1], stream));
  }
  TAI_CHECK(cudaGetLastError());
  TAI_CHECK(cudaStreamSynchronize(stream));
  std::vector<double> times;
  for (int run = 0; run < runs; ++run) {
    float ms = 0;
    TAI_CHECK(cudaEventElapsedTime(&ms, events[2 * size_t(run)],
                                   events[2 * size_t(run) + 1]));
    times.push_back(double(ms) / units);
  }
  for (cudaEvent_t event : events)
    TAI_CHECK(cudaEventDestroy(event));
  std::sort(times.begin(), times.end());
  auto quantile = [&](double q) {
    return times[size_t(q * double(times.size() - 1) + 0.5)];
  };
  return {quantile(0.5), quantile(0.1), quantile(0.9), runs};
}

/// Begins kernels that may be launched before the one before them has ended:
/// lets the next be launched, and waits for the end of the one before.
__device__ __forceinline__ void followPrevious() {
  cudaTriggerProgrammaticLaunchCompletion();
  cudaGridDependencySynchronize();
}

/// Launches a sequence of kernels that begin with `followPrevious`, either each
/// after the end of the one before or, `overlapped`, so that a launch is under
/// way while the kernel before it runs.
class Launcher {
public:
  Launcher(cudaStream_t stream, bool overlapped)
      : stream_(stream), overlapped_(overlapped) {}

  template <typename... Parameters, typename... Arguments>
  void operator()(void (*kernel)(Parameters...), int blocks, int threads,
                  Arguments... arguments) {
    cudaLaunchAttribute attribute;
    attribute.id = cudaLaunchAttributeProgrammaticStreamSerialization;
    attribute.val.programmaticStreamSerializationAllowed = 1;
    cudaLaunchConfig_t config = {};
    config.gridDim = dim3(unsigned(blocks));
    config.blockDim = dim3(unsigned(threads));
    config.stream = stream_;
    config.attrs = &attribute;
    // The first comes after something that is no kernel.
    config.numAttrs = overlapped_ && !first_ ? 1 : 0;
    first_ = false;
    TAI_CHECK(cudaLaunchKernelEx(&config, kernel, Parameters(arguments)...));
  }

private:
  cudaStream_t stream_;
  bool overlapped_, first_ = true;
};

/// Launches a kernel all of whose blocks run at the same time.
template <typename... Parameters, typename... Arguments>
void launchTogether(cudaStream_t stream, void (*kernel)(Parameters...),
                    int blocks, int threads, size_t sharedBytes,
                    Arguments... arguments) {
  cudaLaunchAttribute attribute;
  attribute.id = cudaLaunchAttributeCooperative;
  attribute.val.cooperative = 1;
  cudaLaunchConfig_t config = {};
  config.gridDim = dim3(unsigned(blocks));
  config.blockDim = dim3(unsigned(threads));
  config.dynamicSmemBytes = sharedBytes;
  config.stream = stream;
  config.attrs = &attribute;
  config.numAttrs = 1;
  TAI_CHECK(cudaLaunchKernelEx(&config, kernel, Parameters(arguments)...));
}

/// A barrier over the grid on one counter, which is 0 before the launch. Blocks
/// count up for ever, so that nothing has to be reset between barriers.
class GridBarrier {
public:
  __device__ explicit GridBarrier(unsigned *counter) : counter_(counter) {}

  __device__ void wait() {
    __syncthreads();
    if (threadIdx.x == 0) {
      target_ += gridDim.x;
      asm volatile("red.release.gpu.global.add.u32 [%0], 1;" ::"l"(counter_)
                   : "memory");
      unsigned seen;
      do {
        asm volatile("ld.acquire.gpu.global.u32 %0, [%1];"
                     : "=r"(seen)
                     : "l"(counter_)
                     : "memory");
      } while (seen < target_);
    }
    __syncthreads();
  }

private:
  unsigned *counter_;
  unsigned target_ = 0;
};

} // namespace tai::floor

#endif // TAI_BENCHMARKS_FLOOR_CUDA_DEVICE_H
