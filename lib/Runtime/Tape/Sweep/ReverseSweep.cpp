//===- ReverseSweep.cpp - Executes the plan of a reverse sweep ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "ReverseSweep.h"
#include <algorithm>

using namespace mlir::tai::runtime;
using Decision = TapePlan::Decision;
using Kind = TapeRecording::Kind;

Status ReverseSweep::runPlanned(Launch &launch) {
  for (uint32_t index : plan.replayed()) {
    Status status = replay(launch, index);
    if (!status)
      return status;
  }
  return Status::success();
}

Status ReverseSweep::runDeciding(Launch &launch) {
  Status status;
  for (size_t i = recording.size(); i-- > 0 && status;)
    status = reverse(launch, i);
  return status;
}

Status ReverseSweep::reverse(Launch &launch, size_t index) {
  if (recording.callsInReverse())
    plan.decideAgain(recording, index);
  Status status;
  if (plan[index] == Decision::Callback) {
    topology.enter(static_cast<uint32_t>(index));
    status = memory.enter(static_cast<uint32_t>(index), /*reexecutes=*/false);
    if (status)
      status = callHost(index);
    if (status && health.isWatching())
      health.examine(index, liveFields());
  } else if (TapePlan::isReplayed(plan[index])) {
    status = replay(launch, index);
  } else {
    services.count(TapePlan::counterOf(plan[index]));
  }
  return status;
}

Status ReverseSweep::replay(Launch &launch, size_t index) {
  Status status = replayRecord(launch, index);
  first.leave(static_cast<uint32_t>(index));
  return status;
}

Status ReverseSweep::replayRecord(Launch &launch, size_t index) {
  const TapeRecording::Record &record = recording[index];
  topology.enter(static_cast<uint32_t>(index));
  if (record.kind == Kind::Write)
    return zeroWritten(recording.write(record));
  if (memory.empty())
    return runAdjoint(launch, index);
  bool changes = record.kernel->adjoint().reexecutes();
  Status status = memory.enter(static_cast<uint32_t>(index), changes);
  if (!status)
    return status;
  status = runAdjoint(launch, index);
  memory.leave(changes);
  return status;
}

Status ReverseSweep::runAdjoint(Launch &launch, size_t index) {
  const TapeRecording::Record &record = recording[index];
  Kernel &kernel = *record.kernel;
  const uint64_t *args = recording.args(record);
  // A launch is skipped if the adjoints of its results and of the fields that
  // it changes are zero.
  const std::vector<Field *> &sources = kernel.tables().adjointSources;
  const CallerAdjoints &caller = kernel.callerAdjoints();
  if (services.skips(Skip::DeadLaunches) && !caller.results.empty() &&
      std::none_of(sources.begin(), sources.end(),
                   [](Field *field) { return field->adjoint()->dirty(); }) &&
      caller.areZero(args + kernel.argSlots()))
    return Status::success();
  Kernel *adjoint = nullptr;
  Status status = forms.find(index, adjoint);
  // A launch that the loss does not depend on need not be differentiable.
  if (!status && plan[index] == Decision::Unpruned)
    return Status::success();
  if (!status || !adjoint)
    return status;
  status = checkActivity(kernel, index);
  if (!status)
    return status;
  services.count(SkipCount::TapeReplayed);
  static const LoopLists none;
  const LoopLists *loops = topology.loopsAt(static_cast<uint32_t>(index));
  launch.zeroAdjoints = first.enter(static_cast<uint32_t>(index));
  status = services.runAdjoint(launch, kernel, *adjoint, args,
                               recording.number(record), loops ? loops : &none);
  launch.zeroAdjoints = 0;
  if (__builtin_expect(health.isWatching(), false) && status)
    health.examine(recording, index);
  return status;
}

Status ReverseSweep::callHost(size_t index) {
  TapeServices::HostFunction running(services, tape);
  hostFunction = index;
  return recording.callback(recording[index]).backward();
}

Status ReverseSweep::zeroWritten(const HostWrite &write) {
  Field *adjoint = write.field->adjoint();
  if (!adjoint || !adjoint->dirty())
    return Status::success();
  if (!adjoint->valid())
    return Status::failure(StatusCode::Usage, "the tree of the gradient of '" +
                                                  write.field->name() +
                                                  "' has been destroyed");
  const char zeros[8] = {};
  HostWrite zero = write;
  zero.field = adjoint;
  zero.bytes = zeros;
  if (zero.what == HostWrite::What::Array)
    zero.what = HostWrite::What::Fill;
  if (!services.perform(zero, FieldCopies::Interrupts::Stop))
    return failAsInterrupted();
  // In forward mode, the tangent of the adjoint is zeroed as well.
  zero.field = services.isForward() ? adjoint->dual() : nullptr;
  if (zero.field && !services.perform(zero, FieldCopies::Interrupts::Stop))
    return failAsInterrupted();
  return Status::success();
}

Status ReverseSweep::findLoops(Kernel &kernel, LoopLists &lists) {
  // The lists hold the activity after the whole host function, since the
  // activity after the single launch in it is not known.
  for (SparseNode *node : kernel.tables().sparseNodes)
    lists.addUnknown(
        *node, node->list(),
        topology.changes(static_cast<uint32_t>(hostFunction), *node));
  return checkActivity(kernel, hostFunction);
}

Status ReverseSweep::checkActivity(Kernel &kernel, size_t index) const {
  if (kernel.tables().sparseNodes.empty())
    return Status::success();
  for (const FieldPtr &field : kernel.adjoint().plan().activity)
    for (const SparseNode *node = field->sparseNode(); node;
         node = node->above())
      if (topology.changes(static_cast<uint32_t>(index), *node))
        return Status::failure(
            StatusCode::Usage,
            "kernel '" + kernel.name() + "' asks which cells of " +
                node->info().label + " are active, which the same " +
                (recording[index].kernel ? "kernel" : "host function") +
                " changes, and its gradient needs the answers; make the "
                "changes in a kernel of their own");
  return Status::success();
}
