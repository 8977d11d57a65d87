//===- SequencePrefixes.h - Launches before sequences -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Learns which launches repeatedly occur directly before a sequence, such as
// launches of an optimiser between two replays of a tape. Known prefixes may be
// deferred and queued with the sequence
// (docs/decisions/0014-launches-between-replays.md).
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_QUEUE_SEQUENCEPREFIXES_H
#define TAI_LIB_RUNTIME_QUEUE_SEQUENCEPREFIXES_H

#include "SentLaunch.h"
#include <unordered_map>

namespace mlir::tai::runtime {

class SequencePrefixes {
public:
  /// The maximum number of launches before a sequence, and between sequences.
  static constexpr size_t kMostLaunches = 16, kMostBetween = 32;

  /// For tests and measurements, TAI_KEEP_LAUNCHES_US sets how long, in
  /// microseconds, launches may be deferred.
  SequencePrefixes();

  /// Notes a launch outside of sequences. Returns true if the launch probably
  /// starts or continues a known prefix.
  bool expects(const DeviceFunction *function, const LaunchShape &shape,
               int count);
  /// Notes work other than launches, which interrupts a prefix.
  void interrupt();
  /// Notes that a sequence begins, which runs together with the deferred
  /// launches.
  void begin();
  /// Notes that a sequence has ended. With `isWorthIt`, observes the launches
  /// that follow.
  void end(bool isWorthIt);

  /// True if launches outside of sequences are being observed.
  bool isOpen() const { return open; }
  /// True if any prefix (launches before a sequence) is known.
  bool areAnyKnown() const { return numKnown > 0; }
  /// Describes the known prefixes in one line, or returns an empty text.
  std::string explain() const;

private:
  using Item = SentLaunch;
  /// A prefix of a sequence, which is found by its first launch.
  struct Prefix {
    std::vector<Item> items;
    /// How often in a row the launches of the prefix occurred, how often they
    /// must occur to be deferred, and how often in a row deferring them was in
    /// vain.
    int seen = 0, wanted = 2, lost = 0;
    bool isKnown() const { return seen >= wanted; }
  };
  void lose();
  void count();

  int64_t longestNs;
  std::unordered_map<const DeviceFunction *, Prefix> prefixes;
  size_t numKnown = 0;
  bool open = false;
  /// The number of launches since the last sequence.
  size_t between = 0;
  /// The launches since the last interruption, the time of the first one, and
  /// the prefix that they are expected to become, or null.
  std::vector<Item> run;
  int64_t start = 0;
  Prefix *expected = nullptr;
  size_t numTaken = 0, numLost = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_SEQUENCEPREFIXES_H
