//===- KeptBlockSizes.h - Sizes of blocks that were found -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_DEVICE_KEPTBLOCKSIZES_H
#define TAI_RUNTIME_DEVICE_KEPTBLOCKSIZES_H

#include <functional>
#include <optional>
#include <string>

namespace mlir::tai::runtime {

/// What trials of block sizes have found, by key, from one process to the next.
/// Both may be null.
struct KeptBlockSizes {
  /// Nothing where nothing is known. Any bytes may come back.
  std::function<std::optional<std::string>(const std::string &key)> load;
  /// Must not keep its caller waiting.
  std::function<void(std::string key, std::string bytes)> store;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_DEVICE_KEPTBLOCKSIZES_H
