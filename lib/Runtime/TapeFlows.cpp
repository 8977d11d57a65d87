//===- TapeFlows.cpp - Gradients that end in a field without one ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A value that is computed from a field with a gradient, kept in a float field
// without one, and read from there on the way to the loss, passes no derivative
// on. That may be meant, and is said once. The look at the records is the
// second step: most sequences have no kernel that could do so, or are made of
// kernels that have been looked at together.
//
//===----------------------------------------------------------------------===//

#include "HostWrite.h"
#include "tai/Runtime/Runtime.h"
#include "tai/Runtime/Tape.h"
#include <algorithm>
#include <unordered_set>

using namespace mlir::tai::runtime;

using Fields = std::unordered_set<const Field *>;

/// Whether a derivative by what the field holds ends there, though it could be
/// one.
static bool endsGradients(const Field &field) {
  return isFloat(field.scalar()) && !field.adjoint() && !field.isAdjoint();
}

/// Fields without gradients that some kernel stores to and some kernel reads.
static bool haveSuspects(const std::vector<KernelPtr> &kernels) {
  Fields stored;
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

/// Whether a launch stores all elements of a field, none of them from what they
/// held.
static bool replaces(const Kernel &kernel, const Field &field,
                     const uint64_t *args) {
  for (const Access &access : kernel.summary()) {
    if (access.field.get() != &field || access.kind != AccessKind::Write ||
        !access.boxes)
      continue;
    for (const StoredBox &box : *access.boxes) {
      bool isWhole = true;
      for (const StoredBox::Range &loop : box.loops)
        isWhole &= loop.lower.evaluate(args) < loop.upper.evaluate(args);
      for (size_t d = 0; d < box.ranges.size() && isWhole; ++d) {
        int64_t first = field.firstIndex(static_cast<int64_t>(d));
        isWhole =
            box.ranges[d].lower.evaluate(args) <= first &&
            box.ranges[d].upper.evaluate(args) >= first + field.shape()[d];
      }
      if (isWhole)
        return true;
    }
  }
  return false;
}

static std::string describeCut(const std::string &kernel,
                               const ValueFlow &flow) {
  const std::string &to = flow.to->name();
  std::string line = flow.place.empty() ? "" : flow.place + ": ";
  line += "kernel '" + kernel + "' stores to the field '" + to +
          "' what depends on '" + flow.from->name() +
          (flow.from->adjoint() ? "', which has a gradient"
                                : "', and so on a field that has a gradient") +
          ", and the loss depends on it; but '" + to +
          "' has none, so that the derivative ends there; give it one "
          "(needs_grad=True), or store ti.stop_grad(…) to say that it is meant";
  return line;
}

void Tape::noteCuts() {
  if (kernels.empty() || !haveSuspects(kernels))
    return;
  // The same kernels have been looked at: another iteration.
  std::vector<Field *> live = liveFields();
  size_t known = live.size();
  auto mix = [&](const void *pointer) {
    known = known * 31 + std::hash<const void *>()(pointer);
  };
  for (const KernelPtr &kernel : kernels)
    mix(kernel.get());
  for (const Field *field : live)
    mix(field);
  if (!runtime.sequencesSeen.insert(known).second)
    return;
  std::vector<Cut> cuts = findCuts();
  if (cuts.empty())
    return;
  std::vector<std::string> lines;
  for (const Cut &cut : keepWanted(std::move(cuts), live)) {
    const std::string &kernel = records[cut.record].kernel->name();
    const std::string &field = cut.flow->to->name();
    if (runtime.cutsSaid.insert(kernel + '\n' + field).second)
      lines.push_back(describeCut(kernel, *cut.flow));
  }
  // In the order of the program.
  notes.insert(notes.end(), lines.rbegin(), lines.rend());
}

/// Whether the host replaces all of a field.
static bool replaces(const HostWrite &write) {
  return write.what != HostWrite::What::Element;
}

/// What records store, in fields that end gradients, of values that depend on
/// fields with gradients.
std::vector<Tape::Cut> Tape::findCuts() {
  std::vector<Cut> cuts;
  Fields carriers;
  auto isCut = [&](const ValueFlow &flow) {
    return endsGradients(*flow.to) &&
           (flow.from->adjoint() || carriers.count(flow.from.get()));
  };
  for (size_t i = 0; i < records.size(); ++i) {
    Kernel *kernel = records[i].kernel;
    if (records[i].kind == Kind::Write && replaces(getWrite(records[i])))
      carriers.erase(getWrite(records[i]).field);
    if (!kernel)
      continue;
    // A kernel may go on with what it has just stored.
    const std::vector<ValueFlow> &flows = kernel->flows();
    Fields reached;
    for (bool grown = true; grown;) {
      grown = false;
      for (const ValueFlow &flow : flows)
        if (isCut(flow)) {
          reached.insert(flow.to.get());
          grown |= carriers.insert(flow.to.get()).second;
        }
    }
    for (const ValueFlow &flow : flows)
      if (isCut(flow))
        cuts.push_back({i, &flow});
    for (const Access &access : kernel->summary())
      if (carriers.count(access.field.get()) &&
          !reached.count(access.field.get()) &&
          replaces(*kernel, *access.field, slots.data() + records[i].payload))
        carriers.erase(access.field.get());
  }
  return cuts;
}

/// Those of them on which the live fields depend, the last one first.
std::vector<Tape::Cut> Tape::keepWanted(std::vector<Cut> cuts,
                                        const std::vector<Field *> &live) {
  std::vector<Cut> found;
  Fields after(live.begin(), live.end());
  for (size_t i = records.size(); i-- > 0;) {
    Kernel *kernel = records[i].kernel;
    if (records[i].kind == Kind::Write && replaces(getWrite(records[i])))
      after.erase(getWrite(records[i]).field);
    if (!kernel)
      continue;
    const std::vector<ValueFlow> &flows = kernel->flows();
    const CallerAdjoints &caller = kernel->callerAdjoints();
    const uint64_t *args = slots.data() + records[i].payload;
    Fields reads;
    if (!caller.results.empty() && !caller.areZero(args + kernel->argSlots()))
      for (const Access &access : kernel->summary())
        if (access.kind == AccessKind::Read)
          reads.insert(access.field.get());
    for (bool grown = true; grown;) {
      grown = false;
      for (const ValueFlow &flow : flows)
        if (after.count(flow.to.get()) || reads.count(flow.to.get()))
          grown |= reads.insert(flow.from.get()).second;
    }
    for (; !cuts.empty() && cuts.back().record == i; cuts.pop_back()) {
      const ValueFlow &flow = *cuts.back().flow;
      if (after.count(flow.to.get()) ||
          (flow.isReadAgain && reads.count(flow.to.get())))
        found.push_back(cuts.back());
    }
    for (const Access &access : kernel->summary())
      if (after.count(access.field.get()) &&
          replaces(*kernel, *access.field, args))
        after.erase(access.field.get());
    after.insert(reads.begin(), reads.end());
  }
  return found;
}
