//===- PrefixedGraphs.h - Sequences after other launches --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Runs the launches between two replays of a tape together with the second
// replay, as one graph if the device has graphs. The program of the replay
// itself is unchanged, so that a replay without such launches needs no new
// program. See docs/decisions/0014-launches-between-replays.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_PROGRAMS_PREFIXEDGRAPHS_H
#define TAI_LIB_RUNTIME_PROGRAMS_PREFIXEDGRAPHS_H

#include "ProgramWay.h"

namespace mlir::tai::runtime::programs {

class PrefixedGraphs {
public:
  explicit PrefixedGraphs(Device &device) : device(device) {}

  /// Runs the launches of `prefix`, which came before the sequence, and then
  /// the sequence in the way `way`.
  Status run(const Sequence &prefix, Way &way);
  /// Notes that the way to run the sequence, or its parameter slots, have
  /// changed.
  void noteChange();
  bool uses(const Module &module) const;
  std::string explain() const;

private:
  struct Prefixed {
    Sequence prefix;
    std::unique_ptr<DeviceGraph> graph;
    /// True if the graph has the current parameter slots of the sequence.
    bool isCurrent = false;
    std::string refused;
    int runs = 0, changes = 0;
  };
  Prefixed &find(const Sequence &prefix);
  Status capture(Prefixed &entry, Way &way);
  bool change(Prefixed &entry, const Sequence &prefix);

  Device &device;
  /// The graphs with prefixes, the most recently used one last.
  std::vector<std::unique_ptr<Prefixed>> entries;
};

} // namespace mlir::tai::runtime::programs

#endif // TAI_LIB_RUNTIME_PROGRAMS_PREFIXEDGRAPHS_H
