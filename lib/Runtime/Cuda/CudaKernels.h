//===- CudaKernels.h - Kernels of the runtime itself ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Kernels that copy, swap and fill rows of memory: see Rows.cu and FillTable.h.
// The driver takes a microsecond for each row, and its copies do not overlap
// with the next launch; here several fills are one kernel, which can overlap.
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

  /// Loads the kernels that copy and fill memory. Not done on first use, which
  /// may be during a graph capture.
  Status load();
  /// Unloads the runtime's own kernels. Must be called while the device can
  /// still be used.
  void unload() { module.reset(); }

  /// Runs a copy or swap kernel on the rows in `one` and equally many rows from
  /// address `other` on. `overlaps`: with programmatic dependent launch.
  Status runPairs(Kernel kernel, const DeviceRows &one, DevicePtr other,
                  int64_t otherStep, bool overlaps);
  /// Runs all fills by one kernel, with at most `mostBlocks` blocks; if that is
  /// 0, as many as can be resident.
  Status fill(const std::vector<const DeviceFill *> &fills, bool overlaps,
              unsigned mostBlocks);

private:
  Status runRows(Kernel kernel, int unit, int64_t units, bool overlaps,
                 std::initializer_list<uint64_t> parameters);
  struct Filling;

  /// The number of unit sizes of the copy kernels: 1, 4, 8 or 16 bytes.
  static constexpr int kUnits = 4;

  Device &device;
  std::unique_ptr<DeviceModule> module;
  DeviceFunction *rows[kUnits][2] = {};
  DeviceFunction *filler = nullptr;
  /// The number of blocks of the fill kernel that can be resident at once.
  unsigned fillBlocks = 1;
};

} // namespace mlir::tai::runtime::cuda

#endif // TAI_LIB_RUNTIME_CUDA_CUDAKERNELS_H
