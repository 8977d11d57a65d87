//===- Skips.cpp - Counters of skips in the C API -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Impl.h"

using namespace mlir::tai;

TaiStatus taiProfilerSkips(TaiContext context, const TaiSkipRow **rows,
                           int64_t *count) {
  return call(*context, [&]() -> TaiStatus {
    const runtime::Runtime &runtime = context->session.getRuntime();
    SkipAmounts amounts = runtime.skipAmounts();
    context->skipRows.clear();
    for (unsigned i = 0; i < kNumSkipCounts; ++i) {
      Skip skip = kSkipCounts[i].skip;
      context->skipRows.push_back({getSkipName(skip), kSkipCounts[i].name,
                                   amounts[i], runtime.skips(skip)});
    }
    *rows = context->skipRows.data();
    *count = context->skipRows.size();
    return TAI_OK;
  });
}

TaiStatus taiProfilerClearSkips(TaiContext context) {
  return call(*context, [&]() -> TaiStatus {
    context->session.getRuntime().skipCounters().clear();
    return TAI_OK;
  });
}
