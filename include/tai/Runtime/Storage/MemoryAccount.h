//===- MemoryAccount.h - The limit and use of memory ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_STORAGE_MEMORYACCOUNT_H
#define TAI_RUNTIME_STORAGE_MEMORYACCOUNT_H

#include "tai/Runtime/Sparse/Sparse.h"
#include "tai/Support/Status.h"

namespace mlir::tai::runtime {

/// The account of host memory: the limit of bytes for trees and scratch memory,
/// and the bytes of trees.
class MemoryAccount {
public:
  /// `limit`: maximum of bytes; 0 means the memory of the machine, or of the
  /// control group.
  explicit MemoryAccount(int64_t limit = 0) { setLimit(limit); }

  int64_t limit() const { return most; }
  /// Sets the limit. Existing trees above the limit are kept.
  void setLimit(int64_t bytes);
  /// The bytes of trees without sparse levels.
  int64_t reserved() const { return taken; }
  int64_t left() const { return most - taken; }
  void reserve(int64_t bytes) { taken += bytes; }
  void release(int64_t bytes) { taken -= bytes; }
  /// The bytes of active cells of all sparse trees, which the trees update.
  std::atomic<int64_t> activeCells{0};
  int64_t activeCellBytes() const {
    return activeCells.load(std::memory_order_relaxed);
  }
  /// Fails if `cells` more active cells of the level `node` would exceed the
  /// limit.
  Status checkCells(const SparseNode &node, int64_t cells) const;

private:
  int64_t most = 0;
  int64_t taken = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_STORAGE_MEMORYACCOUNT_H
