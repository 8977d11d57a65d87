//===- TapePlain.cpp - Sequences that need nothing between launches -------===//
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
//===----------------------------------------------------------------------===//

#include "../Launch/Launch.h"
#include "TapeCheckpoint.h"
#include "TapeMemory.h"
#include "TapeTopology.h"
#include "tai/Runtime/Tape/Tape.h"
#include <algorithm>

using namespace mlir::tai::runtime;

/// Whether calling the function, with its trees and arguments, is all that a
/// launch does.
bool Kernel::isPlain() const {
  return sparseNodes.empty() && loopLevels.empty() && info.resultSlots == 0 &&
         info.callerAdjoints.slots == 0;
}

bool Tape::isPlain() const {
  return runtime.runsPlainly() && !checkpoints && !watching &&
         callbacks.empty() && writes.empty() && memory->savesNothing() &&
         topology->watchesNothing();
}

bool Tape::findPlainForward() {
  if (!isPlain())
    return false;
  uint64_t epoch = runtime.storageEpoch();
  for (const KernelPtr &kernel : kernels)
    if (!kernel->resolved() || !kernel->bind(epoch) || !kernel->isPlain())
      return false;
  return true;
}

bool Tape::findPlainReverse() {
  if (!isPlain())
    return false;
  uint64_t epoch = runtime.storageEpoch();
  for (const KernelPtr &kernel : kernels)
    if (!kernel->bind(epoch) || !kernel->isPlain() || kernel->adjointReruns ||
        !kernel->plan().activity.empty())
      return false;
  plainAdjoints.clear();
  plainTargets.clear();
  // Sequences are of few kernels, again and again.
  std::vector<const Kernel *> known;
  for (uint32_t index : needed) {
    Kernel *adjoint = nullptr;
    if (decisions[index] != Decision::Replay || !findAdjoint(index, adjoint) ||
        !adjoint)
      return false;
    plainAdjoints.push_back(adjoint);
    if (std::find(known.begin(), known.end(), adjoint) != known.end())
      continue;
    if (!adjoint->resolve() || !adjoint->bind(epoch) || !adjoint->isPlain())
      return false;
    known.push_back(adjoint);
    for (Field *field : records[index].kernel->adjointTargets)
      plainTargets.push_back(field->adjoint());
    plainTargets.insert(plainTargets.end(), adjoint->changedAdjoints.begin(),
                        adjoint->changedAdjoints.end());
  }
  return true;
}

Status Tape::callPlainly(Launch &launch, Kernel &kernel, size_t index) {
  if (!launch.passSafepoint())
    return launch.takeFailure();
  const Record &record = records[index];
  launch.trees = kernel.bases.data();
  launch.loopTimes = &kernel.loopTimes;
  launch.args = slots.data() + record.payload;
  launch.launch = firstLaunch + record.launch;
  int32_t code = kernel.function.load(std::memory_order_relaxed)(&launch);
  if (launch.arena.used())
    launch.arena.reset();
  if (__builtin_expect(code == 0 && !launch.hasFailed(), true))
    return Status::success();
  launch.freeSinks();
  return runtime.failureOf(launch, kernel);
}

Status Tape::runPlainForward(Launch &launch) {
  for (const KernelPtr &kernel : kernels)
    for (Field *field : kernel->changedAdjoints)
      field->markDirty();
  launch.results = nullptr;
  launch.seed = runtime.options().seed;
  for (size_t i = 0; i < records.size(); ++i) {
    Kernel &kernel = *records[i].kernel;
    kernel.prepared.lastLaunch.store(firstLaunch + records[i].launch,
                                     std::memory_order_relaxed);
    Status status = callPlainly(launch, kernel, i);
    if (!status)
      return status;
  }
  return Status::success();
}

Status Tape::runPlainReverse(Launch &launch) {
  for (Field *field : plainTargets)
    field->markDirty();
  launch.results = nullptr;
  launch.seed = runtime.options().seed;
  for (size_t i = 0; i < needed.size(); ++i) {
    Status status = callPlainly(launch, *plainAdjoints[i], needed[i]);
    if (!status)
      return status;
  }
  runtime.skipCounters().bump(SkipCount::TapeReplayed,
                              static_cast<int64_t>(needed.size()));
  return Status::success();
}

void Tape::explainPlain() {
  if (findPlainForward())
    explanation += "a replay calls the " + std::to_string(records.size()) +
                   " launches one after another, without a look between them\n";
  if (planHolds(/*cleared=*/true) && findPlainReverse())
    explanation += "a replay calls the " + std::to_string(needed.size()) +
                   " adjoints one after another, without a look between them\n";
}
