//===- TapeParts.h - The parts of a tape ------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_TAPEPARTS_H
#define TAI_LIB_RUNTIME_TAPE_TAPEPARTS_H

#include "Record/KnownKernels.h"
#include "Record/KnownRuns.h"
#include "Record/LostGradients.h"
#include "Replay/ChangeWatch.h"
#include "Replay/DirectReplay.h"
#include "Replay/ForwardReplay.h"
#include "Sweep/Rematerialiser.h"
#include "Sweep/SweepSeeds.h"
#include "TapeReport.h"
#include "tai/Runtime/Launch/AccessChecks.h"
#include "tai/Runtime/Tape/Tape.h"

namespace mlir::tai::runtime {

/// The parts of a tape, each declared after the parts that it depends on.
struct Tape::Parts {
  Parts(Runtime &runtime, Tape &tape, bool clears)
      : services(runtime), holds(services, tape, clears), memory(runtime),
        topology(runtime), seeds(services), changes(services),
        forms(services, recording, plan, memory),
        first(services, recording, plan, forms), direct(services, recording),
        reverse(services, tape, recording, plan, forms, memory, topology, first,
                health),
        rematerialiser(services, recording, plan, memory, topology, reverse) {
    reverse.liveFields = [this] { return seeds.liveFields(false, holds); };
  }

  TapeServices services;
  bool isOpen = false;
  /// True if memory has run out during an operation: the tape can no longer be
  /// used.
  bool isSpoilt = false;
  /// True if a replay has failed before its end.
  bool isHalfRun = false;
  /// The nesting depth of suspend(), and the number of the next launch when the
  /// outermost suspend() was called.
  int suspended = 0;
  uint64_t suspendedAt = UINT64_MAX;

  TapeHolds holds;
  TapeRecording recording;
  KnownKernels known;
  /// Of an incremental tape: the launches that need not run again. Otherwise
  /// null.
  std::shared_ptr<KnownRuns> runs;
  /// By record: the reasons for which launches of an incremental tape ran.
  std::vector<std::pair<uint32_t, RunReason>> runReasons;
  TapeMemory memory;
  TapeTopology topology;
  std::unique_ptr<AccessChecks> checks;
  SweepSeeds seeds;
  /// The fields whose gradients are asked for; if there are none, all
  /// gradients.
  std::vector<FieldPtr> wanted;
  ChangeWatch changes;
  TapePlan plan;
  AdjointForms forms;
  FirstStores first;
  AdjointHealth health;
  LostGradients lost;
  DirectReplay direct;
  ReverseSweep reverse;
  Rematerialiser rematerialiser;
  TapeReport report;

  /// True if a replay consists of launches only, without other steps.
  bool isDirect() const {
    return services.runsDirectly() && !rematerialiser.isOn() &&
           !health.isWatching() && recording.onlyLaunches() &&
           memory.savesNothing() && topology.watchesNothing();
  }
};

template <typename Body> Status Tape::unlessSpoilt(const Body &body) {
  if (__builtin_expect(parts->isSpoilt, false))
    return Status::failure(StatusCode::Memory,
                           "memory has run out while this tape was in use; "
                           "record it again");
  try {
    Status status = body();
    Runtime &runtime = parts->services.owner();
    if (__builtin_expect(runtime.hasNotedFailure(), false)) {
      Status noted = runtime.takeFailure();
      parts->isSpoilt |= noted.code() == StatusCode::Memory;
      return status ? std::move(noted) : std::move(status);
    }
    return status;
  } catch (...) {
    parts->isSpoilt = true;
    throw;
  }
}

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_TAPEPARTS_H
