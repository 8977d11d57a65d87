//===- RecordedLaunches.h - Repeated recordings -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Learns the sequences of launches that tapes record between two operations
// that cannot be deferred, such as a read by the host. If the same launches
// will probably be repeated, they may be collected and run as one sequence
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

  /// The result of running a collected sequence of launches.
  struct Outcome {
    /// True if ways to run the sequence have been set up.
    bool isPrepared = false;
    /// The device time of the sequence in milliseconds, in the chosen way, and
    /// as a graph; negative if not known.
    double chosenMs = -1, graphMs = -1;
    /// The number of steps of the sequence, including steps after the
    /// recording.
    size_t steps = 0;
    /// Host time to queue the sequence, in nanoseconds.
    int64_t hostNs = 0;
  };

  /// For tests and measurements, TAI_COLLECT_RECORDINGS=1 collects all repeated
  /// recordings, and 0 none.
  RecordedLaunches();

  /// Notes that a tape starts to record.
  void begin();
  /// The recording has ended.
  void end();
  /// Notes a launch. Returns true if it should be collected, with all launches
  /// since the last interruption.
  bool expects(const Item &item);
  /// Notes an operation that cannot be deferred. Returns true if the collected
  /// launches are a complete known sequence: the caller then calls judge() with
  /// the outcome. `isEnd`: the operation is a sweep, which runs together with
  /// whatever has been collected.
  bool interrupt(bool isEnd = false);
  /// True if interrupt() would return true, because the collected launches are
  /// a complete known sequence.
  bool isWhole() const { return collects && findWhole(); }

  bool isCollecting() const { return collects; }
  /// True if any sequence is likely to be collected.
  bool areAnyKnown() const;

  /// True if a collected sequence has been queued whose outcome judge() gets.
  bool hasRun() const { return running != nullptr; }
  void judge(const Outcome &outcome);

  /// Forgets sequences of launches with destroyed functions, whose addresses
  /// may be reused.
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

  /// Runs `work`, a launch; times some of them to estimate the host's cost.
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

  /// Describes the known recordings in several lines, or returns an empty text.
  std::string explain() const;

private:
  struct Known {
    std::vector<Item> items;
    /// How often the sequence has occurred, how often it must occur to be
    /// collected, and how many successive attempts to collect it have failed.
    int seen = 0, wanted = 2, lost = 0;
    /// The number of successive times that the sequence had no program, and
    /// that it was slower than single launches.
    int unprepared = 0, slow = 0;
    /// Host times of the sequence's last run in nanoseconds, to collect the
    /// launches and to queue the sequence; -1 if not known.
    int64_t collectNs = 0, hostNs = -1;
    /// The reason why the sequence is no longer collected; empty if it is.
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
  /// The known recordings, the most recently used one last.
  std::vector<std::unique_ptr<Known>> known;
  /// The launches since the last interruption, and the sequence expected.
  std::vector<Item> run;
  bool collects = false;
  Known *expected = nullptr, *running = nullptr;
  int64_t start = 0, launchNs = -1;
  size_t numTaken = 0, numLost = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_RECORDEDLAUNCHES_H
