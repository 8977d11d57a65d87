//===- DirectReplay.h - Replays without extra steps -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Between two launches of a replay the runtime normally checks for values to
// save or restore, for newly active cells, a device, a profiler and so on,
// which costs as much as a loop over a hundred elements. If a sequence needs
// none of these steps, which is checked once for all of it, its functions are
// called one after another. The order, and so every bit of the results, is the
// same.
//
// The caller checks that the sequence has no host functions, saved values or
// sparse trees.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_REPLAY_DIRECTREPLAY_H
#define TAI_LIB_RUNTIME_TAPE_REPLAY_DIRECTREPLAY_H

#include "../Sweep/FirstStores.h"

namespace mlir::tai::runtime {

class DirectReplay {
public:
  DirectReplay(TapeServices services, const TapeRecording &recording)
      : services(services), recording(recording) {}

  /// True if the kernels of the recording can be called directly, without the
  /// runtime's other steps of a launch.
  bool findForward() const;
  /// True if the adjoints of the plan can be called directly; keeps them for
  /// runReverse.
  bool findReverse(const TapePlan &plan, const AdjointForms &forms);

  /// Run the recorded sequence forward or in reverse. Must be called only after
  /// findForward or findReverse, respectively, has returned true.
  Status runForward(Launch &launch) const;
  Status runReverse(Launch &launch, const TapePlan &plan,
                    FirstStores &first) const;

private:
  Status call(Launch &launch, Kernel &kernel, size_t index) const;

  TapeServices services;
  const TapeRecording &recording;
  /// The adjoint kernel of each record that the plan replays.
  std::vector<Kernel *> adjoints;
  /// The adjoint fields that the adjoint kernels change.
  std::vector<Field *> targets;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_REPLAY_DIRECTREPLAY_H
