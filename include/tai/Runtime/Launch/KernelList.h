//===- KernelList.h - The kernels of a runtime ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_KERNELLIST_H
#define TAI_RUNTIME_LAUNCH_KERNELLIST_H

#include "tai/Runtime/Launch/Kernel.h"

namespace mlir::tai::runtime {

/// The kernels of a runtime, in a list that can be iterated.
class KernelList {
public:
  KernelPtr create(KernelInfo info);
  int64_t size() const;
  /// Calls `body` for each kernel. Other threads may create kernels at the same
  /// time.
  template <typename Body> void forEach(const Body &body) const {
    std::lock_guard<std::mutex> lock(mutex);
    for (const std::weak_ptr<Kernel> &entry : kernels)
      if (KernelPtr kernel = entry.lock())
        body(*kernel);
  }

private:
  mutable std::mutex mutex;
  std::vector<std::weak_ptr<Kernel>> kernels;
  size_t most = 64;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_KERNELLIST_H
