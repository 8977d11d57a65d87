//===- Profiler.cpp - C functions of the profiler -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Impl.h"
#include "llvm/ADT/STLExtras.h"

using namespace mlir::tai;

TaiStatus taiProfilerRows(TaiContext context, const TaiProfileRow **rows,
                          int64_t *count) {
  return call(*context, [&]() -> TaiStatus {
    context->profile = context->session.getRuntime().profile();
    context->profileRows.clear();
    for (const runtime::ProfileRow &row : context->profile)
      context->profileRows.push_back(
          {row.kernel.c_str(), row.times.launches, row.times.totalNs * 1e-6,
           row.times.minNs * 1e-6, row.times.maxNs * 1e-6, row.place.c_str(),
           static_cast<TaiProfileKind>(row.kind), row.bytes,
           row.facts.registers, row.facts.localBytes, row.facts.sharedBytes,
           row.occupancy, row.blocks, row.threads});
    *rows = context->profileRows.data();
    *count = static_cast<int64_t>(context->profileRows.size());
    return TAI_OK;
  });
}

TaiStatus taiProfilerTrace(TaiContext context, const TaiTraceEvent **events,
                           int64_t *count, int64_t *lost) {
  return call(*context, [&]() -> TaiStatus {
    std::vector<runtime::TraceEvent> found =
        context->session.getRuntime().trace(*lost);
    // Events are sorted by their start; an event comes before the events within
    // it.
    llvm::sort(found,
               [](const runtime::TraceEvent &a, const runtime::TraceEvent &b) {
                 return std::make_pair(a.startNs, -a.durationNs) <
                        std::make_pair(b.startNs, -b.durationNs);
               });
    context->traceEvents.clear();
    for (const runtime::TraceEvent &event : found)
      context->traceEvents.push_back(
          {event.row->kernel.c_str(), event.row->place.c_str(),
           static_cast<TaiProfileKind>(event.row->kind), event.onDevice,
           event.thread, event.startNs * 1e-3, event.durationNs * 1e-3,
           event.queuedNs * 1e-3, event.blocks, event.threads});
    *events = context->traceEvents.data();
    *count = static_cast<int64_t>(context->traceEvents.size());
    return TAI_OK;
  });
}

TaiStatus taiProfilerClear(TaiContext context) {
  return call(*context, [&]() -> TaiStatus {
    context->session.getRuntime().clearProfile();
    return TAI_OK;
  });
}
