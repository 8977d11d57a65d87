//===- SkipCounts.cpp - What analyses keep out of adjoints ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/AD/AdjointBuilder.h"
#include "tai/Analysis/SkipScope.h"

using namespace mlir;
using namespace mlir::tai;

void AdjointBuilder::countSkips() {
  int64_t values = 0, active = 0;
  bool anyAccess = false;
  auto count = [&](Value value) {
    if (!isFloatOrVector(value.getType()) || value.use_empty())
      return;
    ++values;
    active += isActive(value);
  };
  primal.walk([&](Operation *op) {
    anyAccess |= activity.isActiveAccess(op);
    if (op->hasTrait<OpTrait::ConstantLike>())
      return;
    llvm::for_each(op->getResults(), count);
    for (Region &region : op->getRegions())
      for (Block &block : region)
        llvm::for_each(block.getArguments(), count);
  });
  SkipScope::count(SkipCount::ValuesAll, values);
  SkipScope::count(SkipCount::ValuesActive, active);
  SkipScope::count(SkipCount::KernelsWithoutAdjoint, anyAccess ? 0 : 1);
  SkipScope::count(SkipCount::ValuesCarried, carriedValues);
  SkipScope::count(SkipCount::ValuesRecorded, recordedValues);
}
