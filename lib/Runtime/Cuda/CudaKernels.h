//===- CudaKernels.h - Kernels of our own -----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Kernels that copy, swap and fill rows of memory: see Rows.cu and FillTable.h.
// The driver takes a microsecond for each row, and what comes next is made
// ready only when it is done; several fills are one kernel, which can overlap
// as others do.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_CUDA_CUDAKERNELS_H
#define TAI_LIB_RUNTIME_CUDA_CUDAKERNELS_H

#include "FillTable.h"
#include "tai/Runtime/Device/Device.h"

namespace mlir::tai::runtime::cuda {

class CudaKernels {
public:
  enum Kernel { CopyRows, SwapRows };

  explicit CudaKernels(Device &device) : device(device) {}

  /// Not when they are first used: that may be while a graph is recorded.
  Status load();
  /// While the device can still be used.
  void unload() { module.reset(); }

  /// One of those that take rows here and rows there. `overlaps`: it is made
  /// ready early.
  Status runPairs(Kernel kernel, const DeviceRows &one, DevicePtr other,
                  int64_t otherStep, bool overlaps);
  /// Fills all of these, with no more blocks than `mostBlocks`; as many as run
  /// at a time if that is 0.
  Status fill(const std::vector<const DeviceFill *> &fills, bool overlaps,
              unsigned mostBlocks);

private:
  Status runRows(Kernel kernel, int unit, int64_t units, bool overlaps,
                 std::initializer_list<uint64_t> parameters);
  struct Filling;

  /// Bytes, words, pairs of them and quads.
  static constexpr int kUnits = 4;

  Device &device;
  std::unique_ptr<DeviceModule> module;
  DeviceFunction *rows[kUnits][2] = {};
  DeviceFunction *filler = nullptr;
  /// So many of its blocks run at a time.
  unsigned fillBlocks = 1;
};

} // namespace mlir::tai::runtime::cuda

#endif // TAI_LIB_RUNTIME_CUDA_CUDAKERNELS_H
