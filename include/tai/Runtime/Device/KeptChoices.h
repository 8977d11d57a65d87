//===- KeptChoices.h - Results of trials, persistent ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_DEVICE_KEPTCHOICES_H
#define TAI_RUNTIME_DEVICE_KEPTCHOICES_H

#include <functional>
#include <optional>
#include <string>

namespace mlir::tai::runtime {

/// Persistent storage, by key, for results of timing trials, shared by
/// processes. Both functions may be null.
struct KeptChoices {
  /// Loads the bytes stored for a key; no value for an unknown key. The bytes
  /// are untrusted.
  std::function<std::optional<std::string>(const std::string &key)> load;
  /// Must not block.
  std::function<void(std::string key, std::string bytes)> store;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_DEVICE_KEPTCHOICES_H
