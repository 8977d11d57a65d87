//===- MemoryAccount.cpp - The limit and use of memory --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Storage/MemoryAccount.h"
#include "tai/Runtime/Text/Format.h"
#include <algorithm>
#include <cstdio>
#include <unistd.h>

using namespace mlir::tai::runtime;

/// The bytes of memory of the machine, or of the control group of this process.
static int64_t availableMemory() {
  int64_t limit = static_cast<int64_t>(sysconf(_SC_PHYS_PAGES)) *
                  static_cast<int64_t>(sysconf(_SC_PAGESIZE));
  if (FILE *file = std::fopen("/sys/fs/cgroup/memory.max", "re")) {
    long long bytes = 0;
    if (std::fscanf(file, "%lld", &bytes) == 1 && bytes > 0)
      limit = std::min<int64_t>(limit, bytes);
    std::fclose(file);
  }
  return limit;
}

void MemoryAccount::setLimit(int64_t bytes) {
  most = bytes > 0 ? bytes : availableMemory();
}

Status MemoryAccount::checkCells(const SparseNode &node, int64_t cells) const {
  int64_t used = taken + activeCellBytes(), wanted;
  if (!node.isInnermost() ||
      (!__builtin_mul_overflow(cells, node.cellBytes(), &wanted) &&
       wanted <= most - used))
    return Status::success();
  std::string what =
      cells == 1 ? "one more cell" : std::to_string(cells) + " cells";
  return Status::failure(StatusCode::Memory,
                         "out of memory: " + what + " of " + node.info().label +
                             " of " + formatBytes(node.cellBytes()) +
                             " each; its " + std::to_string(node.numActive()) +
                             " active cells take " +
                             formatBytes(node.numActive() * node.cellBytes()) +
                             ", and all fields take " + formatBytes(used) +
                             " of " + formatBytes(most));
}
