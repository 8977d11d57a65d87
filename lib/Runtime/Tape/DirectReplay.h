//===- DirectReplay.h - Launches with nothing between -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Between two launches of a replay the runtime looks for values to be saved or
// put back, for cells that have become active, for a device, a profiler and so
// on, which costs as much as a loop over a hundred elements. Where the sequence
// has none of that, which is found out once for all of it, its functions are
// called one after another. The order, and so every bit, stays the same.
//
// Whether anything but launches stands between them (host functions, saved
// values, sparse trees) is the question of those who ask for this.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_DIRECTREPLAY_H
#define TAI_LIB_RUNTIME_TAPE_DIRECTREPLAY_H

#include "AdjointForms.h"

namespace mlir::tai::runtime {

class DirectReplay {
public:
  DirectReplay(TapeServices services, const TapeRecording &recording)
      : services(services), recording(recording) {}

  /// Whether the kernels can be called directly.
  bool findForward() const;
  /// Whether the adjoints can that the plan names; they are kept until the next
  /// call.
  bool findReverse(const TapePlan &plan, const AdjointForms &forms);

  /// To be called after the above have found so.
  Status runForward(Launch &launch) const;
  Status runReverse(Launch &launch, const TapePlan &plan) const;

private:
  Status call(Launch &launch, Kernel &kernel, size_t index) const;

  TapeServices services;
  const TapeRecording &recording;
  /// One for each record that the plan replays.
  std::vector<Kernel *> adjoints;
  /// Adjoint fields that they change.
  std::vector<Field *> targets;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_DIRECTREPLAY_H
