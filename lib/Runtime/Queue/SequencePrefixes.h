//===- SequencePrefixes.h - Launches in front of sequences ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Learns which launches come directly before a sequence, each time: those of an
// optimiser between two replays of a tape. What has been learnt may be kept and
// queued with the sequence (docs/decisions/0014-launches-between-replays.md).
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_QUEUE_SEQUENCEPREFIXES_H
#define TAI_LIB_RUNTIME_QUEUE_SEQUENCEPREFIXES_H

#include "SentLaunch.h"
#include <unordered_map>

namespace mlir::tai::runtime {

class SequencePrefixes {
public:
  /// The most launches before a sequence, and between two of them.
  static constexpr size_t kMostLaunches = 16, kMostBetween = 32;

  /// TAI_KEEP_LAUNCHES_US says how long launches may be kept, for tests and
  /// measurements.
  SequencePrefixes();

  /// A launch that is in no sequence. Whether it is likely that the same
  /// sequence of launches as ever comes, and a sequence right after it.
  bool expects(const DeviceFunction *function, const LaunchShape &shape,
               int count);
  /// Something else has come.
  void interrupt();
  /// A sequence begins that takes what has been kept.
  void begin();
  /// A sequence has ended. Whether it is worth the while to look at what
  /// follows.
  void end(bool isWorthIt);

  /// Whether launches are looked at.
  bool isOpen() const { return open; }
  /// Whether any are likely to come.
  bool areAnyKnown() const { return numKnown > 0; }
  /// One line, or none.
  std::string explain() const;

private:
  using Item = SentLaunch;
  /// Launches by the first of them.
  struct Lead {
    std::vector<Item> items;
    /// How often they have come in a row, how often they must have, and how
    /// often in a row they were kept for nothing.
    int seen = 0, wanted = 2, lost = 0;
    bool isKnown() const { return seen >= wanted; }
  };
  void lose();
  void count();

  int64_t longestNs;
  std::unordered_map<const DeviceFunction *, Lead> leads;
  size_t numKnown = 0;
  bool open = false;
  /// Launches since the last sequence.
  size_t between = 0;
  /// The launches since something else came last, when the first one came, and
  /// what is expected; null for nothing.
  std::vector<Item> run;
  int64_t start = 0;
  Lead *expected = nullptr;
  size_t numTaken = 0, numLost = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_SEQUENCEPREFIXES_H
