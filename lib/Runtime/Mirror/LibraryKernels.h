//===- LibraryKernels.h - Kernels of the device library ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Functions of the device library that the runtime itself launches (see
// tai/Runtime/DeviceSparse.h). They are launched like those of any kernel, and
// become part of graphs and programs like them.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_MIRROR_LIBRARYKERNELS_H
#define TAI_LIB_RUNTIME_MIRROR_LIBRARYKERNELS_H

#include "tai/Runtime/Queue/DeviceQueue.h"
#include <initializer_list>
#include <mutex>

namespace mlir::tai::runtime {

enum class LibraryKernel : unsigned {
  ListCells,
  ListCount,
  ListScan,
  ListWrite,
  DeactivateList,
  MoveCells,
  KeepActivity
};

class LibraryKernels {
public:
  explicit LibraryKernels(DeviceQueue &queue) : queue(queue) {}

  /// Makes them at the first call. False where nobody is there to make them.
  Status load(bool &isThere);
  /// Queues a launch of as many threads as a block can have, up to `threads`;
  /// with `blocks` 0, of as many blocks as run at a time.
  Status launch(LibraryKernel kernel, unsigned blocks, unsigned threads,
                std::initializer_list<uint64_t> slots);

private:
  struct Entry {
    DeviceFunction *function;
    unsigned mostThreads;
  };

  DeviceQueue &queue;
  std::mutex mutex;
  std::unique_ptr<DeviceModule> module;
  std::vector<Entry> entries;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_MIRROR_LIBRARYKERNELS_H
