//===- TapeDiagnostics.cpp - Checks and health of gradients in the C API --===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Impl.h"
#include <cmath>

using namespace mlir::tai;

static bool hasRecord(TaiTape tape, int64_t record) {
  return record >= 0 && record < tape->tape->numRecords();
}

TaiStatus taiTapeRunRecord(TaiTape tape, int64_t record) {
  return call(tape->context, [&]() -> TaiStatus {
    return tape->context.status(tape->tape->runRecord(record));
  });
}

const char *taiTapeRecordKernel(TaiTape tape, int64_t record) {
  return callOr(tape->context, static_cast<const char *>(nullptr),
                [&]() -> const char * {
                  if (!hasRecord(tape, record))
                    return nullptr;
                  const runtime::Kernel *kernel = tape->tape->kernelOf(record);
                  return kernel ? kernel->name().c_str() : nullptr;
                });
}

TaiStatus taiTapeRecordAccesses(TaiTape tape, int64_t record,
                                const TaiTapeAccess **rows, int64_t *count) {
  return call(tape->context, [&]() -> TaiStatus {
    if (!hasRecord(tape, record))
      return tape->context.usage("the tape has no record " +
                                 llvm::Twine(record));
    tape->accesses.clear();
    if (const runtime::Kernel *kernel = tape->tape->kernelOf(record)) {
      const uint64_t *args = tape->tape->argsOf(record);
      for (const runtime::Access &access : kernel->summary()) {
        TaiTapeAccess row{access.field->name().c_str(),
                          static_cast<int32_t>(access.kind), -1, 0};
        if (!access.fixed.empty()) {
          const runtime::FixedIndex &first = access.fixed.front();
          row.dimension = static_cast<int32_t>(first.dimension);
          row.index =
              first.evaluate(args) - access.field->firstIndex(first.dimension);
        }
        tape->accesses.push_back(row);
      }
    }
    *rows = tape->accesses.data();
    *count = static_cast<int64_t>(tape->accesses.size());
    return TAI_OK;
  });
}

TaiStatus taiTapeWatchHealth(TaiTape tape, bool on) {
  return call(tape->context, [&]() -> TaiStatus {
    tape->tape->watchHealth(on);
    return TAI_OK;
  });
}

TaiStatus taiTapeHealth(TaiTape tape, const TaiTapeHealthRow **rows,
                        int64_t *count) {
  return call(tape->context, [&]() -> TaiStatus {
    tape->health.clear();
    for (const runtime::RecordHealth &row : tape->tape->health())
      tape->health.push_back({row.record, row.field->name().c_str(), row.nans,
                              row.infs, row.maxAbs, std::sqrt(row.sumSquares)});
    *rows = tape->health.data();
    *count = static_cast<int64_t>(tape->health.size());
    return TAI_OK;
  });
}
