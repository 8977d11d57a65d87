//===- KnownKernels.h - Kernels that a tape has adopted ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The kernels that a tape has adopted while no other tape recorded, with the
// tape's data about each. A launch under the tape looks its kernel up here, so
// the kernels of recent launches are found without a search. The recording
// keeps the kernels alive.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_RECORD_KNOWNKERNELS_H
#define TAI_LIB_RUNTIME_TAPE_RECORD_KNOWNKERNELS_H

#include "tai/Runtime/Launch/Kernel.h"
#include <array>
#include <unordered_map>

namespace mlir::tai::runtime {

class KnownKernels {
public:
  void add(const Kernel &kernel, const void *uses) {
    adopted[&kernel] = uses;
    recentOf(kernel) = {&kernel, uses};
  }
  /// The data of the last add() for the kernel; null if there was none.
  const void *find(const Kernel &kernel) {
    Entry &recent = recentOf(kernel);
    if (__builtin_expect(recent.kernel == &kernel, true))
      return recent.uses;
    auto found = adopted.find(&kernel);
    if (found == adopted.end())
      return nullptr;
    recent = {&kernel, found->second};
    return found->second;
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
  std::unordered_map<const Kernel *, const void *> adopted;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_RECORD_KNOWNKERNELS_H
