//===- ReverseSweep.h - Executes the plan of a reverse sweep ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Launches the adjoints of records, from the last to the first, in the states
// of memory and activity that they want, and calls the reverse of host
// functions in between.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_REVERSESWEEP_H
#define TAI_LIB_RUNTIME_TAPE_REVERSESWEEP_H

#include "AdjointForms.h"
#include "AdjointHealth.h"
#include "Memory/TapeTopology.h"

namespace mlir::tai::runtime {

class ReverseSweep {
public:
  ReverseSweep(TapeServices services, Tape &tape,
               const TapeRecording &recording, TapePlan &plan,
               const AdjointForms &forms, TapeMemory &memory,
               TapeTopology &topology, AdjointHealth &health)
      : services(services), tape(tape), recording(recording), plan(plan),
        forms(forms), memory(memory), topology(topology), health(health) {}

  /// All that the plan replays; for sequences without reverse host functions.
  Status runPlanned(Launch &launch);
  /// All records, deciding on each when its turn comes: host functions may have
  /// made adjoints non-zero of which the plan knows nothing.
  Status runDeciding(Launch &launch);
  /// One record of such a sweep, or of one in pieces.
  Status reverse(Launch &launch, size_t index);

  /// What the loops of a kernel went over that the host function launched whose
  /// reverse is running. Fails as checkActivity does.
  Status findLoops(Kernel &kernel, LoopLists &lists);

  /// To be told what may have an adjoint when a host function is through, if
  /// somebody watches.
  std::function<std::vector<Field *>()> liveFields;

private:
  /// Runs the adjoint of a record and, where it stored elements again, zeroes
  /// the adjoints of those.
  Status replay(Launch &launch, size_t index);
  Status runAdjoint(Launch &launch, size_t index);
  Status callHost(size_t index);
  /// Zeroes the adjoint of what the host has written.
  Status zeroWritten(const HostWrite &write);
  /// Fails if the adjoint of a kernel asks for activity that the record itself
  /// has changed.
  Status checkActivity(Kernel &kernel, size_t index) const;

  TapeServices services;
  /// To which launches of host functions belong; no part of it is looked at.
  Tape &tape;
  const TapeRecording &recording;
  TapePlan &plan;
  const AdjointForms &forms;
  TapeMemory &memory;
  TapeTopology &topology;
  AdjointHealth &health;
  /// The host function whose reverse is running.
  size_t hostFunction = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_REVERSESWEEP_H
