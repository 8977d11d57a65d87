//===- FlowTracker.cpp - Ends of derivatives ------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/FlowTracker.h"
#include <algorithm>
#include <cstring>
#include <numeric>

using namespace mlir::tai::runtime;

bool ArrayRange::overlaps(const ArrayRange &other) const {
  if (begin >= other.end || other.begin >= end)
    return false;
  // The columns of a matrix are interleaved in memory: their address ranges
  // overlap, and yet they may have no element in common.
  uint64_t common = std::gcd(step, other.step);
  uint64_t apart = (begin % common + common - other.begin % common) % common;
  return apart < other.elementBytes || apart + elementBytes > common;
}

/// Adds the cuts (stores at which derivatives were lost) of one set to another;
/// returns true if there were new ones.
static bool addCuts(FlowTracker::CutSet &to, const FlowTracker::CutSet &more) {
  if (std::includes(to.begin(), to.end(), more.begin(), more.end()))
    return false;
  FlowTracker::CutSet all;
  std::set_union(to.begin(), to.end(), more.begin(), more.end(),
                 std::back_inserter(all));
  to = std::move(all);
  return true;
}

bool FlowTracker::State::add(const State &more) {
  bool isNew = more.isActive && !isActive;
  isActive |= more.isActive;
  return addCuts(cuts, more.cuts) || isNew;
}

FlowTracker::FlowTracker(Mode mode, const std::vector<FieldPtr> &fields)
    : mode(mode) {
  for (const FieldPtr &field : fields)
    for (const Field *companion : {field->adjoint(), field->dual()})
      if (companion)
        companions.insert(companion);
}

void FlowTracker::addSource(const Field &field) {
  ofFields[&field].isActive = true;
  ++version;
}

//===----------------------------------------------------------------------===//
// Places
//===----------------------------------------------------------------------===//

bool FlowTracker::isIgnored(const FlowPlace &place) const {
  return place.field && companions.count(place.field.get());
}

bool FlowTracker::hasDerivative(const FlowPlace &place) const {
  if (!place.field)
    return mode == Mode::Reverse && place.hasGradient;
  return mode == Mode::Reverse ? place.field->adjoint() : place.field->dual();
}

bool FlowTracker::endsDerivatives(const FlowPlace &place) const {
  if (place.field)
    return isFloat(place.field->scalar()) && !hasDerivative(place);
  // Values lose their gradients at an array without one. Only reverse mode
  // warns of this; forward mode refuses such arrays.
  return place.isArray() && mode == Mode::Reverse && !place.hasGradient;
}

ArrayRange FlowTracker::findRange(const FlowPlace &place,
                                  const uint64_t *args) const {
  auto copy = copies.find(args[place.slot]);
  return copy == copies.end() ? rangeOf(place, args) : copy->second;
}

FlowTracker::State FlowTracker::stateOf(const FlowPlace &place,
                                        const uint64_t *args) const {
  State state;
  if (place.field) {
    auto found = ofFields.find(place.field.get());
    return found == ofFields.end() ? state : found->second;
  }
  if (!place.isArray() || ofArrays.empty())
    return state;
  ArrayRange range = findRange(place, args);
  auto it = ofArrays.lower_bound(range.begin - std::min(range.begin, longest));
  for (; it != ofArrays.end() && it->first < range.end; ++it)
    if (it->second.range.overlaps(range))
      state.add(it->second.state);
  return state;
}

void FlowTracker::overwrite(const Field &field) {
  version += ofFields.erase(&field);
}

void FlowTracker::overwrite(const ArrayRange &range) {
  for (auto it = ofArrays.lower_bound(range.begin);
       it != ofArrays.end() && it->first < range.end;) {
    const ArrayRange &known = it->second.range;
    bool isSame = known.begin == range.begin && known.end == range.end &&
                  known.step == range.step;
    if (!isSame && !range.holds(known)) {
      ++it;
      continue;
    }
    it = ofArrays.erase(it);
    ++version;
  }
}

void FlowTracker::store(const FlowPlace &place, const uint64_t *args,
                        const State &added, bool replaces) {
  if (place.field) {
    if (replaces) {
      auto known = ofFields.find(place.field.get());
      bool isSame = known == ofFields.end()
                        ? added.empty()
                        : known->second.isActive == added.isActive &&
                              known->second.cuts == added.cuts;
      if (isSame)
        return;
      ofFields.erase(place.field.get());
      ++version;
    }
    if (!added.empty())
      version += ofFields[place.field.get()].add(added);
    return;
  }
  if (place.isResult || !place.isArray())
    return;
  ArrayRange range = findRange(place, args);
  if (replaces)
    overwrite(range);
  if (added.empty() || range.begin == range.end)
    return;
  longest = std::max(longest, range.end - range.begin);
  auto [first, last] = ofArrays.equal_range(range.begin);
  auto it = std::find_if(first, last, [&](const auto &entry) {
    const ArrayRange &known = entry.second.range;
    return known.end == range.end && known.step == range.step;
  });
  if (it == last)
    it = ofArrays.insert({range.begin, {range, 0, {}}});
  if (place.adjointSlot >= 0)
    it->second.adjoint = args[place.adjointSlot];
  version += it->second.state.add(added);
}

//===----------------------------------------------------------------------===//
// Launches
//===----------------------------------------------------------------------===//

/// True if a launch with the arguments `args` stores all elements with indices
/// from first(d) up to first(d) + extent(d) in each dimension d.
template <typename First, typename Extent>
static bool storesAll(const std::vector<StoredBox> &boxes, const uint64_t *args,
                      const First &first, const Extent &extent) {
  return std::any_of(boxes.begin(), boxes.end(), [&](const StoredBox &box) {
    for (const StoredBox::Range &loop : box.loops)
      if (loop.lower.evaluate(args) >= loop.upper.evaluate(args))
        return false;
    for (size_t d = 0; d < box.ranges.size(); ++d)
      if (box.ranges[d].lower.evaluate(args) > first(d) ||
          box.ranges[d].upper.evaluate(args) < first(d) + extent(d))
        return false;
    return true;
  });
}

/// True if a launch stores all elements of a field or array, whatever they
/// held.
static bool replaces(const Kernel &kernel, const FlowPlace &place,
                     const uint64_t *args) {
  if (place.isArray())
    return storesAll(
        place.boxes, args, [](size_t) { return int64_t(0); },
        [&](size_t d) {
          return static_cast<int64_t>(args[place.slot + 1 + d]);
        });
  const Field *field = place.field.get();
  return std::any_of(
      kernel.summary().begin(), kernel.summary().end(),
      [&](const Access &access) {
        return access.field.get() == field &&
               access.kind == AccessKind::Write && access.boxes &&
               storesAll(
                   *access.boxes, args,
                   [&](size_t d) {
                     return field->firstIndex(static_cast<int64_t>(d));
                   },
                   [&](size_t d) { return field->shape()[d]; });
      });
}

bool FlowTracker::dependsOnArguments(Kernel &kernel) const {
  const std::vector<FlowPlace> &places = kernel.flows().places;
  auto hasTerms = [](const StoredBox::Range &range) {
    return !range.lower.terms.empty() || !range.upper.terms.empty();
  };
  return std::any_of(
             places.begin(), places.end(),
             [](const FlowPlace &p) { return p.isArray() || p.isResult; }) ||
         std::any_of(kernel.summary().begin(), kernel.summary().end(),
                     [&](const Access &access) {
                       return access.boxes &&
                              std::any_of(
                                  access.boxes->begin(), access.boxes->end(),
                                  [&](const StoredBox &box) {
                                    return std::any_of(box.ranges.begin(),
                                                       box.ranges.end(),
                                                       hasTerms) ||
                                           !box.loops.empty();
                                  });
                     });
}

/// True if the adjoint of some result of the launch is not zero.
static bool hasWantedResult(const Kernel &kernel, const uint64_t *args) {
  const CallerAdjoints &caller = kernel.callerAdjoints();
  return std::any_of(caller.results.begin(), caller.results.end(),
                     [&](const CallerAdjoints::Result &result) {
                       const auto *bytes = reinterpret_cast<const char *>(
                           args[kernel.argSlots() + result.slot]);
                       return std::any_of(bytes, bytes + result.bytes,
                                          [](char c) { return c; });
                     });
}

void FlowTracker::launch(Kernel &kernel, const uint64_t *args) {
  auto [known, isNew] = kernels.try_emplace(&kernel);
  Known &memory = known->second;
  if (isNew)
    memory.dependsOnArguments = dependsOnArguments(kernel);
  else if (!memory.dependsOnArguments && memory.version == version)
    return;
  const KernelFlows &all = kernel.flows();
  std::vector<State> before, added(all.places.size()), again(all.places.size());
  for (const FlowPlace &place : all.places)
    before.push_back(stateOf(place, args));
  // A launch may read a value that it has just stored, so states are passed
  // along the flows of values until no state changes.
  for (bool grown = true; grown;) {
    grown = false;
    for (const ValueFlow &flow : all.flows) {
      const FlowPlace &from = all.places[flow.from], &to = all.places[flow.to];
      if (isIgnored(from) || isIgnored(to))
        continue;
      State state = before[flow.from];
      state.add(again[flow.from]);
      bool isSource =
          hasDerivative(from) && (mode == Mode::Reverse || state.isActive);
      if (endsDerivatives(to) && (isSource || !state.cuts.empty()))
        addCuts(state.cuts, {number(kernel, all, flow)});
      state.isActive &= hasDerivative(to);
      grown |= added[flow.to].add(state);
      if (flow.isReadAgain)
        grown |= again[flow.to].add(state);
    }
  }
  for (size_t i = 0; i < all.places.size(); ++i) {
    const FlowPlace &place = all.places[i];
    if (place.isResult) {
      if (mode == Mode::Reverse && !added[i].cuts.empty() &&
          hasWantedResult(kernel, args))
        addCuts(fromResults, added[i].cuts);
    } else if (!added[i].empty() || !before[i].empty()) {
      store(place, args, added[i], replaces(kernel, place, args));
    }
  }
  memory.version = version;
}

//===----------------------------------------------------------------------===//
// Results
//===----------------------------------------------------------------------===//

const FlowTracker::CutSet &FlowTracker::cutsOf(const Field &field) const {
  static const CutSet none;
  auto found = ofFields.find(&field);
  return found == ofFields.end() ? none : found->second.cuts;
}

FlowTracker::CutSet FlowTracker::cutsOfArrays(const Wants &isWanted) const {
  CutSet all;
  for (const auto &[begin, array] : ofArrays)
    if (array.adjoint && !array.state.cuts.empty() &&
        isWanted(array.adjoint, array.range.end - array.range.begin))
      addCuts(all, array.state.cuts);
  return all;
}

unsigned FlowTracker::number(const Kernel &kernel, const KernelFlows &known,
                             const ValueFlow &flow) {
  const FlowPlace &from = known.places[flow.from], &to = known.places[flow.to];
  auto [entry, isNew] =
      cutNumbers.try_emplace({kernel.name(), to.name}, cuts.size());
  if (isNew)
    cuts.push_back({kernel.name(), flow.place, from.name, to.name,
                    hasDerivative(from), to.isArray()});
  return entry->second;
}

std::string FlowTracker::nameOf(unsigned cut) const {
  return cuts[cut].kernel + '\n' + cuts[cut].toName;
}

std::string FlowTracker::describe(unsigned cut) const {
  const Cut &found = cuts[cut];
  bool isReverse = mode == Mode::Reverse;
  std::string what = isReverse ? "gradient" : "dual";
  std::string line = found.line.empty() ? "" : found.line + ": ";
  line +=
      "kernel '" + found.kernel + "' stores to the " +
      (found.isToArray ? "array '" : "field '") + found.toName +
      "' what depends on '" + found.fromName +
      (found.isFromSource ? "', which has a " + what
                          : "', and so on a field that has a " + what) +
      ", and the loss depends on it; but '" + found.toName + "' has " +
      (isReverse ? "none" : "no dual") +
      ", so that the derivative ends there; give it one (" +
      (isReverse ? "needs_grad=True" : "needs_dual=True") +
      (found.isToArray ? " of a ti.ndarray, requires_grad of a tensor" : "") +
      "), or store ti.stop_grad(…) to say that it is meant";
  return line;
}
