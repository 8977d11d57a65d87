//===- PassStatistics.h - Counts the changes of passes ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TOOLS_TAI_OPT_PASSSTATISTICS_H
#define TAI_TOOLS_TAI_OPT_PASSSTATISTICS_H

#include "llvm/ADT/MapVector.h"
#include "llvm/ADT/StringRef.h"
#include <map>
#include <mutex>
#include <string>

namespace llvm {
class raw_ostream;
} // namespace llvm

namespace mlir {
class PassManager;
} // namespace mlir

namespace mlir::tai {

/// Counts, for each pass in all runs of a tool, how often it ran, how many ops
/// it saw, and by how much the numbers of ops and attributes of each name
/// changed.
/// Any pass has these numbers. The statistics that passes of MLIR count
/// themselves are compiled out of Debian's libMLIR.so.
class PassStatistics {
public:
  /// Counts the changes that the passes of `manager` make. Must outlive the
  /// manager, which may run passes on several threads.
  void observe(PassManager &manager);

  /// Prints a line for each pass, in the order in which they first ran.
  void print(llvm::raw_ostream &os) const;

private:
  friend class PassCounter;

  struct Row {
    unsigned runs = 0, changed = 0, ops = 0;
    std::map<std::string, int> changes, remarks;
  };

  mutable std::mutex mutex;
  llvm::MapVector<std::string, Row, std::map<std::string, unsigned>> rows;
};

} // namespace mlir::tai

#endif // TAI_TOOLS_TAI_OPT_PASSSTATISTICS_H
