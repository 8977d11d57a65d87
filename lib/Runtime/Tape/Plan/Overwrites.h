//===- Overwrites.h - Overwritten elements ----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Finds, from summaries, launches that overwrite elements which an earlier
// launch has used: their adjoints must zero the adjoints of these elements
// during the sweep. If a launch is the first to access the elements that it
// stores, the adjoints of these elements can be zeroed after the sweep
// (OwedZeros.h). Accesses at constant indices, which can be hundreds in a
// kernel, are the same in all its launches and are analysed once.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_PLAN_OVERWRITES_H
#define TAI_LIB_RUNTIME_TAPE_PLAN_OVERWRITES_H

#include "../Record/TapeRecording.h"
#include "tai/Runtime/Mirror/OwedZeros.h"

namespace mlir::tai::runtime {

struct Overwrites {
  /// For each record, true if it may store elements with an adjoint that an
  /// earlier record has used.
  std::vector<bool> isRepeated;
  /// By adjoint field, the elements that a record stores before any other use:
  /// their adjoints are zeroed after a sweep.
  using Zeros =
      std::vector<std::pair<FieldPtr, std::shared_ptr<const OwedZeros>>>;
  Zeros storedOnce;
};

Overwrites findOverwrites(const TapeRecording &recording);

/// True if an access stores all elements at its fixed indices, in all launches.
bool storesSlab(const Access &access);

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_PLAN_OVERWRITES_H
