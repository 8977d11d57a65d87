//===- OtherLaunches.h - Launches of other threads --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The interface to running launches for tapes that hold fields.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_HOST_OTHERLAUNCHES_H
#define TAI_RUNTIME_HOST_OTHERLAUNCHES_H

#include "tai/Runtime/Storage/Field.h"
#include <functional>

namespace mlir::tai::runtime {

class OtherLaunches {
public:
  virtual ~OtherLaunches() = default;

  /// True if any thread other than the calling thread has launched kernels.
  virtual bool areAny() const = 0;
  /// Makes a changed state of holds (the fields that tapes use) visible to
  /// other threads: launches that begin later see the change, and visitChanges
  /// sees the launches that began earlier.
  virtual void publishState() const = 0;
  /// Calls `visit` with each field that a running kernel of another thread
  /// changes, and with the kernel's name, except for launches recorded by that
  /// thread's tape.
  virtual void visitChanges(
      const std::function<void(const std::string &kernel, const Field &field,
                               HoldKind kind)> &visit) = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_HOST_OTHERLAUNCHES_H
