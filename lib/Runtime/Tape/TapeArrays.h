//===- TapeArrays.h - What a tape knows of arrays of callers ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Launches hold addresses. What else tells which of them use the same array.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_TAPEARRAYS_H
#define TAI_LIB_RUNTIME_TAPE_TAPEARRAYS_H

#include "../Launch/FlowTracker.h"

namespace mlir::tai::runtime {

struct TapeArrays {
  /// Of what memory is a copy for one launch, by its address.
  std::unordered_map<uint64_t, ArrayRange> copies;
  /// Arrays that the host has changed before a record.
  std::vector<std::pair<size_t, ArrayRange>> written;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_TAPEARRAYS_H
