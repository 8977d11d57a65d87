//===- Recorder.h - Who hears of what a thread does -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A tape, as those see it that launch kernels and change fields.
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

  /// Launches and records.
  virtual Status launch(Launch &launch, Kernel &kernel, const uint64_t *args,
                        uint64_t *results, uint64_t number) = 0;
  /// Whether launches are not recorded for a while.
  virtual bool isSuspended() const = 0;
  /// What the loops of a kernel went over that the host function launched whose
  /// reverse is running.
  virtual Status findLoops(Kernel &kernel, LoopLists &lists, bool &found) = 0;

  /// To be called before the host makes cells of the tree active.
  virtual void watch(const TreePtr &tree) = 0;
  /// Changes a field and records that.
  virtual Status write(const HostWrite &write) = 0;
  /// Changes the activity of a tree on behalf of the host, and records that.
  virtual Status changeActivity(const TreePtr &tree,
                                std::function<Status()> change) = 0;

  /// Whether the gradient needs what the field holds.
  virtual bool minds(const Field &field) const = 0;
  /// Whether it has to do with the field at all.
  virtual bool uses(const FieldPtr &field) const = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_HOST_RECORDER_H
