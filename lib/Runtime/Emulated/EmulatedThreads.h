//===- EmulatedThreads.h - Blocks of several threads on the CPU -*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Runs the threads of a block of the emulated device, each on a stack of its
// own, one after another up to the next barrier. Each launch and each barrier
// has another order, so that a barrier which is missing shows.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_EMULATED_EMULATEDTHREADS_H
#define TAI_LIB_RUNTIME_EMULATED_EMULATEDTHREADS_H

#include <cstdint>
#include <functional>
#include <memory>

namespace mlir::tai::runtime {

constexpr unsigned kEmulatedWarp = 32;

/// Threads per block, as TAI_EMULATED_THREADS says, in whole warps; 1 without
/// it.
unsigned emulatedThreads();

/// Calls body() as each of `threads` threads of a block. Returns false if some
/// wait for others that never come.
bool runEmulatedBlock(unsigned threads, uint64_t order,
                      const std::function<void()> &body);

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_EMULATED_EMULATEDTHREADS_H
