//===- AdjointForms.cpp - The variant of each adjoint ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "AdjointForms.h"
#include <algorithm>

using namespace mlir::tai::runtime;

bool AdjointForms::loadsStored(size_t index) const {
  const Kernel *kernel = recording[index].kernel;
  // Stored outputs are not loaded if a host function was recorded, which can
  // change fields without the tape's knowledge, nor in forward mode, as the
  // tangents of stored outputs are not necessarily stored.
  return kernel && kernel->adjoint().stored() && !recording.hasCallbacks() &&
         !lostStored && !services.isForward() &&
         memory.holdsStored(static_cast<uint32_t>(index));
}

Status AdjointForms::find(size_t index, Kernel *&adjoint) const {
  Kernel &kernel = *recording[index].kernel;
  bool zeroes = plan.zeroesAt(index);
  // known() finds an adjoint that was made before, without the lock of
  // resolveAdjoint().
  if (loadsStored(index)) {
    adjoint = kernel.adjoint().known(zeroes, /*stored=*/true);
    if (adjoint)
      return Status::success();
    Status status = kernel.adjoint().resolveStored(adjoint, zeroes);
    if (!status || adjoint)
      return status;
  }
  adjoint = kernel.adjoint().known(zeroes, /*stored=*/false);
  return adjoint ? Status::success()
                 : kernel.adjoint().resolve(adjoint, zeroes);
}

std::vector<PendingAdjoint> AdjointForms::pending() const {
  std::vector<PendingAdjoint> pending;
  for (uint32_t index : plan.replayed()) {
    Kernel *kernel = recording[index].kernel;
    // A launch that is replayed only because pruning is off is skipped, since
    // its kernel may have no derivative.
    if (!kernel || plan[index] == TapePlan::Decision::Unpruned)
      continue;
    PendingAdjoint entry = {kernel, plan.zeroesAt(index), loadsStored(index)};
    if (!kernel->adjoint().isAsked(entry.zeroes, entry.loadsStored) &&
        std::find(pending.begin(), pending.end(), entry) == pending.end())
      pending.push_back(entry);
  }
  return pending;
}

Status PendingAdjoint::resolve() const {
  Kernel *adjoint = nullptr;
  if (loadsStored) {
    Status status = kernel->adjoint().resolveStored(adjoint, zeroes);
    if (!status || adjoint)
      return status;
  }
  return kernel->adjoint().resolve(adjoint, zeroes);
}
