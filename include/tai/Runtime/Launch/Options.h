//===- Options.h - Options of a runtime -------------------------*- C++ -*-===//
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

/// Instruments that watch launches without a change of their results.
struct Instruments {
  /// A launch on a device waits for its end, and reports the failures of its
  /// kernel itself.
  bool debug = false;
  bool profiler = false;
  /// Kernels run with shadow values; see ShadowLog.h.
  bool shadow = false;
};

struct Options {
  /// Worker threads; 0 = as many as the process may use.
  int threads = 0;
  /// Whether a device may time several sizes of blocks, which changes the bits
  /// of sums.
  bool triesBlocks = true;
  Instruments instruments;
  uint64_t seed = 0;
  /// Maximum of bytes for trees and scratch memory; 0 = the memory of the
  /// machine (or of its control group).
  int64_t memoryLimit = 0;
  /// The skips that are on; see Skips.def.
  SkipSet skips;
  /// Threads in a block on a device; 0 = chosen for each kernel.
  int blockThreads = 0;
  /// The maximum of threads in a block; 0 = the limit of the device.
  int mostBlockThreads = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_OPTIONS_H
