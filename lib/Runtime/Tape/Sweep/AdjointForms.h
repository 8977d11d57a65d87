//===- AdjointForms.h - The variant of each adjoint -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An adjoint has up to four variants: it zeroes the adjoints of overwritten
// elements, or not; it loads stored outputs of the kernel, or recomputes them.
// The loading variant is used if the fields still hold the stored values.
// Otherwise the recomputing variant is used, which needs no values beyond those
// that the tape saves anyway.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_SWEEP_ADJOINTFORMS_H
#define TAI_LIB_RUNTIME_TAPE_SWEEP_ADJOINTFORMS_H

#include "../Memory/TapeMemory.h"
#include "../Plan/TapePlan.h"

namespace mlir::tai::runtime {

class AdjointForms {
public:
  AdjointForms(TapeServices services, const TapeRecording &recording,
               const TapePlan &plan, const TapeMemory &memory)
      : services(services), recording(recording), plan(plan), memory(memory) {}

  /// Notes whether fields with stored outputs have been changed by something
  /// that is not recorded.
  void setLostStored(bool lost) { lostStored = lost; }

  /// True if the adjoint of a launch should be the variant that loads stored
  /// outputs, if this variant exists.
  bool loadsStored(size_t index) const;
  /// Gives the adjoint of a launch, in the variant that the plan chose,
  /// compiled if necessary; null if there is nothing to differentiate.
  Status find(size_t index, Kernel *&adjoint) const;
  /// The adjoints that a sweep by the plan needs and that have not been
  /// compiled or requested.
  std::vector<PendingAdjoint> pending() const;

private:
  TapeServices services;
  const TapeRecording &recording;
  const TapePlan &plan;
  const TapeMemory &memory;
  bool lostStored = false;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_SWEEP_ADJOINTFORMS_H
