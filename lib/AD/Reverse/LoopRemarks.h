//===- LoopRemarks.h - Remarks about reversed loops -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_REVERSE_LOOPREMARKS_H
#define TAI_LIB_AD_REVERSE_LOOPREMARKS_H

#include "mlir/IR/Operation.h"

namespace mlir::tai {

/// A serial loop that has been reversed, and how its reverse recovers the
/// values that it carries.
struct ReversedLoop {
  struct Carried {
    Value value;
    /// Returns the name, for remarks, of the method by which the reverse
    /// recovers a carried value; see CarriedKind.
    StringRef kind;
    /// True if the value is part of the checkpoint at the start of each chunk.
    bool isKeptByChunks;
  };

  Operation *loop;
  StringRef function;
  /// The number of iterations, in words for the remark.
  std::string trips = "counted by a run of the loop";
  /// The number of bytes that the reverse records for each iteration; 0 if
  /// nothing is recorded.
  int64_t bytesPerIteration = 0;
  /// If the record takes more bytes than this, it is made in chunks of
  /// iterations; 0 means never.
  int64_t chunkedFrom = 0;
  SmallVector<Carried> carried;
};

/// Emits optimization remarks of category "tai-loops": one for the loop, then
/// one for each value that it carries.
void remarkReversedLoop(const ReversedLoop &summary);

} // namespace mlir::tai

#endif // TAI_LIB_AD_REVERSE_LOOPREMARKS_H
