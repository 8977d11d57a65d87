//===- RepeatedLaunch.cpp - Repeated launches as graphs -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "RepeatedLaunch.h"
#include <algorithm>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::cuda;

/// The number of graphs that all RepeatedLaunch objects hold.
static std::atomic<int> numGraphs{0};

void RepeatedLaunch::release() {
  if (executable) {
    // The driver frees the graph when the launches queued with it have run.
    (void)cu.graphExecDestroy(executable);
    --numGraphs;
  }
  if (graph)
    (void)cu.graphDestroy(graph);
  executable = nullptr;
  graph = nullptr;
}

/// Makes the graph of this launch, or changes the parameters of the present
/// graph; false if the driver refuses.
bool RepeatedLaunch::update(const KernelNodeParameters &kernel,
                            const LaunchShape &shape, const uint64_t *slots,
                            int count) {
  auto size = static_cast<size_t>(count);
  if (executable && blocks == shape.blocks && threads == shape.threads &&
      sharedBytes == shape.sharedBytes && values.size() == size &&
      std::equal(slots, slots + size, values.begin()))
    return true;
  if (executable) {
    if (cu.graphExecKernelNodeSetParams(executable, node, &kernel) != kSuccess)
      return false;
  } else {
    if (++numGraphs > mostGraphs || cu.graphCreate(&graph, 0) != kSuccess ||
        cu.graphAddKernelNode(&node, graph, nullptr, 0, &kernel) != kSuccess ||
        cu.graphInstantiate(&executable, graph, 0) != kSuccess) {
      executable = nullptr;
      --numGraphs;
      return false;
    }
  }
  blocks = shape.blocks;
  threads = shape.threads;
  sharedBytes = shape.sharedBytes;
  values.assign(slots, slots + size);
  return true;
}

bool RepeatedLaunch::queue(Function function, Stream stream,
                           const LaunchShape &shape, const uint64_t *slots,
                           int count, void **parameters) {
  if (busy.test_and_set(std::memory_order_acquire))
    return false;
  bool isQueued = false;
  if (!isRefused && (executable || ++seen > launchesBefore)) {
    KernelNodeParameters kernel = nodeOf(function, shape, parameters);
    if (update(kernel, shape, slots, count)) {
      isQueued = cu.graphLaunch(executable, stream) == kSuccess;
    } else {
      release();
      isRefused = true;
    }
  }
  busy.clear(std::memory_order_release);
  return isQueued;
}
