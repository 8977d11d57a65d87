//===- Recorder.h - The interface to a tape ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A tape as seen by the code that launches kernels and changes fields.
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
  /// Whether recording is suspended.
  virtual bool isSuspended() const = 0;
  /// During the reverse of a host function: the cells that the loops of a
  /// kernel, launched by the function, visited.
  virtual Status findLoops(Kernel &kernel, LoopLists &lists, bool &found) = 0;

  /// Call before the host activates cells of the tree.
  virtual void watch(const TreePtr &tree) = 0;
  /// Performs a write and records it.
  virtual Status write(const HostWrite &write) = 0;
  /// Runs `change`, which changes the activity of a tree, and records it.
  virtual Status changeActivity(const TreePtr &tree,
                                std::function<Status()> change) = 0;

  /// Whether the gradient needs the values of the field.
  virtual bool needsValues(const Field &field) const = 0;
  /// Whether the tape uses the field at all.
  virtual bool uses(const FieldPtr &field) const = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_HOST_RECORDER_H
