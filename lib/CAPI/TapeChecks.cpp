//===- TapeChecks.cpp - Access rules in the C API -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Impl.h"
#include "tai/Runtime/Launch/AccessChecks.h"

using namespace mlir::tai;

TaiStatus taiTapeCheckAccesses(TaiTape tape, int64_t limit, bool racesOnly) {
  return call(tape->context, [&]() -> TaiStatus {
    if (limit < 1)
      return tape->context.usage("at least one violation must be kept");
    tape->tape->checkAccesses(limit, racesOnly);
    return TAI_OK;
  });
}

static TaiAccessPlace getPlace(const runtime::AccessPlace &place) {
  return {place.kernel.c_str(), place.launch, static_cast<int32_t>(place.kind),
          place.file.c_str(),   place.line,   place.column};
}

TaiStatus taiTapeViolations(TaiTape tape, const TaiViolation **rows,
                            int64_t *count, int64_t *total) {
  return call(tape->context, [&]() -> TaiStatus {
    tape->violations.clear();
    *total = 0;
    if (const runtime::AccessChecks *checks = tape->tape->accessChecks()) {
      *total = checks->numViolations();
      for (const runtime::Violation &row : checks->violations())
        tape->violations.push_back(
            {static_cast<int32_t>(row.kind), row.field.c_str(),
             row.indices.data(), static_cast<int32_t>(row.indices.size()),
             row.component, getPlace(row.access), getPlace(row.earlier)});
    }
    *rows = tape->violations.data();
    *count = static_cast<int64_t>(tape->violations.size());
    return TAI_OK;
  });
}
