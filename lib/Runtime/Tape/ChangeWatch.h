//===- ChangeWatch.h - What has changed since a sequence ran ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Remembers what the host had done to fields when the sequence of a tape last
// ran, and finds out what it and kernels have changed since.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_CHANGEWATCH_H
#define TAI_LIB_RUNTIME_TAPE_CHANGEWATCH_H

#include "Memory/TapeMemory.h"
#include "TapeServices.h"

namespace mlir::tai::runtime {

class ChangeWatch {
public:
  explicit ChangeWatch(TapeServices services) : services(services) {}

  /// The sequence has run: from now on changes count.
  void begin(const TapeMemory &memory);
  /// Fails if a field has changed that the reverse sweep needs as it was. Of
  /// the others that the sequence uses it adds a line to `notes`.
  /// `lostStored`: launches have stored to one of them.
  Status check(const TapeMemory &memory, std::vector<std::string> &notes,
               bool &lostStored) const;

private:
  TapeServices services;
  /// Changes by the host so far.
  std::vector<std::pair<FieldPtr, uint64_t>> versions;
  /// The number of the next launch then.
  uint64_t endLaunch = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_CHANGEWATCH_H
