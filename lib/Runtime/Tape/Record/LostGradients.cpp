//===- LostGradients.cpp - Gradients lost in plain fields -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "LostGradients.h"
#include <algorithm>

using namespace mlir::tai::runtime;

/// True if the field cuts off derivatives: a float field without gradient.
static bool endsGradients(const Field &field) {
  return isFloat(field.scalar()) && !field.adjoint() && !field.isAdjoint();
}

/// True if there are fields without gradients that some kernel stores to and
/// some kernel reads.
static bool haveSuspectFields(const std::vector<KernelPtr> &kernels) {
  std::unordered_set<const Field *> stored;
  for (const KernelPtr &kernel : kernels)
    for (const Access &access : kernel->summary())
      if (access.kind != AccessKind::Read && endsGradients(*access.field))
        stored.insert(access.field.get());
  return !stored.empty() &&
         std::any_of(
             kernels.begin(), kernels.end(), [&](const KernelPtr &kernel) {
               const auto &summary = kernel->summary();
               return std::any_of(summary.begin(), summary.end(),
                                  [&](const Access &access) {
                                    return access.kind == AccessKind::Read &&
                                           stored.count(access.field.get());
                                  });
             });
}

static bool endsGradients(const FlowPlace &place) {
  return place.isArray() && !place.hasGradient;
}

/// True if some kernel stores to an array without gradient, and some kernel
/// reads from an array without gradient.
static bool haveSuspectArrays(const std::vector<KernelPtr> &kernels) {
  bool isStored = false, isRead = false;
  for (const KernelPtr &kernel : kernels) {
    if (kernel->arrays().empty())
      continue;
    const KernelFlows &known = kernel->flows();
    for (const ValueFlow &flow : known.flows) {
      isStored |= endsGradients(known.places[flow.to]);
      isRead |= endsGradients(known.places[flow.from]);
    }
  }
  return isStored && isRead;
}

size_t LostGradients::hash(const TapeRecording &recording,
                           bool hasArrays) const {
  size_t hash = 0;
  auto mix = [&](size_t value) { hash = hash * 31 + value; };
  for (const KernelPtr &kernel : recording.kernels())
    mix(std::hash<const void *>()(kernel.get()));
  if (!hasArrays)
    return hash;
  // The hash includes which launches and host writes share arrays, but no
  // addresses, which differ between recordings.
  struct Seen {
    uint64_t end;
    size_t number;
  };
  std::map<uint64_t, Seen> seen;
  auto number = [&](const ArrayRange &array) {
    auto next = seen.upper_bound(array.begin);
    if (next != seen.begin() && std::prev(next)->second.end > array.begin)
      return std::prev(next)->second.number;
    if (next != seen.end() && next->first < array.end)
      return next->second.number;
    return seen.try_emplace(array.begin, Seen{array.end, seen.size()})
        .first->second.number;
  };
  for (const auto &[record, array] : written) {
    mix(record);
    mix(number(array));
  }
  for (const TapeRecording::Record &record : recording)
    if (record.kernel && !record.kernel->arrays().empty())
      for (const FlowPlace &place : record.kernel->flows().places)
        if (place.isArray()) {
          const uint64_t *args = recording.args(record);
          auto copy = copies.find(args[place.slot]);
          mix(std::hash<const void *>()(record.kernel));
          mix(number(copy == copies.end() ? rangeOf(place, args)
                                          : copy->second));
        }
  return hash;
}

bool LostGradients::mayHave(const TapeRecording &recording) {
  return haveSuspectArrays(recording.kernels()) ||
         haveSuspectFields(recording.kernels());
}

void LostGradients::find(const TapeServices &services,
                         const TapeRecording &recording,
                         const std::vector<Field *> &live,
                         std::vector<std::string> &notes) const {
  // A loop of the program records the same sequence again and again, so each
  // sequence is checked once.
  size_t known = hash(recording, haveSuspectArrays(recording.kernels()));
  for (const Field *field : live)
    known = known * 31 + std::hash<const void *>()(field);
  if (!services.isNewSequence(known))
    return;

  FlowTracker tracker(FlowTracker::Mode::Reverse, services.fields());
  for (const auto &[address, array] : copies)
    tracker.addCopy(address, array);
  auto change = written.begin();
  for (size_t i = 0; i < recording.size(); ++i) {
    for (; change != written.end() && change->first <= i; ++change)
      tracker.overwrite(change->second);
    const TapeRecording::Record &record = recording[i];
    if (record.kernel)
      tracker.launch(*record.kernel, recording.args(record));
    else if (record.kind == TapeRecording::Kind::Write &&
             recording.write(record).replacesAll())
      tracker.overwrite(*recording.write(record).field);
  }
  // An adjoint of an array on a device is not read, and counts as wanted.
  FlowTracker::CutSet cuts =
      tracker.cutsOfArrays([&](uint64_t address, uint64_t bytes) {
        const auto *adjoint = reinterpret_cast<const char *>(address);
        return services.owner().devices().isThere(adjoint) ||
               std::any_of(adjoint, adjoint + bytes, [](char c) { return c; });
      });
  auto want = [&](const FlowTracker::CutSet &more) {
    cuts.insert(cuts.end(), more.begin(), more.end());
  };
  want(tracker.cutsOfResults());
  for (const Field *field : live)
    want(tracker.cutsOf(*field));
  // Lost gradients are reported in program order.
  std::sort(cuts.begin(), cuts.end());
  cuts.erase(std::unique(cuts.begin(), cuts.end()), cuts.end());
  for (unsigned cut : cuts)
    if (services.isNewCut(tracker.nameOf(cut)))
      notes.push_back(tracker.describe(cut));
}
