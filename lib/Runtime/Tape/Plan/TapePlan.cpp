//===- TapePlan.cpp - The plan of a reverse sweep -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "TapePlan.h"
#include "LiveSlabs.h"
#include <algorithm>

using namespace mlir::tai::runtime;
using Kind = TapeRecording::Kind;

namespace {
/// The adjoints that may be non-zero (live) during a sweep, taken from the
/// dirty flags of adjoint fields.
struct DirtyAdjoints {
  static bool has(const Field &field) { return field.adjoint()->dirty(); }
  static bool hasAny(const std::vector<Field *> &fields) {
    return std::any_of(fields.begin(), fields.end(),
                       [](const Field *field) { return has(*field); });
  }
  static bool isWritten(const TapeRecording::Record &record) {
    return hasAny(record.kernel->tables().adjointSources);
  }
  static bool isOverwritten(const TapeRecording::Record &record) {
    return hasAny(record.kernel->tables().overwritten);
  }
};
} // namespace

template <typename Live>
TapePlan::Decision TapePlan::decide(const TapeRecording &recording,
                                    size_t index, const Live &live) const {
  const TapeRecording::Record &record = recording[index];
  if (record.kind == Kind::Callback)
    return recording.callback(record).backward ? Decision::Callback
                                               : Decision::SkipCallback;
  if (record.kind == Kind::Write) {
    const Field *field = recording.write(record).field;
    return field->adjoint() && live.has(*field) ? Decision::Overwrite
                                                : Decision::SkipUnreached;
  }
  const Kernel &kernel = *record.kernel;
  if (!kernel.differentiable())
    return Decision::SkipNoDerivative;
  auto skip = [&](Decision decision) {
    return inputs.prunes ? decision : Decision::Unpruned;
  };
  const CallerAdjoints &caller = kernel.callerAdjoints();
  if (!live.isWritten(record) && !caller.hasSources())
    return skip(Decision::SkipUnreached);
  Interest interest = interests[index];
  if (interest == Interest::Leads &&
      (!kernel.tables().adjointTargets.empty() || caller.hasTargets))
    return Decision::Replay;
  // Any other adjoint zeroes adjoints of elements that its kernel overwrote,
  // and does nothing else, which matters only to earlier writers of these
  // elements.
  if (interest != Interest::None && zeroesAt(index) &&
      live.isOverwritten(record))
    return Decision::Replay;
  return interest == Interest::Leads ? skip(Decision::SkipNoEffect)
                                     : Decision::SkipUnwanted;
}

/// Follows the elements that depend on wanted fields through the records, and
/// sets the interest of each record.
void TapePlan::findUnwanted(const TapeRecording &recording,
                            const std::vector<FieldPtr> &wanted) {
  interests.assign(recording.size(), Interest::Leads);
  if (wanted.empty())
    return;
  LiveSlabs varied(recording);
  for (const FieldPtr &field : wanted)
    varied.add(*field);
  for (size_t i = 0; i < recording.size(); ++i) {
    const TapeRecording::Record &record = recording[i];
    if (record.kind == Kind::Callback && recording.callback(record).backward)
      varied.addAll();
    if (record.kind != Kind::Launch)
      continue;
    // A kernel that adds to adjoints of the caller's arrays counts as a reader:
    // arrays can depend on wanted fields, and their gradients are wanted.
    bool leads =
        varied.isRead(record) || record.kernel->callerAdjoints().hasTargets;
    if (!leads)
      interests[i] =
          varied.isOverwritten(record) ? Interest::Ends : Interest::None;
    varied.passForward(record, leads);
  }
}

void TapePlan::make(const TapeServices &services,
                    const TapeRecording &recording, std::vector<Field *> seeded,
                    const std::vector<FieldPtr> &asked) {
  std::vector<FieldPtr> wanted;
  if (services.skips(Skip::UnwantedGradients))
    wanted = asked;
  inputs = {services.epoch(), std::move(seeded), {}, true};
  inputs.prunes = services.skips(Skip::DeadLaunches);
  for (const FieldPtr &field : wanted)
    inputs.wanted.push_back(field.get());
  for (const KernelPtr &kernel : recording.kernels())
    // A failure of bind() because of a destroyed tree is ignored, since
    // launching the kernel reports it.
    (void)kernel->bind(inputs.epoch);
  std::shared_ptr<const KnownPlan> known = services.knownPlan();
  if (known && known->find(recording, inputs, results))
    return;
  results = {};
  results.overwrites = findOverwrites(recording);
  findUnwanted(recording, wanted);
  decideAll(recording);
  if (std::shared_ptr<const KnownPlan> made =
          KnownPlan::make(recording, inputs, results))
    services.setKnownPlan(std::move(made));
}

/// Decides from the last record to the first which records a sweep replays,
/// following adjoints that may be non-zero.
void TapePlan::decideAll(const TapeRecording &recording) {
  std::vector<Decision> &decisions = results.decisions;
  decisions.assign(recording.size(), Decision::SkipUnreached);
  LiveSlabs live(recording);
  for (const Field *field : inputs.live)
    live.add(*field);
  for (size_t i = recording.size(); i-- > 0;) {
    decisions[i] = decide(recording, i, live);
    if (decisions[i] == Decision::Callback)
      live.addAll();
    if (isReplayed(decisions[i]))
      results.needed.push_back(static_cast<uint32_t>(i));
    if (decisions[i] == Decision::Replay)
      live.pass(recording[i], zeroesAt(i));
    if (decisions[i] == Decision::Overwrite &&
        recording.write(recording[i]).replacesAll())
      live.remove(*recording.write(recording[i]).field);
  }
}

void TapePlan::decideAgain(const TapeRecording &recording, size_t index) {
  results.decisions[index] = decide(recording, index, DirtyAdjoints());
}

bool TapePlan::replaysAny() const {
  return std::any_of(
      results.decisions.begin(), results.decisions.end(),
      [](Decision decision) { return decision == Decision::Replay; });
}

int64_t TapePlan::numUnwanted() const {
  return std::count(results.decisions.begin(), results.decisions.end(),
                    Decision::SkipUnwanted);
}

int64_t TapePlan::numSkipped() const {
  return std::count_if(results.decisions.begin(), results.decisions.end(),
                       [](Decision decision) {
                         return !isReplayed(decision) &&
                                decision != Decision::Callback;
                       });
}
