//===- TapeRecord.cpp - Recording of launches and of what hosts do --------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The path of a launch while a tape records. It runs hundreds of thousands of
// times: what is known of a kernel is found by a pointer, and what a launch
// changes is compared with what is read in reverse by a few loads.
//
//===----------------------------------------------------------------------===//

#include "../Host/HostWrite.h"
#include "../Launch/Launch.h"
#include "../Storage/Scalars.h"
#include "TapeArrays.h"
#include "TapeCheckpoint.h"
#include "TapeMemory.h"
#include "TapeTopology.h"
#include "TapeWrite.h"
#include "tai/Runtime/Launch/AccessChecks.h"
#include "tai/Runtime/Tape/Tape.h"
#include <algorithm>

using namespace mlir::tai::runtime;

Tape::Tape(Runtime &runtime, uint64_t stamp, bool clears)
    : runtime(runtime), stamp(stamp),
      memory(std::make_unique<TapeMemory>(runtime)),
      topology(std::make_unique<TapeTopology>(runtime)),
      arrays(std::make_unique<TapeArrays>()), clears(clears) {
  runtime.recordings().add(*this);
}

Tape::~Tape() {
  end();
  releaseFields();
  runtime.recordings().remove(*this);
}

void Tape::end(bool isSwept) {
  // Of whichever thread: a tape may be dropped by another one.
  if (!std::exchange(isOpen, false))
    return;
  runtime.recordings().end(*this);
  topology->end();
  markVersions();
  if (DeviceContext *device = runtime.getDeviceContext())
    device->endRecording(isSwept);
  if (!isSwept)
    releaseFields();
}

bool Tape::recording() const { return runtime.recordingTape() == this; }

void Tape::suspend() {
  if (suspended++ == 0)
    suspendedAt = runtime.launcher().numbers().load(std::memory_order_relaxed);
}

Status Tape::resume() {
  if (suspended == 0)
    return Status::failure(StatusCode::Usage, "the tape is not suspended");
  --suspended;
  return Status::success();
}

//===----------------------------------------------------------------------===//
// Launches
//===----------------------------------------------------------------------===//

/// True if the adjoint may want the state of a field before the launch and the
/// one after it: then the kernel may have to be recorded in parts.
static bool readsWhatItChanges(const Kernel &kernel) {
  const std::vector<Access> &summary = kernel.summary();
  return std::any_of(summary.begin(), summary.end(), [&](const Access &read) {
    return read.kind == AccessKind::Read &&
           std::any_of(summary.begin(), summary.end(), [&](const Access &use) {
             return use.kind != AccessKind::Read && use.field == read.field;
           });
  });
}

Status Tape::adopt(Kernel &kernel) {
  // Elsewhere the code comes first: the adjoint is begun meanwhile.
  if (!readsWhatItChanges(kernel) || suspended) {
    Status status = runtime.ready(kernel);
    if (!status)
      return status;
  }
  Status status = touch(kernel);
  if (!status)
    return status;
  for (const TreePtr &tree : kernel.info.trees)
    if (tree)
      topology->watch(tree);
  const void *uses = &memory->usesOf(kernel);
  // Where several tapes record, each looks for itself.
  if (!runtime.recordings().areTogether()) {
    kernel.tapeUses = uses;
    kernel.tapeStamp = stamp;
  }
  if (std::find_if(kernels.begin(), kernels.end(), [&](const KernelPtr &known) {
        return known.get() == &kernel;
      }) == kernels.end())
    kernels.push_back(kernel.shared_from_this());
  return Status::success();
}

Status Tape::findUses(Kernel &kernel, const void *&uses) {
  bool isAlone = !runtime.recordings().areTogether();
  Status status;
  if (__builtin_expect(isAlone && kernel.tapeStamp == stamp, true)) {
    uses = kernel.tapeUses;
    return status;
  }
  uses = memory->findUses(kernel);
  if (uses && !isAlone)
    return status;
  // It may take long: another thread may have begun to record by its end.
  status = adopt(kernel);
  uses = memory->findUses(kernel);
  return status;
}

Status Tape::launch(Launch &launch, Kernel &kernel, const uint64_t *args,
                    uint64_t *results, uint64_t number) {
  const void *uses = nullptr;
  Status status = findUses(kernel, uses);
  if (!status)
    return status;
  if (__builtin_expect(!kernel.hasParts() || suspended, true))
    return launchOne(launch, kernel, uses, args, results, number);
  for (const KernelPtr &part : kernel.plan().parts) {
    status = findUses(*part, uses);
    part->prepared.lastLaunch.store(number, std::memory_order_relaxed);
    if (status)
      status = launchOne(launch, *part, uses, args,
                         part->resultSlots() > 0 ? results : nullptr, number);
    if (!status)
      return status;
  }
  return Status::success();
}

Status Tape::launchOne(Launch &launch, Kernel &kernel, const void *known,
                       const uint64_t *args, uint64_t *results,
                       uint64_t number) {
  const auto &uses = *static_cast<const TapeMemory::KernelUses *>(known);
  auto index = static_cast<uint32_t>(records.size());
  Status status = memory->beforeLaunch(uses, args, index, suspended > 0);
  if (status) {
    AccessChecks *checking = activeChecks();
    status = __builtin_expect(checking != nullptr, false)
                 ? checking->run(launch, kernel, args, results, number)
                 : runtime.run(launch, kernel, args, results, number);
  }
  if (__builtin_expect(!status.ok(), false)) {
    // What it did to memory is undone with the record that comes next.
    memory->settle();
    return status;
  }
  if (__builtin_expect(suspended > 0, false)) {
    memory->afterPart(uses, args);
    return status;
  }
  memory->afterLaunch(uses, args, index);
  topology->settle(index);
  topology->noteLoops(index, launch.loops);
  record(kernel, args, number);
  return status;
}

void Tape::record(Kernel &kernel, const uint64_t *args, uint64_t launch) {
  if (!anyLaunch) {
    anyLaunch = true;
    firstLaunch = launch;
  }
  lastLaunch = launch - firstLaunch;
  records.push_back({&kernel, lastLaunch, slots.size()});
  slots.insert(slots.end(), args, args + kernel.tapeSlots());
  runtime.skipCounters().bump(SkipCount::TapeRecorded);
}

//===----------------------------------------------------------------------===//
// Host functions and writes of the host
//===----------------------------------------------------------------------===//

void Tape::recordCallback(TapeCallback callback) {
  if (suspended || !recording())
    return;
  reverseCallbacks |= static_cast<bool>(callback.backward);
  memory->endParts(static_cast<uint32_t>(records.size()),
                   static_cast<bool>(callback.backward));
  // The launches of the function draw the same random numbers again.
  uint64_t next = runtime.launcher().numbers().load(std::memory_order_relaxed);
  uint64_t start = std::min(suspendedAt, next);
  suspendedAt = UINT64_MAX;
  if (!anyLaunch) {
    anyLaunch = true;
    firstLaunch = start;
  }
  if (next > firstLaunch)
    lastLaunch = next - 1 - firstLaunch;
  topology->settle(static_cast<uint32_t>(records.size()));
  records.push_back(
      {nullptr, start - firstLaunch, callbacks.size(), Kind::Callback});
  callbacks.push_back(std::move(callback));
}

Status Tape::write(const HostWrite &write) {
  FieldPtr field = runtime.findField(write.field->name());
  if (field.get() != write.field)
    return Status::failure(StatusCode::Internal,
                           "field '" + write.field->name() +
                               "' is not known to its runtime");
  Status status = touch(field, HoldKind::Write);
  if (status)
    status = memory->beforeWrite(field, write.index,
                                 static_cast<uint32_t>(records.size()));
  if (!status)
    return status;
  runtime.perform(write);
  memory->settle();
  if (suspended)
    return status;
  memory->endParts(static_cast<uint32_t>(records.size()),
                   /*readsInReverse=*/false);
  topology->settle(static_cast<uint32_t>(records.size()));
  records.push_back({nullptr, 0, writes.size(), Kind::Write});
  writes.push_back(std::make_unique<Write>(field, write));
  return status;
}

HostWrite Tape::getWrite(const Record &record) const {
  return writes[record.payload]->get();
}

Status Tape::overwrite(const HostWrite &write) {
  Field *adjoint = write.field->adjoint();
  if (!adjoint || !adjoint->dirty())
    return Status::success();
  if (!adjoint->valid())
    return Status::failure(StatusCode::Usage, "the tree of the gradient of '" +
                                                  write.field->name() +
                                                  "' has been destroyed");
  const char zeros[8] = {};
  HostWrite zero = write;
  zero.field = adjoint;
  zero.bytes = zeros;
  if (zero.what == HostWrite::What::Array)
    zero.what = HostWrite::What::Fill;
  runtime.perform(zero);
  return Status::success();
}

//===----------------------------------------------------------------------===//
// What has changed since
//===----------------------------------------------------------------------===//

bool Tape::minds(const Field &field) const {
  return checkpoints ? memory->isTouched(field) : memory->isRead(field);
}

void Tape::markVersions() {
  versions.clear();
  for (const FieldPtr &field : runtime.fields())
    if (memory->isTouched(*field))
      versions.emplace_back(field, field->version());
  endLaunch = runtime.launcher().numbers().load(std::memory_order_relaxed);
}

/// The fields that launches since then have changed.
static void addChangedBy(const Kernel &kernel, std::vector<Field *> &changed) {
  for (const Access &access : kernel.summary())
    if (access.kind != AccessKind::Read && !access.field->isAdjoint())
      changed.push_back(access.field.get());
}

Status Tape::checkVersions() {
  lostStored = false;
  std::vector<Field *> byHost, byKernels;
  for (const auto &[field, version] : versions)
    if (field->version() != version)
      byHost.push_back(field.get());
  {
    // Other threads may define kernels meanwhile.
    runtime.launcher().kernels().forEach([&](const Kernel &kernel) {
      // Without code it has changed nothing, and its summary may be on its way.
      if (kernel.resolved() &&
          kernel.prepared.lastLaunch.load(std::memory_order_relaxed) >=
              endLaunch &&
          endLaunch > 0)
        addChangedBy(kernel, byKernels);
    });
  }
  auto check = [&](const std::vector<Field *> &changed, const char *how) {
    for (Field *field : changed) {
      if (minds(*field))
        return Status::failure(
            StatusCode::Usage,
            "field '" + field->name() + "' was changed " + how +
                " after the tape had recorded, and the gradient needs what it "
                "held; replay the tape forward and backward instead");
      lostStored |= memory->isStored(*field);
      if (memory->isTouched(*field))
        notes.push_back("field '" + field->name() + "' was changed " + how +
                        " after the tape had recorded; the gradient is that "
                        "of what was recorded");
    }
    return Status::success();
  };
  Status status = check(byHost, "by the host");
  if (!status)
    return status;
  return check(byKernels, "by a kernel");
}
