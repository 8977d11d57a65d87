//===- TapeMemory.cpp - Losses, seeds and memory of tapes in the C API ----===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Impl.h"

using namespace mlir::tai;

TaiStatus taiTapeAddLoss(TaiTape tape, TaiField loss) {
  return call(tape->context, [&]() -> TaiStatus {
    return tape->context.status(tape->tape->addLoss(loss->field));
  });
}

TaiStatus taiTapeWant(TaiTape tape, const TaiField *fields, int64_t count) {
  return call(tape->context, [&]() -> TaiStatus {
    std::vector<runtime::FieldPtr> wanted;
    for (int64_t i = 0; i < count; ++i)
      wanted.push_back(fields[i]->field);
    return tape->context.status(tape->tape->want(wanted));
  });
}

TaiStatus taiTapeSkipUnchanged(TaiTape tape) {
  return call(tape->context, [&]() -> TaiStatus {
    return tape->context.status(tape->tape->skipUnchanged());
  });
}

TaiStatus taiTapeSetSeed(TaiTape tape, TaiField loss, const void *array) {
  return call(tape->context, [&]() -> TaiStatus {
    return tape->context.status(tape->tape->setSeed(*loss->field, array));
  });
}

TaiStatus taiTapeSetCheckpoint(TaiTape tape, TaiCheckpoint kind,
                               int64_t snapshots, int64_t budget) {
  return call(tape->context, [&]() -> TaiStatus {
    runtime::CheckpointPolicy policy;
    policy.kind = static_cast<runtime::CheckpointPolicy::Kind>(kind);
    policy.snapshots = snapshots;
    policy.budget = budget;
    return tape->context.status(tape->tape->setCheckpoints(policy));
  });
}

TaiStatus taiTapeGetStats(TaiTape tape, TaiTapeStats *stats) {
  return call(tape->context, [&]() -> TaiStatus {
    runtime::TapeStats found = tape->tape->stats();
    *stats = {found.savedBytes,    found.peakBytes,  found.snapshots,
              found.snapshotBytes, found.recomputed, found.optimum};
    return TAI_OK;
  });
}

const char *taiTapeWarning(TaiTape tape, int64_t number) {
  return callOr(
      tape->context, static_cast<const char *>(nullptr), [&]() -> const char * {
        const std::vector<std::string> &lines = tape->tape->warnings();
        if (number < 0 || number >= static_cast<int64_t>(lines.size()))
          return nullptr;
        return lines[static_cast<size_t>(number)].c_str();
      });
}
