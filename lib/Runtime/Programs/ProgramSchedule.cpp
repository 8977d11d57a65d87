//===- ProgramSchedule.cpp - Order and barriers of steps ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// In a program every thread executes all steps, so no barrier is needed before
// a step that accesses other memory than the steps before it, or if each thread
// accesses only memory that it has accessed before. Steps are grouped, with
// barriers between groups. Each step goes into the earliest possible group, so
// that independent steps from later in the sequence fill gaps.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Programs/ProgramSchedule.h"
#include <algorithm>
#include <cmath>
#include <numeric>

using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Memory of a step
//===----------------------------------------------------------------------===//

/// Makes a map from iterations to addresses. Merges dimensions that are
/// adjacent in memory, and drops dimensions of extent 1.
static Footprint::Map makeMap(const std::vector<int64_t> &extents,
                              const std::vector<int64_t> &strides) {
  Footprint::Map map;
  for (size_t d = extents.size(); d-- > 0;) {
    int64_t extent = extents[d], stride = strides[d];
    if (extent == 1)
      continue;
    if (!map.empty() && map.back().first * map.back().second == stride)
      map.back().first *= extent;
    else
      map.emplace_back(extent, stride);
  }
  return map;
}

Footprint::Footprint(const FunctionAccesses &accesses) {
  const std::vector<int64_t> &extents = accesses.extents;
  bool isKnown = std::all_of(extents.begin(), extents.end(),
                             [](int64_t extent) { return extent >= 0; });
  isSingle = isKnown && accesses.isGridStride &&
             std::all_of(extents.begin(), extents.end(),
                         [](int64_t extent) { return extent <= 1; });
  for (const DeviceAccess &access : accesses.accesses) {
    Line line{access, 0, 0, {}};
    for (size_t d = 0; isKnown && d < extents.size(); ++d) {
      int64_t reach = access.strides[d] * std::max<int64_t>(extents[d] - 1, 0);
      line.low += std::min<int64_t>(reach, 0);
      line.high += std::max<int64_t>(reach, 0);
    }
    if (isKnown && accesses.isGridStride)
      line.map = makeMap(extents, access.strides);
    lines.push_back(std::move(line));
  }
}

StepMemory StepMemory::ofLaunch(const Footprint *footprint,
                                const uint64_t *slots, size_t numSlots) {
  StepMemory memory;
  if (!footprint)
    return memory;
  memory.isSingle = footprint->isSingle;
  memory.reads.reserve(footprint->lines.size());
  auto has = [&](int64_t slot) {
    return slot >= 0 && static_cast<size_t>(slot) < numSlots;
  };
  for (const Footprint::Line &line : footprint->lines) {
    const DeviceAccess &access = line.access;
    if (!has(access.slot))
      return StepMemory();
    uint64_t first = slots[access.slot] + static_cast<uint64_t>(access.offset);
    double sum = std::abs(double(access.offset)) + double(line.high) -
                 double(line.low) + double(access.window);
    for (const LaunchTerm &term : access.terms) {
      if (!has(term.slot) || term.bits < 1 || term.bits > 64)
        return StepMemory();
      int64_t value = term.getArgument(slots);
      first +=
          static_cast<uint64_t>(value) * static_cast<uint64_t>(term.factor);
      sum += std::abs(double(value) * double(term.factor));
    }
    if (access.unit != 0 && sum >= 0x1p30 * double(access.unit))
      return StepMemory();
    memory.add(Piece{static_cast<DeviceAccess::Kind>(access.kind), first,
                     first + static_cast<uint64_t>(line.low),
                     first + static_cast<uint64_t>(line.high + access.window),
                     access.window, access.step, access.size,
                     line.map.empty() ? nullptr : &line.map});
  }
  memory.isKnown = true;
  return memory;
}

void StepMemory::add(DeviceAccess::Kind kind, uint64_t begin, uint64_t bytes) {
  auto window = static_cast<int64_t>(bytes);
  add(Piece{kind, begin, begin, begin + bytes, window, 1, 1, nullptr});
  isKnown = true;
}

void StepMemory::addRows(DeviceAccess::Kind kind, uint64_t begin, uint64_t step,
                         uint64_t rowBytes, uint64_t rows) {
  uint64_t bytes = rows == 0 ? 0 : step * (rows - 1) + rowBytes;
  add(Piece{kind, begin, begin, begin + bytes, static_cast<int64_t>(bytes),
            static_cast<int64_t>(step), static_cast<int64_t>(rowBytes),
            nullptr});
  isKnown = true;
}

void StepMemory::addNumbers(DeviceAccess::Kind kind, uint64_t begin,
                            int64_t bytes, int64_t count) {
  ownMap =
      std::make_shared<Footprint::Map>(Footprint::Map{std::pair(count, bytes)});
  add(Piece{kind, begin, begin, begin + static_cast<uint64_t>(bytes * count),
            bytes, bytes, bytes, ownMap.get()});
  isKnown = true;
}

//===----------------------------------------------------------------------===//
// Two steps
//===----------------------------------------------------------------------===//

bool mlir::tai::runtime::liesBetween(int64_t distance, int64_t bytes,
                                     int64_t size, int64_t step) {
  if (step <= 0)
    return false;
  distance %= step;
  if (distance < 0)
    distance += step;
  return distance >= size && bytes <= step - distance;
}

/// True if all elements of one memory piece lie between elements of the other,
/// as the elements of fields that share cells do.
static bool areInterleaved(const StepMemory::Piece &a,
                           const StepMemory::Piece &b) {
  return liesBetween(static_cast<int64_t>(b.first - a.first), b.size, a.size,
                     std::gcd(a.step, b.step));
}

/// True if all of one memory piece lies between two elements of the other, as
/// numbers lie between rows of gradients that are zeroed.
static bool liesBetween(const StepMemory::Piece &a,
                        const StepMemory::Piece &b) {
  return liesBetween(static_cast<int64_t>(a.begin - b.first),
                     static_cast<int64_t>(a.end - a.begin), b.size, b.step);
}

/// True if the two memory pieces are divided among iterations alike: each byte
/// is accessed by the same iteration in both, and by no other.
static bool haveSameThreads(const StepMemory::Piece &a,
                            const StepMemory::Piece &b) {
  if (!a.map || !b.map || a.map->size() != b.map->size())
    return false;
  // The two maps from iterations to addresses may differ only in the extents of
  // their outermost digits (parts of the iteration number).
  for (size_t i = 0; i < a.map->size(); ++i)
    if ((*a.map)[i].second != (*b.map)[i].second ||
        (i + 1 < a.map->size() && (*a.map)[i].first != (*b.map)[i].first))
      return false;
  uint64_t first = std::min(a.first, b.first);
  auto width =
      static_cast<int64_t>(std::max(a.first + static_cast<uint64_t>(a.window),
                                    b.first + static_cast<uint64_t>(b.window)) -
                           first);
  // Iterations access different bytes if each stride exceeds the width of all
  // dimensions with smaller strides together.
  for (size_t i = 0; i < a.map->size(); ++i) {
    auto [extent, stride] = (*a.map)[i];
    if (stride < width)
      return false;
    width += stride * (extent - 1);
  }
  return true;
}

static StepRelation getRelation(const StepMemory::Piece &a,
                                const StepMemory::Piece &b) {
  if ((a.kind == b.kind && a.kind != DeviceAccess::Write) || a.end <= b.begin ||
      b.end <= a.begin || areInterleaved(a, b) || liesBetween(a, b) ||
      liesBetween(b, a))
    return StepRelation::None;
  return haveSameThreads(a, b) ? StepRelation::SameThread
                               : StepRelation::Barrier;
}

StepRelation mlir::tai::runtime::getRelation(const StepMemory &a,
                                             const StepMemory &b) {
  if (!a.isKnown || !b.isKnown)
    return StepRelation::Barrier;
  StepRelation most = a.isSingle && b.isSingle ? StepRelation::SameThread
                                               : StepRelation::Barrier;
  StepRelation result = StepRelation::None;
  // Compares all pairs of memory pieces, and raises `result` to the strongest
  // relation; returns true once it is `most`, which ends the search.
  auto compare = [&](const std::vector<StepMemory::Piece> &ones,
                     const std::vector<StepMemory::Piece> &others) {
    for (const StepMemory::Piece &one : ones)
      for (const StepMemory::Piece &other : others) {
        // Memory pieces whose address ranges lie apart, as most do, are
        // skipped.
        if (one.end <= other.begin || other.end <= one.begin)
          continue;
        result = std::max(result, std::min(most, ::getRelation(one, other)));
        if (result == most)
          return true;
      }
    return false;
  };
  (void)(compare(a.changes, b.changes) || compare(a.changes, b.reads) ||
         compare(a.reads, b.changes));
  return result;
}

//===----------------------------------------------------------------------===//
// All steps
//===----------------------------------------------------------------------===//

ProgramSchedule::ProgramSchedule(const std::vector<StepMemory> &steps) {
  // The maximum number of groups, and of steps, past which a step is moved.
  constexpr size_t mostGroups = 12, mostSteps = 192;
  std::vector<std::vector<uint32_t>> groups;
  for (uint32_t i = 0; i < steps.size(); ++i) {
    size_t place = groups.size(), seen = 0;
    for (size_t g = groups.size();
         g-- > 0 && groups.size() - g <= mostGroups && seen <= mostSteps;) {
      StepRelation relation = StepRelation::None;
      for (uint32_t other : groups[g]) {
        relation = std::max(relation, getRelation(steps[other], steps[i]));
        if (relation == StepRelation::Barrier)
          break;
      }
      seen += groups[g].size();
      if (relation == StepRelation::Barrier)
        break;
      place = g;
      if (relation == StepRelation::SameThread)
        break;
    }
    if (place == groups.size())
      groups.emplace_back();
    groups[place].push_back(i);
  }
  for (const std::vector<uint32_t> &group : groups)
    for (uint32_t step : group) {
      order.push_back(step);
      waits.push_back(step == group.back());
    }
  // There is no barrier after the last group of steps.
  numBarriers = groups.empty() ? 0 : groups.size() - 1;
}
