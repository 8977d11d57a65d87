//===- TapeRecord.cpp - Recording of launches and host writes -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The path of a launch while a tape records. It runs hundreds of thousands of
// times: the data about a kernel is found by one pointer, and a few loads
// compare the changes of a launch with the reads of adjoints.
//
//===----------------------------------------------------------------------===//

#include "../TapeParts.h"
#include <algorithm>

using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Beginning and end
//===----------------------------------------------------------------------===//

Tape::Tape(Runtime &runtime, bool clears)
    : parts(std::make_unique<Parts>(runtime, *this, clears)) {
  parts->services.add(*this);
}

Tape::~Tape() {
  try {
    end();
  } catch (...) {
    // A destructor cannot report a failure of end(); the tape has ended all the
    // same.
  }
  releaseFields();
  parts->services.remove(*this);
}

Status Tape::begin(Runtime &runtime, FieldPtr loss, bool clears,
                   std::unique_ptr<Tape> &tape) {
  if (runtime.recordings().current())
    return Status::failure(StatusCode::Usage,
                           "a tape is being recorded already, and tapes do not "
                           "nest");
  DeviceContext *device = runtime.devices().get();
  TapeServices services(runtime);
  // A device recognises a repeated recording by the launches that it queues, so
  // launches of two recording threads must not mix.
  if (device && services.anyRecording())
    return Status::failure(StatusCode::Usage,
                           "another thread records a tape, and a GPU has room "
                           "for one at a time: let it finish first");
  std::unique_ptr<Tape> made(new Tape(runtime, clears));
  // The list of records gets room for as many launches as the last recording
  // had, since an iteration of an optimiser usually records as many as the one
  // before.
  if (std::shared_ptr<const KnownPlan> last = services.knownPlan())
    made->parts->recording.reserve(last->recorded());
  // From here on, the tape holds the fields that it uses.
  Status held = made->parts->holds.hold();
  if (!held)
    return held;
  if (loss) {
    if (loss->rank() != 0 || loss->numComponents() != 1 ||
        !isFloat(loss->scalar()))
      return Status::failure(StatusCode::Usage,
                             "the loss '" + loss->name() +
                                 "' must be one floating-point number (a field "
                                 "without indices)");
    Status status = made->addLoss(std::move(loss));
    if (!status)
      return status;
  }
  // A recording on a device includes the launches that clear gradients.
  if (device)
    device->beginRecording();
  Status status;
  try {
    if (clears)
      status = runtime.gradients().clear(made.get());
    else
      runtime.settleZeros();
  } catch (...) {
    if (device)
      device->endRecording(/*isSwept=*/false);
    throw;
  }
  if (status)
    status = runtime.takeFailure();
  if (!status) {
    if (device)
      device->endRecording(/*isSwept=*/false);
    return status;
  }
  tape = std::move(made);
  services.beginRecording(*tape);
  tape->parts->isOpen = true;
  return Status::success();
}

void Tape::end(bool isSwept) {
  // Any thread can end a tape, not only the thread that records it.
  if (!std::exchange(parts->isOpen, false))
    return;
  parts->services.endRecording(*this);
  parts->topology.end();
  parts->changes.begin(parts->memory);
  if (DeviceContext *device = parts->services.owner().devices().get())
    device->endRecording(isSwept);
  if (!isSwept)
    releaseFields();
}

bool Tape::recording() const {
  return parts->services.owner().recordings().current() == this;
}

void Tape::suspend() {
  if (parts->suspended++ == 0)
    parts->suspendedAt = parts->services.nextLaunch();
}

Status Tape::resume() {
  if (parts->suspended == 0)
    return Status::failure(StatusCode::Usage, "the tape is not suspended");
  --parts->suspended;
  return Status::success();
}

bool Tape::isSuspended() const { return parts->suspended > 0; }

Status Tape::setCheckpoints(CheckpointPolicy policy) {
  if (!parts->recording.empty() || !recording())
    return Status::failure(StatusCode::Usage,
                           "how a tape keeps values is decided before it "
                           "records");
  return parts->rematerialiser.setPolicy(policy);
}

Status Tape::skipUnchanged() {
  if (!parts->recording.empty() || !recording())
    return Status::failure(StatusCode::Usage,
                           "whether a tape is incremental is decided before it "
                           "records");
  const TapeServices &services = parts->services;
  services.owner().launcher().countWrites();
  parts->runs = services.knownRuns();
  if (!parts->runs) {
    parts->runs = std::make_shared<KnownRuns>(services);
    services.setKnownRuns(parts->runs);
  }
  return Status::success();
}

/// Runs a launch of an incremental tape, unless its results are there already.
Status Tape::runIfChanged(Launch &launch, Kernel &kernel, const uint64_t *args,
                          uint64_t *results, uint64_t number) {
  const TapeServices &services = parts->services;
  bool maySkip = services.skips(Skip::UnchangedLaunches) &&
                 !parts->rematerialiser.isOn() && !services.isForward() &&
                 !services.recordsTogether();
  RunReason reason{RunReason::OtherRecords};
  if (maySkip)
    reason = parts->runs->mustRun(kernel, args);
  parts->runReasons.emplace_back(parts->recording.next(), reason);
  if (!reason) {
    launch.loops.clear();
    services.count(SkipCount::UnchangedSkipped);
    return Status::success();
  }
  services.count(SkipCount::UnchangedRun);
  Status status = services.run(launch, kernel, args, results, number);
  if (!status)
    parts->runReasons.pop_back();
  else if (maySkip)
    parts->runs->note(kernel, args);
  return status;
}

void Tape::checkAccesses(int64_t limit, bool racesOnly) {
  parts->checks =
      std::make_unique<AccessChecks>(parts->services.owner(), limit, racesOnly);
}

const AccessChecks *Tape::accessChecks() const { return parts->checks.get(); }

//===----------------------------------------------------------------------===//
// Launches
//===----------------------------------------------------------------------===//

/// True if the adjoint may need the contents of a field both before and after
/// the launch: then the kernel may have to be recorded in parts.
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
  // A kernel that needs no parts is compiled first, and its adjoint meanwhile
  // in the background.
  if (!readsWhatItChanges(kernel) || isSuspended()) {
    Status status = parts->services.ready(kernel);
    if (!status)
      return status;
  }
  Status status = parts->holds.add(kernel);
  if (!status)
    return status;
  for (const TreePtr &tree : kernel.trees())
    if (tree)
      parts->topology.watch(tree);
  const void *uses = &parts->memory.usesOf(kernel);
  // A kernel that is adopted while another tape records is adopted once more,
  // when the other one has ended.
  if (!parts->services.recordsTogether()) {
    parts->memory.noteAdopted(kernel);
    parts->known.add(kernel, uses);
  }
  parts->recording.keep(kernel);
  return Status::success();
}

/// Finds the tape's data about a kernel; adopts the kernel if there are none
/// yet.
Status Tape::findUses(Kernel &kernel, const void *&uses) {
  bool isAlone = !parts->services.recordsTogether();
  uses = parts->known.find(kernel);
  Status status;
  if (__builtin_expect(isAlone && uses, true))
    return status;
  const TapeMemory::KernelUses *found = parts->memory.findUses(kernel);
  if (found && (!isAlone || found->isAdopted)) {
    uses = found;
    if (isAlone)
      parts->known.add(kernel, uses);
    return status;
  }
  // To adopt a kernel may take long: another thread may have begun to record
  // meanwhile.
  status = adopt(kernel);
  uses = parts->memory.findUses(kernel);
  return status;
}

inline Status Tape::launchOne(Launch &launch, Kernel &kernel, const void *known,
                              const uint64_t *args, uint64_t *results,
                              uint64_t number) {
  Parts &tape = *parts;
  const auto &uses = *static_cast<const TapeMemory::KernelUses *>(known);
  uint32_t index = tape.recording.next();
  bool isPart = tape.suspended > 0;
  Status status = tape.memory.beforeLaunch(uses, args, index, isPart);
  if (status)
    status = __builtin_expect(tape.checks && !isPart, false)
                 ? tape.checks->run(launch, kernel, args, results, number)
             : __builtin_expect(tape.runs && !isPart, false)
                 ? runIfChanged(launch, kernel, args, results, number)
                 : tape.services.run(launch, kernel, args, results, number);
  if (__builtin_expect(!status.ok(), false)) {
    // The saved copies of a failed launch are kept, so that reversing the next
    // record restores its changes.
    tape.memory.settle();
    return status;
  }
  if (__builtin_expect(tape.suspended > 0, false)) {
    tape.memory.afterPart(uses, args);
    return status;
  }
  tape.memory.afterLaunch(uses, args, index);
  tape.topology.settle(index);
  tape.topology.noteLoops(index, launch.loops);
  tape.recording.addLaunch(kernel, args, number);
  tape.services.count(SkipCount::TapeRecorded);
  return status;
}

inline Status Tape::record(Launch &launch, Kernel &kernel, const uint64_t *args,
                           uint64_t *results, uint64_t number) {
  const void *uses = nullptr;
  Status status = findUses(kernel, uses);
  if (!status)
    return status;
  if (__builtin_expect(!kernel.adjoint().hasParts() || isSuspended(), true))
    return launchOne(launch, kernel, uses, args, results, number);
  for (const KernelPtr &part : kernel.adjoint().plan().parts) {
    status = findUses(*part, uses);
    if (status && part->adjoint().hasParts())
      status = Status::failure(StatusCode::Internal,
                               "the part '" + part->name() +
                                   "' of a kernel has parts itself");
    part->setLastLaunch(number);
    if (status)
      status = launchOne(launch, *part, uses, args,
                         part->resultSlots() > 0 ? results : nullptr, number);
    if (!status)
      return status;
  }
  return Status::success();
}

Status Tape::launch(Launch &launch, Kernel &kernel, const uint64_t *args,
                    uint64_t *results, uint64_t number) {
  return unlessSpoilt(
      [&] { return record(launch, kernel, args, results, number); });
}

//===----------------------------------------------------------------------===//
// Records other than launches: host functions, writes of the host, activity,
// arrays
//===----------------------------------------------------------------------===//

void Tape::recordCallback(TapeCallback callback) {
  if (isSuspended() || !recording())
    return;
  uint32_t index = parts->recording.next();
  parts->memory.endParts(index, static_cast<bool>(callback.backward));
  uint64_t next = parts->services.nextLaunch();
  uint64_t start =
      std::min(std::exchange(parts->suspendedAt, UINT64_MAX), next);
  parts->topology.settle(index);
  parts->recording.addCallback(std::move(callback), start, next);
}

Status Tape::write(const HostWrite &write) {
  return unlessSpoilt([&] { return recordWrite(write); });
}

Status Tape::recordWrite(const HostWrite &write) {
  FieldPtr field =
      parts->services.owner().store().findField(write.field->name());
  if (field.get() != write.field)
    return Status::failure(StatusCode::Internal,
                           "field '" + write.field->name() +
                               "' is not known to its runtime");
  std::unique_ptr<TapeRecording::Write> kept;
  Status status;
  if (!isSuspended())
    kept = TapeRecording::Write::make(field, write, status);
  uint32_t index = parts->recording.next();
  if (status)
    status = parts->holds.add(field, HoldKind::Write);
  if (status)
    status = parts->memory.beforeWrite(field, write.index, index);
  if (!status)
    return status;
  bool isWhole = parts->services.perform(kept ? kept->get() : write,
                                         FieldCopies::Interrupts::Stop);
  parts->memory.settle();
  if (!isWhole)
    return failAsInterrupted();
  if (!kept)
    return status;
  parts->memory.endParts(index, /*readsInReverse=*/false);
  parts->topology.settle(index);
  parts->recording.addWrite(std::move(kept));
  return status;
}

void Tape::watch(const TreePtr &tree) { parts->topology.watch(tree); }

Status Tape::changeActivity(const TreePtr &tree,
                            std::function<Status()> change) {
  return unlessSpoilt([&] { return recordActivity(tree, std::move(change)); });
}

Status Tape::recordActivity(const TreePtr &tree,
                            std::function<Status()> change) {
  watch(tree);
  for (const FieldPtr &field : parts->services.fields()) {
    if (field->sharedTree() != tree || field->isAdjoint() ||
        !field->sparseNode())
      continue;
    Status status = parts->holds.add(field, HoldKind::Write);
    if (status)
      status =
          parts->memory.beforeWrite(field, nullptr, parts->recording.next());
    if (!status)
      return status;
  }
  Status status = change();
  parts->memory.settle();
  recordCallback({std::move(change), nullptr});
  return status;
}

void Tape::noteArrayCopy(uint64_t address, const ArrayRange &array) {
  parts->lost.noteCopy(address, array);
}

void Tape::noteArrayWrite(const ArrayRange &array) {
  parts->lost.noteWrite(parts->recording.size(), array);
}
