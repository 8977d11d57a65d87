//===- KnownPlan.cpp - The last plan of a runtime -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "KnownPlan.h"

using namespace mlir::tai::runtime;

std::shared_ptr<const KnownPlan> KnownPlan::make(const TapeRecording &recording,
                                                 const PlanInputs &inputs,
                                                 const PlanResults &results) {
  // The longest recording whose plan is kept: a copy of so many records takes
  // about 10 MB.
  constexpr size_t mostRecords = 1 << 18;
  if (!recording.onlyLaunches() || recording.size() > mostRecords)
    return nullptr;
  auto known = std::make_shared<KnownPlan>();
  known->launches = recording.launches();
  known->kernels.assign(recording.kernels().begin(), recording.kernels().end());
  known->inputs = inputs;
  known->results = results;
  for (auto &[adjoint, zeros] : known->results.overwrites.storedOnce) {
    known->storedOnce.push_back(adjoint);
    adjoint.reset();
  }
  return known;
}

bool KnownPlan::find(const TapeRecording &recording, const PlanInputs &wanted,
                     PlanResults &found) const {
  if (!recording.onlyLaunches() || !(inputs == wanted) ||
      recording.kernels().size() != kernels.size() ||
      !(recording.launches() == launches))
    return false;
  // A new kernel can have the address of a destroyed one, so the weak
  // references are compared.
  for (size_t i = 0; i < kernels.size(); ++i)
    if (kernels[i].lock() != recording.kernels()[i])
      return false;
  found = results;
  for (size_t i = 0; i < storedOnce.size(); ++i) {
    found.overwrites.storedOnce[i].first = storedOnce[i].lock();
    if (!found.overwrites.storedOnce[i].first)
      return false;
  }
  return true;
}
