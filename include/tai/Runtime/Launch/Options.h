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
  /// True in debug mode, in which each launch on a device waits for its end and
  /// reports the failures of its kernel itself.
  bool debug = false;
  bool profiler = false;
  /// True if kernels also compute shadow values of floats, in twice the
  /// precision; see ShadowLog.h.
  bool shadow = false;
};

struct Options {
  /// The number of worker threads; 0 means as many as the process may use.
  int threads = 0;
  /// True if the runtime may time several block sizes on a device, which
  /// changes the bits of sums.
  bool triesBlocks = true;
  Instruments instruments;
  uint64_t seed = 0;
  /// The most bytes for trees and scratch memory; 0 means the memory of the
  /// machine (or of its control group).
  int64_t memoryLimit = 0;
  /// The skips that are on; see Skips.def.
  SkipSet skips;
  /// The number of threads in a block of a GPU launch; 0 means that the runtime
  /// chooses the number for each kernel.
  int blockThreads = 0;
  /// Upper limit of the threads in a block of a GPU launch; 0 means the
  /// device's own limit.
  int mostBlockThreads = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_OPTIONS_H
