//===- ForwardReplay.cpp - Re-execution of recorded sequences -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "ForwardReplay.h"

using namespace mlir::tai::runtime;
using Kind = TapeRecording::Kind;

/// Repeats a write of the host. In forward mode, a value written after a launch
/// is a constant with zero tangent; a write before the first launch sets the
/// point of differentiation, and keeps the tangent.
static Status replayWrite(const TapeServices &services,
                          const TapeRecording &recording, size_t index) {
  constexpr auto canStop = FieldCopies::Interrupts::Stop;
  HostWrite write = recording.write(recording[index]);
  Status status = services.activateFor(write);
  if (status && !services.perform(write, canStop))
    status = failAsInterrupted();
  if (!status || !services.isForward() || !recording.launchesBefore(index))
    return status;
  const char zeros[8] = {};
  write.field = write.field->dual();
  write.bytes = zeros;
  if (write.what == HostWrite::What::Array)
    write.what = HostWrite::What::Fill;
  if (write.field && !services.perform(write, canStop))
    status = failAsInterrupted();
  return status;
}

Status ForwardReplay::run() {
  Status status;
  for (size_t i = 0; i < recording.size() && status; ++i) {
    status = memory.beforeReplay(static_cast<uint32_t>(i));
    if (!status)
      break;
    status = replay(i);
    memory.settle();
    topology.settle(static_cast<uint32_t>(i));
    if (recording[i].kernel)
      topology.noteLoops(static_cast<uint32_t>(i), launch.loops);
  }
  return status;
}

Status ForwardReplay::replay(size_t index) {
  const TapeRecording::Record &record = recording[index];
  switch (record.kind) {
  case Kind::Launch: {
    uint64_t number = recording.number(record);
    record.kernel->setLastLaunch(number);
    return services.run(launch, *record.kernel, recording.args(record), nullptr,
                        number);
  }
  case Kind::Write:
    return replayWrite(services, recording, index);
  case Kind::Callback:
    break;
  }
  const TapeCallback &callback = recording.callback(record);
  return callback.forward ? callback.forward() : Status::success();
}

Status mlir::tai::runtime::replayRecord(const TapeServices &services,
                                        const TapeRecording &recording,
                                        Launch &launch, size_t index,
                                        bool changesMemory) {
  const TapeRecording::Record &record = recording[index];
  uint64_t number = recording.number(record);
  switch (record.kind) {
  case Kind::Launch:
    return services.run(launch, *record.kernel, recording.args(record), nullptr,
                        number);
  case Kind::Write:
    return replayWrite(services, recording, index);
  case Kind::Callback:
    break;
  }
  const TapeCallback &callback = recording.callback(record);
  if (!callback.forward)
    return changesMemory
               ? Status::failure(StatusCode::Usage,
                                 "record " + std::to_string(index) +
                                     " of the tape is a host function that "
                                     "cannot be run again, which recomputing "
                                     "needs")
               : Status::success();
  uint64_t next = services.exchangeNextLaunch(number);
  Status status = callback.forward();
  services.exchangeNextLaunch(next);
  return status;
}
