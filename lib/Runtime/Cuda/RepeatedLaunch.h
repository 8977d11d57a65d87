//===- RepeatedLaunch.h - Repeated launches as graphs -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The driver takes less time to update and queue a graph of one kernel than to
// queue the kernel: 1.2 to 1.5 microseconds rather than 3.2 to 3.5, on the host
// of an H200 with driver 580, from C++ alone.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_CUDA_REPEATEDLAUNCH_H
#define TAI_LIB_RUNTIME_CUDA_REPEATEDLAUNCH_H

#include "Driver.h"
#include "tai/Runtime/Device/Device.h"
#include <atomic>
#include <vector>

namespace mlir::tai::runtime::cuda {

/// Returns the parameters of the graph node that makes this launch.
inline KernelNodeParameters nodeOf(Function function, const LaunchShape &shape,
                                   void **parameters) {
  return {function,          {shape.blocks, 1, 1}, {shape.threads, 1, 1},
          shape.sharedBytes, parameters,           nullptr};
}

/// Queues repeated launches of one function of a module as updates of a graph.
class RepeatedLaunch {
public:
  explicit RepeatedLaunch(const Driver &driver) : cu(driver) {}
  /// Frees the graph. The context of the device must be current.
  ~RepeatedLaunch() { release(); }
  RepeatedLaunch(const RepeatedLaunch &) = delete;
  RepeatedLaunch &operator=(const RepeatedLaunch &) = delete;

  /// Queues a launch as a graph. False if the caller must queue it directly: it
  /// has not been repeated often enough, another thread is using the graph, or
  /// the driver rejects it.
  bool queue(Function function, Stream stream, const LaunchShape &shape,
             const uint64_t *slots, int count, void **parameters);

private:
  bool update(const KernelNodeParameters &kernel, const LaunchShape &shape,
              const uint64_t *slots, int count);
  void release();

  /// A graph takes memory of the device: a function gets a graph after
  /// `launchesBefore` launches, if the process has fewer than `mostGraphs`.
  static constexpr unsigned launchesBefore = 32;
  static constexpr int mostGraphs = 256;

  const Driver &cu;
  std::atomic_flag busy = ATOMIC_FLAG_INIT;
  unsigned seen = 0;
  bool isRefused = false;
  Graph graph = nullptr;
  Node node = nullptr;
  ExecutableGraph executable = nullptr;
  /// The shape of the launch that the graph holds.
  unsigned blocks = 0, threads = 0, sharedBytes = 0;
  std::vector<uint64_t> values;
};

} // namespace mlir::tai::runtime::cuda

#endif // TAI_LIB_RUNTIME_CUDA_REPEATEDLAUNCH_H
