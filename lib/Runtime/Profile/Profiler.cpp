//===- Profiler.cpp - Times of kernels and device work --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Profile/Profiler.h"
#include <algorithm>

using namespace mlir::tai::runtime;

Profiler::Item Profiler::find(ProfileKind kind, const std::string &name,
                              const std::string &place) {
  std::lock_guard<std::mutex> lock(mutex);
  auto [entry, isNew] = known.emplace(std::make_pair(kind, name), items.size());
  if (isNew) {
    ProfileRow row;
    row.kernel = name;
    row.kind = kind;
    items.push_back(std::move(row));
  }
  if (!place.empty())
    items[entry->second].place = place;
  return entry->second;
}

void Profiler::noteBytes(const std::vector<std::string> &functions,
                         int64_t bytes) {
  std::lock_guard<std::mutex> lock(mutex);
  for (const std::string &function : functions)
    bytesOf[function] = functions.size() == 1 ? bytes : -1;
}

void Profiler::noteFacts(Item item, const DeviceFunctionFacts &facts,
                         const LaunchShape &shape, double occupancy) {
  std::lock_guard<std::mutex> lock(mutex);
  ProfileRow &row = items[item];
  row.facts = facts;
  row.blocks = shape.blocks;
  row.threads = shape.threads;
  row.occupancy = occupancy;
}

void Profiler::keepLocked(Item item, const TraceEvent &event) {
  if (kept.size() >= mostEvents) {
    ++lostEvents;
    return;
  }
  kept.push_back(event);
  kept.back().row = &items[item];
}

void Profiler::count(Item item, const TraceEvent &event) {
  std::lock_guard<std::mutex> lock(mutex);
  items[item].times.add(event.durationNs);
  keepLocked(item, event);
}

void Profiler::keep(Item item, const TraceEvent &event) {
  std::lock_guard<std::mutex> lock(mutex);
  keepLocked(item, event);
}

int Profiler::thread() {
  std::lock_guard<std::mutex> lock(mutex);
  return threads
      .emplace(std::this_thread::get_id(), static_cast<int>(threads.size()))
      .first->second;
}

std::vector<ProfileRow> Profiler::rows() const {
  std::vector<ProfileRow> result;
  {
    std::lock_guard<std::mutex> lock(mutex);
    for (const ProfileRow &item : items) {
      if (!item.times.launches)
        continue;
      result.push_back(item);
      auto bytes = bytesOf.find(item.kernel);
      if (item.kind != ProfileKind::Memory && bytes != bytesOf.end())
        result.back().bytes = bytes->second;
    }
  }
  std::sort(result.begin(), result.end(),
            [](const ProfileRow &a, const ProfileRow &b) {
              return a.times.totalNs != b.times.totalNs
                         ? a.times.totalNs > b.times.totalNs
                         : a.kernel < b.kernel;
            });
  return result;
}

std::vector<TraceEvent> Profiler::events(int64_t &lost) const {
  std::lock_guard<std::mutex> lock(mutex);
  lost = lostEvents;
  return kept;
}

void Profiler::clear() {
  std::lock_guard<std::mutex> lock(mutex);
  for (ProfileRow &item : items)
    item.times = KernelTimes();
  kept.clear();
  lostEvents = 0;
}
