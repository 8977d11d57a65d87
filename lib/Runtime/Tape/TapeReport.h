//===- TapeReport.h - What a tape tells about its sweeps --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_TAPEREPORT_H
#define TAI_LIB_RUNTIME_TAPE_TAPEREPORT_H

#include "Rematerialiser.h"

namespace mlir::tai::runtime {

/// The text of `explain`, and the lines of the last sweep that a careful user
/// should know.
class TapeReport {
public:
  std::vector<std::string> notes;

  void begin() { text.clear(); }
  /// One line: what becomes of the record, and why.
  void addRecord(const TapeRecording &recording, const TapePlan &plan,
                 const AdjointForms &forms, size_t index, int64_t savedBytes,
                 uint32_t timesRecomputed);
  /// A replay calls so many functions directly.
  void addDirect(size_t count, const char *what);
  void add(const std::string &lines) { text += lines; }
  const std::string &get() const { return text; }

  /// Notes where a sweep has had nothing to do, though there are losses.
  void checkEffect(const TapeRecording &recording, const TapePlan &plan,
                   const std::string &losses);

private:
  std::string text;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_TAPEREPORT_H
