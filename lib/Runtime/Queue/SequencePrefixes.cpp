//===- SequencePrefixes.cpp - Launches before sequences -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "SequencePrefixes.h"
#include <algorithm>
#include <chrono>
#include <cstdlib>

using namespace mlir::tai::runtime;

static int64_t now() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

SequencePrefixes::SequencePrefixes() {
  // Launches are deferred so briefly that an idle device loses at most this
  // time.
  constexpr int64_t usualUs = 100;
  const char *given = std::getenv("TAI_KEEP_LAUNCHES_US");
  longestNs = 1000 * (given && *given ? std::atoll(given) : usualUs);
}

bool SequencePrefixes::expects(const DeviceFunction *function,
                               const LaunchShape &shape, int count) {
  if (!open)
    return false;
  if (run.size() == kMostLaunches || ++between > kMostBetween) {
    interrupt();
    open = false;
    return false;
  }
  if (run.empty()) {
    start = now();
    auto found = prefixes.find(function);
    expected = found != prefixes.end() && found->second.isKnown()
                   ? &found->second
                   : nullptr;
  }
  Item item{function, shape.blocks, shape.threads, count};
  if (expected && (run.size() == expected->items.size() ||
                   !(expected->items[run.size()] == item)))
    lose();
  run.push_back(item);
  return expected != nullptr;
}

/// Notes that no known sequence has followed the deferred launches, which are
/// now queued alone.
void SequencePrefixes::lose() {
  constexpr int mostLost = 2, mostWanted = 64;
  if (expected && !run.empty()) {
    ++numLost;
    if (++expected->lost == mostLost) {
      expected->seen = expected->lost = 0;
      expected->wanted = std::min(2 * expected->wanted, mostWanted);
      count();
    }
  }
  expected = nullptr;
}

void SequencePrefixes::count() {
  numKnown = static_cast<size_t>(
      std::count_if(prefixes.begin(), prefixes.end(),
                    [](const auto &entry) { return entry.second.isKnown(); }));
}

void SequencePrefixes::interrupt() {
  lose();
  run.clear();
}

void SequencePrefixes::begin() {
  constexpr size_t mostPrefixes = 64;
  open = false;
  if (run.empty())
    return;
  bool isQuick = now() - start <= longestNs;
  numTaken += expected != nullptr;
  expected = nullptr;
  if (prefixes.size() >= mostPrefixes)
    prefixes.clear();
  Prefix &prefix = prefixes[run.front().function];
  if (prefix.items != run) {
    prefix.items = run;
    prefix.seen = 0;
  }
  prefix.seen = isQuick ? std::min(prefix.seen + 1, prefix.wanted) : 0;
  prefix.lost = 0;
  count();
  run.clear();
}

void SequencePrefixes::end(bool isWorthIt) {
  interrupt();
  open = isWorthIt;
  between = 0;
}

std::string SequencePrefixes::explain() const {
  if (numTaken + numLost == 0)
    return "";
  return "launches between replays: " + std::to_string(numTaken) +
         " times part of the replay that followed, " + std::to_string(numLost) +
         " times kept for nothing\n";
}
