//===- TapePlan.cpp - The plan of a reverse sweep -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "TapePlan.h"
#include <algorithm>

using namespace mlir::tai::runtime;
using Kind = TapeRecording::Kind;

template <typename Live>
TapePlan::Decision TapePlan::decide(const TapeRecording &recording,
                                    size_t index, const Live &live) const {
  const TapeRecording::Record &record = recording[index];
  if (record.kind == Kind::Callback)
    return recording.callback(record).backward ? Decision::Callback
                                               : Decision::SkipCallback;
  if (record.kind == Kind::Write) {
    const Field *field = recording.write(record).field;
    return field->adjoint() && live(field) ? Decision::Overwrite
                                           : Decision::SkipUnreached;
  }
  const Kernel &kernel = *record.kernel;
  if (!kernel.differentiable())
    return Decision::SkipNoDerivative;
  auto skip = [&](Decision decision) {
    return prunes ? decision : Decision::Unpruned;
  };
  const std::vector<Field *> &sources = TapedKernel::sources(kernel);
  const CallerAdjoints &caller = kernel.callerAdjoints();
  if (std::none_of(sources.begin(), sources.end(), live) &&
      !caller.hasSources())
    return skip(Decision::SkipUnreached);
  if (!TapedKernel::targets(kernel).empty() || caller.hasTargets)
    return Decision::Replay;
  // The rest of the work is to forget the adjoints of fields that the kernel
  // overwrote. That matters only to those who wrote it before.
  const std::vector<Field *> &overwritten = TapedKernel::overwritten(kernel);
  if (zeroesAt(index) &&
      std::any_of(overwritten.begin(), overwritten.end(), live))
    return Decision::Replay;
  return skip(Decision::SkipNoEffect);
}

void TapePlan::make(const TapeServices &services,
                    const TapeRecording &recording, std::vector<Field *> live) {
  plannedEpoch = services.epoch();
  plannedLive = std::move(live);
  prunes = services.skips(Skip::DeadLaunches);
  decisions.assign(recording.size(), Decision::SkipUnreached);
  needed.clear();
  for (const KernelPtr &kernel : recording.kernels())
    // A tree that has gone is an error when the kernel is launched.
    (void)TapedKernel::bind(*kernel, plannedEpoch);
  overwrites = findOverwrites(recording, services.nextMark());

  uint64_t mark = services.nextMark();
  for (Field *field : plannedLive)
    TapedField::planMark(*field) = mark;
  bool all = false;
  auto isLive = [&](const Field *field) {
    return all || TapedField::planMark(*field) == mark;
  };
  for (size_t i = recording.size(); i-- > 0;) {
    decisions[i] = decide(recording, i, isLive);
    if (decisions[i] == Decision::Callback)
      all = true;
    if (isReplayed(decisions[i]))
      needed.push_back(static_cast<uint32_t>(i));
    if (decisions[i] != Decision::Replay)
      continue;
    for (Field *field : TapedKernel::targets(*recording[i].kernel))
      TapedField::planMark(*field) = mark;
  }
}

void TapePlan::decideAgain(const TapeRecording &recording, size_t index) {
  decisions[index] = decide(recording, index, [](const Field *field) {
    return field->adjoint()->dirty();
  });
}

bool TapePlan::replaysAny() const {
  return std::any_of(decisions.begin(), decisions.end(), [](Decision decision) {
    return decision == Decision::Replay;
  });
}

int64_t TapePlan::numSkipped() const {
  return std::count_if(
      decisions.begin(), decisions.end(), [](Decision decision) {
        return !isReplayed(decision) && decision != Decision::Callback;
      });
}
