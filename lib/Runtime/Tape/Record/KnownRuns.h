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

/// The reason for which a launch of an incremental tape had to run.
struct RunReason {
  enum Kind {
    None,         ///< The fields hold its results: it did not run.
    Unknown,      ///< No launch with these arguments is known.
    Written,      ///< `field` has been written since.
    Lent,         ///< An address in the tree of `field` was given away.
    Uncounted,    ///< Something has written fields without being counted.
    Effects,      ///< The kernel does more than compute.
    Returns,      ///< The kernel returns values.
    Arrays,       ///< The kernel uses arrays.
    Sparse,       ///< A tree of the kernel has sparse levels.
    ReadsOwn,     ///< The kernel reads `field` and writes it.
    Accumulates,  ///< The kernel updates `field` atomically.
    Gradient,     ///< `field` is a gradient.
    Place,        ///< `field` shares its place with another field.
    Device,       ///< `field` has a copy on a device.
    OtherRecords, ///< The tape or the context runs all launches.
  };
  Kind kind = None;
  /// Held by the summary of the kernel.
  const Field *field = nullptr;

  /// True if the launch had to run.
  explicit operator bool() const { return kind != None; }
  std::string describe() const;
};

class KnownRuns {
public:
  explicit KnownRuns(TapeServices services) : services(services) {}

  /// Returns None if a launch with these arguments would store the numbers that
  /// its fields hold.
  RunReason mustRun(const Kernel &kernel, const uint64_t *args) const;
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
    /// The reason for which launches always run, if there is one.
    RunReason always;
    uint64_t epoch = 0;
    /// The last launches; `next` is the oldest one.
    std::vector<Run> runs;
    size_t next = 0;
  };
  RunReason alwaysRuns(const Kernel &kernel) const;

  TapeServices services;
  std::unordered_map<const Kernel *, Known> known;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_RECORD_KNOWNRUNS_H
