//===- LoopRemarks.h - What is said about reversed loops --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_REVERSE_LOOPREMARKS_H
#define TAI_LIB_AD_REVERSE_LOOPREMARKS_H

#include "mlir/IR/Operation.h"

namespace mlir::tai {

/// A serial loop that has been reversed, and how its reverse gets what each
/// iteration began with.
struct ReversedLoop {
  struct Carried {
    Value value;
    /// How the reverse gets it.
    StringRef kind;
    /// Whether every chunk keeps what it begins with.
    bool isKeptByChunks;
  };

  Operation *loop;
  StringRef function;
  /// How many iterations there are, in words.
  std::string trips = "counted by a run of the loop";
  /// What is recorded; none if 0.
  int64_t bytesPerIteration = 0;
  /// Where all iterations take more, they are recorded in chunks; never if 0.
  int64_t chunkedFrom = 0;
  SmallVector<Carried> carried;
};

/// Emits optimization remarks of category "tai-loops": one for the loop, then
/// one for each value that it carries.
void remarkReversedLoop(const ReversedLoop &summary);

} // namespace mlir::tai

#endif // TAI_LIB_AD_REVERSE_LOOPREMARKS_H
