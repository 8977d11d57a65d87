//===- LibraryKernels.h - Kernels of the device library ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Kernels of the device library that the runtime itself launches (see
// tai/ABI/DeviceSparse.h). They are launched like any other kernel, and can
// become part of graphs and programs.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_MIRROR_LIBRARYKERNELS_H
#define TAI_RUNTIME_MIRROR_LIBRARYKERNELS_H

#include "tai/Runtime/Queue/DeviceQueue.h"
#include "tai/Runtime/Threads/Section.h"
#include <initializer_list>

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

  /// Loads the kernels of the device library at the first call. Sets `isThere`
  /// to false if no compiler is available to make them.
  Status load(bool &isThere);
  /// Queues a launch with blocks of the maximum size, up to `threads`; with
  /// `blocks` 0, with as many blocks as can be resident.
  Status launch(LibraryKernel kernel, unsigned blocks, unsigned threads,
                std::initializer_list<uint64_t> slots);

private:
  struct Entry {
    DeviceFunction *function;
    unsigned mostThreads;
  };

  DeviceQueue &queue;
  Section loading;
  std::unique_ptr<DeviceModule> module;
  std::vector<Entry> entries;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_MIRROR_LIBRARYKERNELS_H
