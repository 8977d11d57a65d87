//===- SkipScope.cpp - Counters of skips in passes ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/SkipScope.h"

using namespace mlir::tai;

static thread_local SkipScope *innermost = nullptr;

SkipScope::SkipScope() : outer(innermost) { innermost = this; }
SkipScope::~SkipScope() { innermost = outer; }

void SkipScope::count(SkipCount counter, int64_t amount) {
  if (innermost)
    innermost->amounts[static_cast<unsigned>(counter)] += amount;
}
