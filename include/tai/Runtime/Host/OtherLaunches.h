//===- OtherLaunches.h - What other threads change --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Launches, as those see them that hold fields.
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

  /// Whether threads other than the calling one have launched kernels.
  virtual bool areThere() const = 0;
  /// To be called once the state has changed: launches of other threads that
  /// have not begun see the new one, all others are visited.
  virtual void letThemSee() const = 0;
  /// Calls `visit` with each field that a kernel changes which another thread
  /// runs, unless that thread's tape knows of it; and with the kernel's name.
  virtual void visitChanges(
      const std::function<void(const std::string &kernel, const Field &field,
                               HoldKind kind)> &visit) = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_HOST_OTHERLAUNCHES_H
