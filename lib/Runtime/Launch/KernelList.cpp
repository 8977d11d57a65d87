//===- KernelList.cpp - The kernels of a runtime --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/KernelList.h"
#include <algorithm>

using namespace mlir::tai::runtime;

KernelPtr KernelList::create(KernelInfo info) {
  auto kernel = std::make_shared<Kernel>(std::move(info));
  std::lock_guard<std::mutex> lock(mutex);
  if (kernels.size() >= most) {
    auto gone = [](const auto &entry) { return entry.expired(); };
    kernels.erase(std::remove_if(kernels.begin(), kernels.end(), gone),
                  kernels.end());
    most = std::max<size_t>(64, 2 * kernels.size());
  }
  kernels.push_back(kernel);
  return kernel;
}

int64_t KernelList::size() const {
  std::lock_guard<std::mutex> lock(mutex);
  return std::count_if(kernels.begin(), kernels.end(),
                       [](const auto &entry) { return !entry.expired(); });
}
