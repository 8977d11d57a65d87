//===- EmulatedThreads.h - Blocks of several threads on the CPU -*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Runs the threads of a block of the emulated device as coroutines, each with
// its own stack, one after another up to the next barrier. The order changes
// with each launch and each barrier, so that missing barriers show up in tests.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_EMULATED_EMULATEDTHREADS_H
#define TAI_LIB_RUNTIME_EMULATED_EMULATEDTHREADS_H

#include <cstdint>
#include <functional>
#include <memory>

namespace mlir::tai::runtime {

constexpr unsigned kEmulatedWarp = 32;

/// The block size of the emulated device, from the environment variable
/// TAI_EMULATED_THREADS, in whole warps; 1 if not set.
unsigned emulatedThreads();

/// Calls body() as each of `threads` emulated threads of a block. Returns false
/// on a deadlock: threads wait at a barrier that other threads never reach.
bool runEmulatedBlock(unsigned threads, uint64_t order,
                      const std::function<void()> &body);

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_EMULATED_EMULATEDTHREADS_H
