//===- DirectReplay.cpp - Replays without extra steps ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "DirectReplay.h"
#include <algorithm>

using namespace mlir::tai::runtime;

bool DirectReplay::findForward() const {
  uint64_t epoch = services.epoch();
  for (const KernelPtr &kernel : recording.kernels())
    if (!kernel->resolved() || !kernel->bind(epoch) || !kernel->isDirect())
      return false;
  return true;
}

bool DirectReplay::findReverse(const TapePlan &plan,
                               const AdjointForms &forms) {
  uint64_t epoch = services.epoch();
  for (const KernelPtr &kernel : recording.kernels())
    if (!kernel->bind(epoch) || !kernel->isDirect() ||
        kernel->adjoint().reexecutes() ||
        !kernel->adjoint().plan().activity.empty())
      return false;
  adjoints.clear();
  targets.clear();
  // A sequence repeats few kernels, so each adjoint is checked once.
  std::vector<const Kernel *> known;
  for (uint32_t index : plan.replayed()) {
    Kernel *adjoint = nullptr;
    if (plan[index] != TapePlan::Decision::Replay ||
        !forms.find(index, adjoint) || !adjoint)
      return false;
    adjoints.push_back(adjoint);
    if (std::find(known.begin(), known.end(), adjoint) != known.end())
      continue;
    if (!adjoint->resolve() || !adjoint->bind(epoch) || !adjoint->isDirect())
      return false;
    known.push_back(adjoint);
    for (Field *field : recording[index].kernel->tables().adjointTargets)
      targets.push_back(field->adjoint());
    const std::vector<Field *> &changed = adjoint->tables().changedAdjoints;
    targets.insert(targets.end(), changed.begin(), changed.end());
  }
  return true;
}

Status DirectReplay::call(Launch &launch, Kernel &kernel, size_t index) const {
  if (!launch.passSafepoint())
    return launch.takeFailure();
  const TapeRecording::Record &record = recording[index];
  launch.args = recording.args(record);
  launch.launch = recording.number(record);
  int32_t code = kernel.callDirectly(launch);
  if (launch.arena.used())
    launch.arena.reset();
  if (__builtin_expect(code == 0 && !launch.hasFailed(), true))
    return Status::success();
  launch.freeSinks();
  return TapeServices::failureOf(launch, kernel);
}

Status DirectReplay::runForward(Launch &launch) const {
  for (const KernelPtr &kernel : recording.kernels())
    for (Field *field : kernel->tables().changedAdjoints)
      field->markDirty();
  launch.results = nullptr;
  launch.seed = services.seed();
  for (size_t i = 0; i < recording.size(); ++i) {
    Kernel &kernel = *recording[i].kernel;
    kernel.setLastLaunch(recording.number(recording[i]));
    Status status = call(launch, kernel, i);
    if (!status)
      return status;
  }
  return Status::success();
}

Status DirectReplay::runReverse(Launch &launch, const TapePlan &plan,
                                FirstStores &first) const {
  for (Field *field : targets)
    field->markDirty();
  launch.results = nullptr;
  launch.seed = services.seed();
  const std::vector<uint32_t> &replayed = plan.replayed();
  for (size_t i = 0; i < replayed.size(); ++i) {
    launch.zeroAdjoints = first.enter(replayed[i]);
    Status status = call(launch, *adjoints[i], replayed[i]);
    launch.zeroAdjoints = 0;
    if (!status)
      return status;
  }
  services.count(SkipCount::TapeReplayed,
                 static_cast<int64_t>(replayed.size()));
  return Status::success();
}
