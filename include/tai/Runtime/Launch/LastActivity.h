//===- LastActivity.h - Cells that a launch visited -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An adjoint visits the cells that its primal visited. Under a tape, these
// cells are part of the record of the launch. An adjoint that is launched by
// hand belongs to the last launch of its primal, whose cells are kept here.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_LASTACTIVITY_H
#define TAI_RUNTIME_LAUNCH_LASTACTIVITY_H

#include "tai/Runtime/Sparse/LoopLists.h"
#include "tai/Support/Status.h"
#include <mutex>
#include <vector>

namespace mlir::tai::runtime {

class Kernel;

class LastActivity {
public:
  /// Notes that a launch of a kernel whose trees have the levels `nodes`
  /// begins.
  void begin(const std::vector<SparseNode *> &nodes);
  void noteLoops(const LoopLists &loops);
  /// Gives the cells that the loops of the kernel's last launch visited. Fails
  /// if activity has changed since then in a way that the adjoint cannot
  /// handle.
  Status check(Kernel &kernel, LoopLists &loops, bool &wasLaunched);

private:
  std::mutex mutex;
  /// The state of the levels when the last launch began, and the cells that its
  /// loops visited.
  std::vector<SparseNode::Moment> begins;
  LoopLists lists;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_LASTACTIVITY_H
