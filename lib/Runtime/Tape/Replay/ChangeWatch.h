//===- ChangeWatch.h - Changes after a sequence ran -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Detects changes of fields, by the host or by kernels, since the sequence of a
// tape last ran.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_REPLAY_CHANGEWATCH_H
#define TAI_LIB_RUNTIME_TAPE_REPLAY_CHANGEWATCH_H

#include "../Memory/TapeMemory.h"
#include "../TapeServices.h"

namespace mlir::tai::runtime {

class ChangeWatch {
public:
  explicit ChangeWatch(TapeServices services) : services(services) {}

  /// Begins to watch the fields of the sequence: check() reports changes after
  /// this call. Must be called when the sequence has run.
  void begin(const TapeMemory &memory);
  /// Fails if a field has changed whose values the reverse sweep needs. Adds a
  /// line to `notes` for other fields of the sequence that have changed. Sets
  /// `lostStored` if a changed field has stored outputs.
  Status check(const TapeMemory &memory, std::vector<std::string> &notes,
               bool &lostStored) const;

private:
  TapeServices services;
  /// The fields of the recorded sequence, with their Field::version() at
  /// begin().
  std::vector<std::pair<FieldPtr, uint64_t>> versions;
  /// The number that the next launch had when begin() was called.
  uint64_t endLaunch = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_REPLAY_CHANGEWATCH_H
