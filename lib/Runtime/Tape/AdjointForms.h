//===- AdjointForms.h - Which form of its adjoint a record runs -*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An adjoint comes in up to four forms: it leaves the adjoints of what the
// kernel overwrites to others, or zeroes them; it computes values that the
// kernel has stored once more, or loads them. A launch is reversed by the
// second if the fields still hold what it stored. Else that form runs which
// computes them from what the tape keeps for it anyway, so that no value is
// saved for the sake of this.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_ADJOINTFORMS_H
#define TAI_LIB_RUNTIME_TAPE_ADJOINTFORMS_H

#include "Memory/TapeMemory.h"
#include "TapePlan.h"

namespace mlir::tai::runtime {

class AdjointForms {
public:
  AdjointForms(TapeServices services, const TapeRecording &recording,
               const TapePlan &plan, const TapeMemory &memory)
      : services(services), recording(recording), plan(plan), memory(memory) {}

  /// Something that no record stands for has changed fields that launches have
  /// stored to.
  void setLostStored(bool lost) { lostStored = lost; }

  /// Whether the adjoint of a launch loads what the launch has stored, if there
  /// is such a form.
  bool loadsStored(size_t index) const;
  /// The adjoint of a launch by the plan, made now if need be; null where there
  /// is nothing to differentiate.
  Status find(size_t index, Kernel *&adjoint) const;
  /// Those that a sweep by the plan will ask for and that nobody has asked for.
  std::vector<PendingAdjoint> pending() const;

private:
  TapeServices services;
  const TapeRecording &recording;
  const TapePlan &plan;
  const TapeMemory &memory;
  bool lostStored = false;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_ADJOINTFORMS_H
