//===- ReverseSweep.h - Executes the plan of a reverse sweep ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Launches the adjoints of records, from last to first, restoring the memory
// and activity that each one reads, and calls the reverse of host functions in
// between.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_SWEEP_REVERSESWEEP_H
#define TAI_LIB_RUNTIME_TAPE_SWEEP_REVERSESWEEP_H

#include "../Memory/TapeTopology.h"
#include "AdjointForms.h"
#include "AdjointHealth.h"
#include "FirstStores.h"

namespace mlir::tai::runtime {

class ReverseSweep {
public:
  ReverseSweep(TapeServices services, Tape &tape,
               const TapeRecording &recording, TapePlan &plan,
               const AdjointForms &forms, TapeMemory &memory,
               TapeTopology &topology, FirstStores &first,
               AdjointHealth &health)
      : services(services), tape(tape), recording(recording), plan(plan),
        forms(forms), memory(memory), topology(topology), first(first),
        health(health) {}

  /// Reverses the records that the plan selects; for sequences in which no host
  /// function has a reverse.
  Status runPlanned(Launch &launch);
  /// Runs all records, with a decision on each at its turn: host functions may
  /// have written adjoints in ways that the plan does not know.
  Status runDeciding(Launch &launch);
  /// Reverses one record: a step of runDeciding or of a sweep with checkpoints.
  Status reverse(Launch &launch, size_t index);

  /// During the reverse of a host function: the cells that the loops of a
  /// kernel, launched by the function, visited. Fails like checkActivity.
  Status findLoops(Kernel &kernel, LoopLists &lists);

  /// Returns the fields whose adjoints may be non-zero; for AdjointHealth after
  /// a host function.
  std::function<std::vector<Field *>()> liveFields;

private:
  /// Runs the adjoint of a record and zeroes the adjoints of overwritten
  /// elements.
  Status replay(Launch &launch, size_t index);
  Status replayRecord(Launch &launch, size_t index);
  Status runAdjoint(Launch &launch, size_t index);
  Status callHost(size_t index);
  /// Zeroes the adjoints of elements that the host has written during the
  /// recording.
  Status zeroWritten(const HostWrite &write);
  /// Fails if the adjoint of a kernel reads activity that the record itself has
  /// changed.
  Status checkActivity(Kernel &kernel, size_t index) const;

  TapeServices services;
  /// The tape of this sweep, which host functions use for their launches.
  Tape &tape;
  const TapeRecording &recording;
  TapePlan &plan;
  const AdjointForms &forms;
  TapeMemory &memory;
  TapeTopology &topology;
  FirstStores &first;
  AdjointHealth &health;
  /// The number of the host function whose reverse is running.
  size_t hostFunction = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_SWEEP_REVERSESWEEP_H
