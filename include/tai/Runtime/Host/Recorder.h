//===- Recorder.h - The interface to a tape ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The interface to a tape for code that launches kernels and changes fields.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_HOST_RECORDER_H
#define TAI_RUNTIME_HOST_RECORDER_H

#include "tai/Runtime/Storage/Field.h"
#include <functional>

namespace mlir::tai::runtime {

class Kernel;
class LoopLists;
struct HostWrite;
struct Launch;

class Recorder {
public:
  virtual ~Recorder() = default;

  /// Launches a kernel and records it.
  virtual Status launch(Launch &launch, Kernel &kernel, const uint64_t *args,
                        uint64_t *results, uint64_t number) = 0;
  /// True if the tape does not record launches at present.
  virtual bool isSuspended() const = 0;
  /// While the reverse sweep runs a host function backwards: finds the cells
  /// that the loops of `kernel` visited when that function launched it.
  virtual Status findLoops(Kernel &kernel, LoopLists &lists, bool &found) = 0;

  /// Notes the activity of the tree's cells. Must be called before the host
  /// activates cells of the tree.
  virtual void watch(const TreePtr &tree) = 0;
  /// Performs a write of the host to a field, and records it.
  virtual Status write(const HostWrite &write) = 0;
  /// Runs `change`, which activates or deactivates cells of `tree`, and records
  /// it.
  virtual Status changeActivity(const TreePtr &tree,
                                std::function<Status()> change) = 0;

  /// True if computing the gradient needs the present values of `field`.
  virtual bool needsValues(const Field &field) const = 0;
  /// True if this tape uses `field`, that is, holds it now or has held it.
  virtual bool uses(const FieldPtr &field) const = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_HOST_RECORDER_H
