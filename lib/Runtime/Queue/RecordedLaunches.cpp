//===- RecordedLaunches.cpp - Repeated recordings -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "RecordedLaunches.h"
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>

using namespace mlir::tai::runtime;

/// The maximum number of known recordings, and of launches in each.
static constexpr size_t mostKnown = 8, mostLaunches = 1 << 18;

int64_t RecordedLaunches::now() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

RecordedLaunches::RecordedLaunches() {
  const char *given = std::getenv("TAI_COLLECT_RECORDINGS");
  if (given && *given)
    wish = *given == '0' ? Wish::Never : Wish::Always;
}

void RecordedLaunches::begin() {
  run.clear();
  collects = false;
  expected = running = nullptr;
}

void RecordedLaunches::end() {
  (void)interrupt(/*isEnd=*/true);
  running = nullptr;
}

bool RecordedLaunches::areAnyKnown() const {
  return std::any_of(known.begin(), known.end(),
                     [](const auto &entry) { return entry->isLikely(); });
}

//===----------------------------------------------------------------------===//
// Recognition
//===----------------------------------------------------------------------===//

/// Returns a known recording that begins with the collected launches and
/// `next`; null if there is none.
RecordedLaunches::Known *RecordedLaunches::findLonger(const Item &next) const {
  for (size_t i = known.size(); i-- > 0;) {
    const std::vector<Item> &items = known[i]->items;
    if (known[i]->isLikely() && items.size() > run.size() &&
        items[run.size()] == next &&
        std::equal(run.begin(), run.end(), items.begin()))
      return known[i].get();
  }
  return nullptr;
}

/// Returns the known recording that equals the collected launches, or null.
RecordedLaunches::Known *RecordedLaunches::findWhole() const {
  if (expected && expected->items.size() == run.size())
    return expected;
  for (const std::unique_ptr<Known> &entry : known)
    if (entry->isLikely() && entry->items == run)
      return entry.get();
  return nullptr;
}

bool RecordedLaunches::expects(const Item &item) {
  if (wish == Wish::Never)
    return false;
  if (run.empty()) {
    expected = findLonger(item);
    collects = expected != nullptr;
    start = now();
  } else if (collects) {
    bool isNext = run.size() < expected->items.size() &&
                  expected->items[run.size()] == item;
    if (__builtin_expect(!isNext, false)) {
      Known *longer = findLonger(item);
      if (!longer)
        lose(*expected);
      expected = longer;
      collects = longer != nullptr;
    }
  }
  // One item more than the maximum is kept, which marks the run of launches as
  // too long.
  if (run.size() <= mostLaunches)
    run.push_back(item);
  return collects;
}

bool RecordedLaunches::interrupt(bool isEnd) {
  if (run.empty())
    return false;
  running = nullptr;
  if (collects) {
    running = findWhole();
    if (running)
      running->collectNs = now() - start;
    else
      lose(*expected);
  }
  if (!running)
    learn(isEnd);
  run.clear();
  collects = false;
  expected = nullptr;
  return running != nullptr;
}

void RecordedLaunches::learn(bool isEnd) {
  // Fewer launches than this, without a reverse sweep, are not worth a graph.
  constexpr size_t fewest = 4;
  if (run.size() > mostLaunches || (run.size() < fewest && !isEnd))
    return;
  auto found = std::find_if(known.begin(), known.end(), [&](const auto &entry) {
    return entry->items == run;
  });
  if (found == known.end()) {
    if (known.size() >= mostKnown)
      known.erase(known.begin());
    known.push_back(std::make_unique<Known>());
    known.back()->items = run;
  } else {
    std::rotate(found, found + 1, known.end());
  }
  Known &entry = *known.back();
  entry.seen = std::min(entry.seen + 1, entry.wanted);
}

/// Notes that a sequence of launches was collected because it began like a
/// known recording, but did not continue like it: the collected launches are
/// queued one by one.
void RecordedLaunches::lose(Known &entry) {
  constexpr int mostLost = 2, mostWanted = 64;
  ++numLost;
  if (++entry.lost < mostLost)
    return;
  entry.seen = entry.lost = 0;
  entry.wanted = std::min(2 * entry.wanted, mostWanted);
}

//===----------------------------------------------------------------------===//
// Whether collecting pays
//===----------------------------------------------------------------------===//

void RecordedLaunches::noteLaunch(int64_t ns) {
  // The minimum of the measured times counts, since a launch waits for the
  // device if the queue is full.
  launchNs = launchNs < 0 ? ns : std::min(launchNs, ns);
}

void RecordedLaunches::judge(const Outcome &outcome) {
  Known &entry = *running;
  running = nullptr;
  entry.lost = 0;
  ++numTaken;
  constexpr int patience = 3;
  entry.unprepared = outcome.isPrepared ? 0 : entry.unprepared + 1;
  if (entry.unprepared >= patience) {
    // The entry is the recorded sequence of launches. It has had no program
    // several times in a row, for example because copies and fills of the
    // recording differ each time, so its launches are not collected any more.
    entry.unprepared = 0;
    entry.lost = 1;
    lose(entry);
    return;
  }
  if (outcome.chosenMs < 0 || wish == Wish::Always)
    return;
  // While launches are collected, the device is idle. Launches at once run in
  // parallel with the host, so that only device time beyond the host's time is
  // added.
  auto launches = double(entry.items.size());
  double share = launches / std::max(double(outcome.steps), launches);
  double deviceNs = 1e6 * outcome.chosenMs * share;
  double otherNs = 1e6 * std::max(outcome.graphMs, outcome.chosenMs) * share;
  double collected = deviceNs + share * double(outcome.hostNs);
  double atOnce = std::max(launches * double(std::max<int64_t>(launchNs, 0)),
                           otherNs - double(entry.collectNs));
  entry.slow = collected <= atOnce ? 0 : entry.slow + 1;
  if (entry.slow < patience)
    return;
  char text[160];
  std::snprintf(text, sizeof(text),
                "the device takes %.3f ms for them, and collecting them saves "
                "the host %.3f ms",
                1e-6 * collected, 1e-6 * atOnce);
  entry.refused = text;
}

std::string RecordedLaunches::explain() const {
  std::string text;
  if (numTaken + numLost > 0)
    text = "recordings: " + std::to_string(numTaken) +
           " times collected as those before, " + std::to_string(numLost) +
           " times for nothing\n";
  for (const std::unique_ptr<Known> &entry : known)
    if (!entry->refused.empty())
      text += "recordings of " + std::to_string(entry->items.size()) +
              " launches are launched at once: " + entry->refused + "\n";
  return text;
}
