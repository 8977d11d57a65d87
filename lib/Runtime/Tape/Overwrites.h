//===- Overwrites.h - Elements that are stored again ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Which launches store elements that an earlier one has used, as far as
// summaries tell: their adjoints leave zero there while the sweep runs. The
// elements that others store, which are the first to touch them, no adjoint
// reaches after their own, so that they may be zeroed as late as one likes,
// where it is known which they are. A kernel may have hundreds of accesses at
// constant indices (the columns of a matrix of weights), which are the same in
// all its launches: they are looked at once.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_OVERWRITES_H
#define TAI_LIB_RUNTIME_TAPE_OVERWRITES_H

#include "../Mirror/OwedZeros.h"
#include "TapeRecording.h"

namespace mlir::tai::runtime {

struct Overwrites {
  /// For each record, whether it stores elements with an adjoint that an
  /// earlier one has used, as far as summaries tell.
  std::vector<bool> isRepeated;
  /// What the others store, which no record has used before: after a sweep the
  /// adjoints of these elements are zero. By adjoint fields.
  using Zeros =
      std::vector<std::pair<FieldPtr, std::shared_ptr<const OwedZeros>>>;
  Zeros storedOnce;
};

/// `mark`: a number that no analysis has had; see TapeServices::nextMark.
Overwrites findOverwrites(const TapeRecording &recording, uint64_t mark);

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_OVERWRITES_H
