//===- RecordedLaunches.h - Recordings that come again ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Learns what tapes record: the launches between two things that nobody could
// have put off, such as the host's reading a number. Where the same launches
// are likely to come again, they may be collected and run as one sequence
// (docs/decisions/0015-recordings-that-come-again.md).
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_QUEUE_RECORDEDLAUNCHES_H
#define TAI_LIB_RUNTIME_QUEUE_RECORDEDLAUNCHES_H

#include "SentLaunch.h"
#include <algorithm>
#include <memory>
#include <string>
#include <vector>

namespace mlir::tai::runtime {

class RecordedLaunches {
public:
  using Item = SentLaunch;

  /// What became of a sequence that had been collected.
  struct Outcome {
    /// Whether there are ways to run it.
    bool isPrepared = false;
    /// What it takes on the device in the way that was chosen, and as a graph;
    /// negative for not known. Milliseconds.
    double chosenMs = -1, graphMs = -1;
    /// All steps, those after the recording included.
    size_t steps = 0;
    /// What it took the host to hand it to the device.
    int64_t hostNs = 0;
  };

  /// TAI_COLLECT_RECORDINGS=1 has all collected that comes again, and 0 has
  /// nothing collected, for tests and measurements.
  RecordedLaunches();

  /// A tape begins to record.
  void begin();
  /// It has ended.
  void end();
  /// A launch. Whether it is collected, with all that came since the last
  /// interruption.
  bool expects(const Item &item);
  /// Something has come that cannot wait. Whether what was collected is all of
  /// what was expected: then judge() is to be told what becomes of it. `isEnd`:
  /// it is a sweep, which goes on with it however little there is.
  bool interrupt(bool isEnd = false);
  /// The same without an end: whether it would be.
  bool isWhole() const { return collects && findWhole(); }

  bool isCollecting() const { return collects; }
  /// Whether it is likely that launches will be collected.
  bool areAnyKnown() const;

  /// Whether an outcome is waited for.
  bool hasRun() const { return running != nullptr; }
  void judge(const Outcome &outcome);

  /// Functions that have gone: others may have their addresses.
  template <typename HasGone> void forget(const HasGone &hasGone) {
    auto uses = [&](const auto &entry) {
      return std::any_of(
          entry->items.begin(), entry->items.end(),
          [&](const Item &item) { return hasGone(item.function); });
    };
    bool wasUsed = std::any_of(known.begin(), known.end(), uses);
    if (wasUsed && !running && !collects)
      known.erase(std::remove_if(known.begin(), known.end(), uses),
                  known.end());
  }

  /// Finds out what a launch costs the host.
  template <typename Work> auto timed(const Work &work) {
    constexpr size_t distance = 16;
    if (__builtin_expect(run.size() % distance != 1, true))
      return work();
    int64_t start = now();
    auto result = work();
    noteLaunch(now() - start);
    return result;
  }
  static int64_t now();

  /// Some lines, or none.
  std::string explain() const;

private:
  struct Known {
    std::vector<Item> items;
    /// How often they have come, how often they must have, and how often in a
    /// row they were collected for nothing.
    int seen = 0, wanted = 2, lost = 0;
    /// How often in a row there was no program for the sequence, and it was not
    /// worth the while.
    int unprepared = 0, slow = 0;
    /// Of the last times.
    int64_t collectNs = 0, hostNs = -1;
    /// Why they are not collected any more.
    std::string refused;
    bool isLikely() const { return seen >= wanted && refused.empty(); }
  };
  Known *findWhole() const;
  Known *findLonger(const Item &next) const;
  void learn(bool isEnd);
  void lose(Known &expected);
  void noteLaunch(int64_t ns);

  enum class Wish { Judge, Always, Never };
  Wish wish = Wish::Judge;
  /// The latest last.
  std::vector<std::unique_ptr<Known>> known;
  /// The launches since the last interruption, and what is expected.
  std::vector<Item> run;
  bool collects = false;
  Known *expected = nullptr, *running = nullptr;
  int64_t start = 0, launchNs = -1;
  size_t numTaken = 0, numLost = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_RECORDEDLAUNCHES_H
