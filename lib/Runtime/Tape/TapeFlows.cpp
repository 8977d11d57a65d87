//===- TapeFlows.cpp - Gradients that end where there is none ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A value that is computed from a field with a gradient, kept in a float field
// or an array without one, and read from there on the way to the loss, passes
// no derivative on. That may be meant, and is said once. The look at the
// records is the second step: most sequences have no kernel that could do so,
// or are made of kernels that have been looked at together.
//
//===----------------------------------------------------------------------===//

#include "../Host/HostWrite.h"
#include "../Launch/FlowTracker.h"
#include "TapeArrays.h"
#include "tai/Runtime/Launch/Runtime.h"
#include "tai/Runtime/Tape/Tape.h"
#include <algorithm>

using namespace mlir::tai::runtime;

/// Whether a derivative by what the field holds ends there, though it could be
/// one.
static bool endsGradients(const Field &field) {
  return isFloat(field.scalar()) && !field.adjoint() && !field.isAdjoint();
}

/// Whether there are fields without gradients that some kernel stores to and
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

/// Whether there are arrays without gradients that some kernel stores to, and
/// such that some kernel reads.
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

size_t Tape::hashSequence(bool hasArrays) const {
  size_t hash = 0;
  auto mix = [&](size_t value) { hash = hash * 31 + value; };
  for (const KernelPtr &kernel : kernels)
    mix(std::hash<const void *>()(kernel.get()));
  if (!hasArrays)
    return hash;
  // Which launches share arrays, wherever these lie, and what the host does.
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
  for (const auto &[record, array] : arrays->written) {
    mix(record);
    mix(number(array));
  }
  for (const Record &record : records)
    if (record.kernel && !record.kernel->arrays().empty())
      for (const FlowPlace &place : record.kernel->flows().places)
        if (place.isArray()) {
          const uint64_t *args = slots.data() + record.payload;
          auto copy = arrays->copies.find(args[place.slot]);
          mix(std::hash<const void *>()(record.kernel));
          mix(number(copy == arrays->copies.end() ? rangeOf(place, args)
                                                  : copy->second));
        }
  return hash;
}

void Tape::noteCuts() {
  bool hasArrays = haveSuspectArrays(kernels);
  if (!hasArrays && !haveSuspectFields(kernels))
    return;
  // The same kernels have been looked at: another iteration.
  std::vector<Field *> live = liveFields();
  size_t known = hashSequence(hasArrays);
  for (const Field *field : live)
    known = known * 31 + std::hash<const void *>()(field);
  if (!runtime.recordings().sequencesSeen.insert(known).second)
    return;

  FlowTracker tracker(FlowTracker::Mode::Reverse, runtime.fields());
  for (const auto &[address, array] : arrays->copies)
    tracker.addCopy(address, array);
  auto written = arrays->written.begin();
  for (size_t i = 0; i < records.size(); ++i) {
    for (; written != arrays->written.end() && written->first <= i; ++written)
      tracker.overwrite(written->second);
    const Record &record = records[i];
    if (record.kernel)
      tracker.launch(*record.kernel, slots.data() + record.payload);
    else if (record.kind == Kind::Write && getWrite(record).replacesAll())
      tracker.overwrite(*getWrite(record).field);
  }
  // What a device holds is not looked at.
  FlowTracker::CutSet cuts =
      tracker.cutsOfArrays([&](uint64_t address, uint64_t bytes) {
        const auto *adjoint = reinterpret_cast<const char *>(address);
        return runtime.isOnDevice(adjoint) ||
               std::any_of(adjoint, adjoint + bytes, [](char c) { return c; });
      });
  auto want = [&](const FlowTracker::CutSet &more) {
    cuts.insert(cuts.end(), more.begin(), more.end());
  };
  want(tracker.cutsOfResults());
  for (const Field *field : live)
    want(tracker.cutsOf(*field));
  // In the order of the program.
  std::sort(cuts.begin(), cuts.end());
  cuts.erase(std::unique(cuts.begin(), cuts.end()), cuts.end());
  for (unsigned cut : cuts)
    if (runtime.recordings().cutsSaid.insert(tracker.nameOf(cut)).second)
      notes.push_back(tracker.describe(cut));
}

void Tape::noteArrayCopy(uint64_t address, const ArrayRange &array) {
  arrays->copies[address] = array;
}

void Tape::noteArrayWrite(const ArrayRange &array) {
  arrays->written.emplace_back(records.size(), array);
}
