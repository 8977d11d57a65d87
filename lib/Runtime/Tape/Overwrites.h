//===- Overwrites.h - Overwritten elements ----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Finds the launches that overwrite elements that an earlier one has used,
// according to summaries: their adjoints must zero the adjoints of these
// elements during the sweep. If a launch is the first to access the elements
// that it stores, no later adjoint in the sweep reads their adjoints, so these
// can be zeroed after the sweep (OwedZeros.h), if it is known which they are. A
// kernel may have hundreds of accesses at constant indices (the columns of a
// matrix of weights), which are the same in all its launches: these are
// analysed once.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_OVERWRITES_H
#define TAI_LIB_RUNTIME_TAPE_OVERWRITES_H

#include "../Mirror/OwedZeros.h"
#include "TapeRecording.h"

namespace mlir::tai::runtime {

struct Overwrites {
  /// For each record, whether it may store elements with an adjoint that an
  /// earlier one has used.
  std::vector<bool> isRepeated;
  /// By adjoint field, the elements that other records store for the first
  /// time: after a sweep their adjoints are zero.
  using Zeros =
      std::vector<std::pair<FieldPtr, std::shared_ptr<const OwedZeros>>>;
  Zeros storedOnce;
};

Overwrites findOverwrites(const TapeRecording &recording);

/// Whether an access stores all elements at its fixed indices, in all launches.
bool storesSlab(const Access &access);

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_OVERWRITES_H
