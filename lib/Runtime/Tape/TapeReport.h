//===- TapeReport.h - Texts about sweeps ------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_TAPEREPORT_H
#define TAI_LIB_RUNTIME_TAPE_TAPEREPORT_H

#include "Record/KnownRuns.h"
#include "Sweep/Rematerialiser.h"

namespace mlir::tai::runtime {

/// The text of the tape's `explain`, and the warnings about the last sweep.
class TapeReport {
public:
  std::vector<std::string> notes;

  void begin() { text.clear(); }
  /// Adds a line with the decision on a record, and its reason. `ran`, of an
  /// incremental tape, says whether the launch ran; it may be null.
  void addRecord(const TapeRecording &recording, const TapePlan &plan,
                 const AdjointForms &forms, size_t index, int64_t savedBytes,
                 uint32_t timesRecomputed, const RunReason *ran);
  /// Adds a line to the text that says how many functions a replay calls
  /// directly.
  void addDirect(size_t count, const char *what);
  void add(const std::string &lines) { text += lines; }
  /// Keeps the numbers of iterations that the last sweep ran and skipped in
  /// loops that look for zero adjoints.
  void noteZeroAdjoints(int64_t visited, int64_t skipped) {
    zeroAdjoints = {visited, skipped};
  }
  /// Adds a line with these numbers, if there are any.
  void addZeroAdjoints();
  /// Adds a line with the gradients that the last sweep did not clear, if there
  /// are any.
  void addFirstStores(const std::vector<std::string> &fields, int64_t bytes);
  const std::string &get() const { return text; }

  /// Adds a warning if a sweep with losses had nothing to do.
  void checkEffect(const TapeRecording &recording, const TapePlan &plan,
                   const std::string &losses, bool hasWanted);

private:
  std::string text;
  std::pair<int64_t, int64_t> zeroAdjoints;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_TAPEREPORT_H
