//===- KnownRuns.h - Launches that need not run again -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Incremental tapes record a launch without running it if its results are in
// their fields already: the kernel was launched with the same arguments before,
// and nobody has written the fields that it reads, or those that it writes,
// since. See docs/decisions/0083-unchanged-launches.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_RECORD_KNOWNRUNS_H
#define TAI_LIB_RUNTIME_TAPE_RECORD_KNOWNRUNS_H

#include "../TapeServices.h"
#include <unordered_map>

namespace mlir::tai::runtime {

class KnownRuns {
public:
  explicit KnownRuns(TapeServices services) : services(services) {}

  /// True if a launch with these arguments would store the numbers that its
  /// fields hold.
  bool holds(const Kernel &kernel, const uint64_t *args) const;
  /// Notes that a launch has run.
  void note(Kernel &kernel, const uint64_t *args);

private:
  struct Run {
    std::vector<uint64_t> args;
    /// Field::numWrites of the field of each access, after the launch.
    std::vector<uint64_t> writes;
    uint64_t epoch = 0, unknown = 0;
  };
  struct Known {
    std::weak_ptr<Kernel> kernel;
    bool isEligible = false;
    uint64_t epoch = 0;
    /// The last launches; `next` is the oldest one.
    std::vector<Run> runs;
    size_t next = 0;
  };
  bool isEligible(const Kernel &kernel) const;

  TapeServices services;
  std::unordered_map<const Kernel *, Known> known;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_RECORD_KNOWNRUNS_H
