//===- Options.h - What a runtime is made with ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_OPTIONS_H
#define TAI_RUNTIME_LAUNCH_OPTIONS_H

#include "tai/Support/Skips.h"
#include <cstdint>

namespace mlir::tai::runtime {

struct Options {
  /// 0 = as many as the process may use.
  int threads = 0;
  /// Partitions of reductions do not depend on the number of threads.
  bool deterministic = false;
  /// Recorded for those who ask; the runtime itself checks always.
  bool debug = false;
  bool profiler = false;
  /// Kernels carry shadows of floats along; see ShadowLog.h.
  bool shadow = false;
  uint64_t seed = 0;
  /// Most bytes of trees and scratch; 0 = the memory of the machine (or of its
  /// control group).
  int64_t memoryLimit = 0;
  /// What is left out where it is not needed.
  SkipSet skips;
  /// Threads of a block on a device; 0 = what suits the kernel.
  int blockThreads = 0;
  /// The most of them, whatever is asked for; 0 for no limit but the device's.
  int mostBlockThreads = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_OPTIONS_H
