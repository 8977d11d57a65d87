//===- SentLaunch.h - The identity of a launch ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The key by which the queue recognises a repeated launch: everything but the
// values of its parameters.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_QUEUE_SENTLAUNCH_H
#define TAI_LIB_RUNTIME_QUEUE_SENTLAUNCH_H

#include "tai/Runtime/Device/Device.h"

namespace mlir::tai::runtime {

struct SentLaunch {
  const DeviceFunction *function;
  unsigned blocks, threads;
  /// The number of parameters.
  int count;
  bool operator==(const SentLaunch &other) const {
    return function == other.function && blocks == other.blocks &&
           threads == other.threads && count == other.count;
  }
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_SENTLAUNCH_H
