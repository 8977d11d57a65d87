//===- KnownKernels.h - Kernels that a tape has adopted ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The kernels of a tape's recent launches, with the tape's data about each. A
// launch under the tape looks its kernel up here before it searches. Holds
// kernels only that were adopted while no other tape recorded. The recording
// keeps the kernels alive.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_RECORD_KNOWNKERNELS_H
#define TAI_LIB_RUNTIME_TAPE_RECORD_KNOWNKERNELS_H

#include "tai/Runtime/Launch/Kernel.h"
#include <array>

namespace mlir::tai::runtime {

class KnownKernels {
public:
  void add(const Kernel &kernel, const void *uses) {
    recentOf(kernel) = {&kernel, uses};
  }
  /// The data of the last add() for the kernel; null if there was none, or
  /// another kernel has taken its place since.
  const void *find(const Kernel &kernel) {
    const Entry &recent = recentOf(kernel);
    return __builtin_expect(recent.kernel == &kernel, true) ? recent.uses
                                                            : nullptr;
  }

private:
  struct Entry {
    const Kernel *kernel = nullptr;
    const void *uses = nullptr;
  };
  Entry &recentOf(const Kernel &kernel) {
    auto address = reinterpret_cast<uintptr_t>(&kernel) / alignof(Kernel);
    return recents[(address ^ (address >> 6)) % recents.size()];
  }

  std::array<Entry, 64> recents;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_RECORD_KNOWNKERNELS_H
