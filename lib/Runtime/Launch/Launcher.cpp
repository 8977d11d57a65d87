//===- Launcher.cpp - The path of a launch --------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/Launcher.h"
#include "TangentFlows.h"
#include "tai/Runtime/Host/ExportedBuffer.h"
#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Launch/Mesh.h"

using namespace mlir::tai;
using namespace mlir::tai::runtime;

Launcher::Launcher(TaiRuntime &owner, const Parts &parts)
    : owner(owner), parts(parts), deviceLaunches(parts.devices, parts.options) {
  hot.seed = parts.options.seed;
  parts.state.publishTo(hot.state);
}

Launcher::~Launcher() = default;

void Launcher::setSeed(uint64_t seed) {
  hot.seed = seed;
  hot.launches.store(0, std::memory_order_relaxed);
  kernelList.forEach([](Kernel &kernel) { kernel.setLastLaunch(0); });
}

OverwriteWatcher *
Launcher::followTangents(const std::vector<FieldPtr> &inputs) {
  tangentFlows = std::make_unique<TangentFlows>(parts.store.fields(), inputs);
  return tangentFlows.get();
}

std::vector<std::string>
Launcher::lostTangents(const std::vector<FieldPtr> &outputs) {
  return tangentFlows
             ? tangentFlows->describe(outputs, parts.recordings.cutsSaid)
             : std::vector<std::string>();
}

void Launcher::forgetTangents() { tangentFlows.reset(); }

bool Launcher::runsDirectly() const {
  return fusesLaunches && !parts.devices.isThere() &&
         !parts.recordings.isForward() && !parts.options.instruments.profiler;
}

inline bool Launcher::isReady(const Kernel &kernel) const {
  return kernel.boundEpoch.load(std::memory_order_acquire) ==
             parts.state.epoch() &&
         kernel.resolved();
}

Status Launcher::ready(Kernel &kernel) {
  Status status = kernel.resolve();
  if (status)
    status = kernel.bind(parts.state.epoch());
  return status;
}

Status Launcher::failureOf(Launch &launch, const Kernel &kernel) {
  Status status =
      launch.hasFailed()
          ? launch.takeFailure()
          : Status::failure(StatusCode::Internal,
                            "kernel '" + kernel.name() + "' failed");
  if (isOnRanks(launch))
    tellRanks(status.message(), kernel.name(), "");
  return status;
}

/// Selects the fields in the trees of the kernel, and the gradients of its
/// fields.
static Gradients::Uses fieldsOf(const Kernel &kernel) {
  return [&](const FieldPtr &field) {
    return kernel.uses(field->tree()) ||
           std::any_of(kernel.summary().begin(), kernel.summary().end(),
                       [&](const Access &access) {
                         return access.field->adjoint() == field.get();
                       });
  };
}

void Launcher::settleZeros(const Kernel &kernel, const uint64_t *args) {
  bool isSettled = false;
  for (const Access &access : kernel.summary()) {
    if (!access.field->owesZeros())
      continue;
    std::shared_ptr<const OwedZeros> zeros = access.field->owedZeros();
    if (!zeros || !mayAlias(*zeros, access, args))
      continue;
    access.field->settleZeros();
    isSettled = true;
  }
  if (isSettled)
    parts.gradients.forgetSettled();
}

void Launcher::countWrites() {
  if (!countsWrites.exchange(true))
    parts.state.beginSpecial();
}

void Launcher::countWrites(const Kernel &kernel) {
  for (const Access &access : kernel.summary())
    if (access.kind != AccessKind::Read)
      access.field->countWrite();
}

Status Launcher::checkHolds(const Kernel &kernel) const {
  Status status;
  for (const Access &access : kernel.summary()) {
    if (access.kind == AccessKind::Read)
      continue;
    if (status)
      status = parts.recordings.check(*access.field, holdKindOf(access.kind));
    if (status && access.field->sparseNode() && access.field->valid())
      status = parts.recordings.checkActivity(access.field->tree());
  }
  return status;
}

Status Launcher::checkAdjointHolds(const Kernel &kernel) const {
  Status status;
  for (const std::vector<Field *> &fields :
       {kernel.bound.adjointTargets, kernel.bound.adjointSources})
    for (Field *field : fields)
      if (status)
        status = parts.recordings.check(*field->adjoint(), HoldKind::Write);
  return status;
}

/// The tangents of a kernel's fields belong to the thread that launches the
/// kernel, from its first launch on: values that another thread has left in a
/// tangent are cleared.
void Launcher::takeOverTangents(const Kernel &kernel) {
  for (const Access &access : kernel.summary()) {
    Field *tangent = access.field->dual();
    if (!tangent)
      continue;
    if (tangent->isDirtiedByOther())
      parts.copies.clear(*tangent);
    tangent->markDirty();
  }
}

Status Launcher::runTangent(Launch &launch, Kernel &kernel,
                            const uint64_t *args, uint64_t *results,
                            uint64_t number) {
  parts.gradients.settle(fieldsOf(kernel));
  Kernel *tangent = nullptr;
  Status status = kernel.resolveTangent(tangent);
  if (status)
    status = kernel.bind(parts.state.epoch());
  if (!status)
    return status;
  for (Field *field : kernel.bound.changedAdjoints)
    field->markDirty();
  if (tangentFlows)
    tangentFlows->launch(kernel, args);
  takeOverTangents(kernel);
  if (countsWrites.load(std::memory_order_relaxed)) {
    countWrites(kernel);
    // The tangents that the launch writes are not in the summary.
    noteUnknownWrites();
  }
  if (tangent == &kernel)
    return runCode(launch, kernel, args, results, number);
  if (!kernel.bound.sparseNodes.empty() && !launch.given)
    kernel.lastActivity.begin(kernel.bound.sparseNodes);
  status = runCode(launch, *tangent, args, results, number);
  if (!launch.loops.empty())
    kernel.lastActivity.noteLoops(launch.loops);
  return status;
}

/// On the CPU, the time of the call is the time of the kernel. On a device, the
/// call only queues work: its time is kept for the trace alone, and loops are
/// timed on the device (see DeviceWatch.h).
int32_t Launcher::runTimed(Launch &launch, Kernel &kernel,
                           TaiKernelFn function) {
  Profiler &profiler = parts.devices.profiler();
  TraceEvent event{};
  event.thread = profiler.thread();
  event.startNs = event.queuedNs = profiler.now();
  int32_t code = function(&launch);
  event.durationNs = profiler.now() - event.startNs;
  Profiler::Item item =
      profiler.find(ProfileKind::Host, kernel.name(), kernel.place());
  if (launch.onDevice && launch.onDevice->code) {
    profiler.keep(item, event);
    return code;
  }
  profiler.count(item, event);
  profiler.noteBytes({kernel.name()}, kernel.touchedBytes());
  return code;
}

Status Launcher::runCode(Launch &launch, Kernel &kernel, const uint64_t *args,
                         uint64_t *results, uint64_t number) {
  while (true) {
    if (__builtin_expect(!isReady(kernel), false)) {
      Status status = ready(kernel);
      if (!status)
        return status;
    }
    if (!launch.passSafepoint())
      return launch.takeFailure();
    launch.begin(kernel);
    if (__builtin_expect(isReady(kernel), true))
      break;
    launch.end();
  }
  Status status;
  // A tape of another thread may have begun to hold fields while this kernel
  // was compiled, so holds are checked again.
  if (__builtin_expect(parts.recordings.areAnyHeld(), false) &&
      launch.isUnrecorded.load(std::memory_order_relaxed)) {
    std::atomic_thread_fence(std::memory_order_seq_cst);
    status = checkHolds(kernel);
  }
  if (status)
    status = runBegun(launch, kernel, args, results, number);
  launch.end();
  return status;
}

Status Launcher::runBegun(Launch &launch, Kernel &kernel, const uint64_t *args,
                          uint64_t *results, uint64_t number) {
  if (__builtin_expect(!results && kernel.resultSlots() > 0, false)) {
    launch.unwanted.resize(static_cast<size_t>(kernel.resultSlots()));
    results = launch.unwanted.data();
  }
  if (kernel.bound.usesAdjoints && parts.gradients.areOwed())
    settleZeros(kernel, args);
  if (__builtin_expect(countsWrites.load(std::memory_order_relaxed), false))
    countWrites(kernel);
  launch.trees = kernel.bound.bases.data();
  launch.loopTimes = &kernel.loopTimes;
  if (__builtin_expect(parts.devices.isThere(), false)) {
    Status status = deviceLaunches.enter(launch, kernel);
    if (!status)
      return status;
  }
  launch.args = args;
  launch.results = results;
  launch.seed = hot.seed;
  launch.launch = number;
  if (__builtin_expect(!launch.loops.empty(), false))
    launch.loops.clear();
  if (__builtin_expect(!kernel.bound.sparseNodes.empty() && !launch.given,
                       false))
    kernel.lastActivity.begin(kernel.bound.sparseNodes);
  int32_t code;
  TaiKernelFn function = kernel.function.load(std::memory_order_relaxed);
  if (!kernel.bound.loopLevels.empty() &&
      parts.options.skips.has(Skip::EmptyLoops) &&
      kernel.bound.hasNoActiveCells() &&
      !(launch.given && launch.given->hasCells())) {
    parts.counters.add(SkipCount::EmptyLaunches);
    // Cells may be active when the adjoint runs, so the record says that this
    // launch visited no cells.
    static const ActiveListPtr none = std::make_shared<const ActiveList>();
    if (!launch.given)
      for (const SparseNode *level : kernel.bound.loopLevels)
        launch.loops.add(*level, none);
    code = 0;
  } else if (__builtin_expect(parts.options.instruments.profiler, false))
    code = runTimed(launch, kernel, function);
  else
    code = function(&launch);
  if (__builtin_expect(parts.devices.isThere(), false))
    deviceLaunches.leave(launch);
  for (Field *field : kernel.bound.changedAdjoints)
    field->markDirty();
  if (launch.arena.used())
    launch.arena.reset();
  if (__builtin_expect(!launch.loops.empty(), false))
    kernel.lastActivity.noteLoops(launch.loops);
  if (__builtin_expect(code != 0 || launch.hasFailed(), false)) {
    launch.freeSinks();
    return failureOf(launch, kernel);
  }
  return Status::success();
}

namespace {
/// A launch object for one call. If memory runs out in the middle of the call,
/// the object is reset before it is released.
class TakenLaunch {
public:
  TakenLaunch(Launcher &launcher, bool isUnrecorded)
      : launcher(launcher), launch(launcher.acquire(isUnrecorded)) {}
  ~TakenLaunch() {
    if (!isFinished)
      launch->recover();
    launcher.release(launch);
  }
  TakenLaunch(const TakenLaunch &) = delete;
  TakenLaunch &operator=(const TakenLaunch &) = delete;
  Launch &operator*() const { return *launch; }

  /// Notes that the call has returned without an exception. A flag costs
  /// nothing; std::uncaught_exceptions() would read thread-local variables
  /// twice in each launch.
  Status finish(Status status) {
    isFinished = true;
    return status;
  }

private:
  Launcher &launcher;
  Launch *launch;
  bool isFinished = false;
};
} // namespace

static Status wrongSlots(const Kernel &kernel, int64_t wanted, int64_t slots) {
  std::string message = "kernel '" + kernel.name() + "' takes " +
                        std::to_string(wanted) + " argument slots, but got " +
                        std::to_string(slots);
  if (wanted != kernel.argSlots())
    message += "; the last " + std::to_string(wanted - kernel.argSlots()) +
               " are for the adjoints of its arguments and results";
  return Status::failure(StatusCode::Usage, std::move(message));
}

/// Fails if an array shares memory with a field that the kernel uses: the
/// kernel's code assumes that arrays and fields do not overlap.
static Status checkLentFields(const Kernel &kernel, const uint64_t *args) {
  for (const Access &access : kernel.summary()) {
    const Field &field = *access.field;
    uint64_t begin = 0, end = 0;
    if (!ExportedBuffer::findBytes(field, begin, end))
      continue;
    for (const ArrayArgument &array : kernel.arrays()) {
      uint64_t from = args[array.slot];
      uint64_t bytes = static_cast<uint64_t>(array.elementBytes);
      for (int64_t d = 1; d <= array.rank; ++d)
        bytes *= args[array.slot + d];
      if (bytes > 0 && from < end && begin < from + bytes)
        return Status::failure(
            StatusCode::Usage,
            "kernel '" + kernel.name() + "' uses field '" + field.name() +
                "' and is given an array that shares its memory; give it a "
                "copy, or let it use one of them alone",
            kernel.place());
    }
  }
  return Status::success();
}

Status Launcher::launch(Kernel &kernel, const uint64_t *args, int64_t slots,
                        uint64_t *results) {
  if (__builtin_expect(ExportedBuffer::areAny(), false) &&
      !kernel.arrays().empty())
    if (Status status = checkLentFields(kernel, args); !status)
      return status;
  const PreparedLaunch &prepared = kernel.prepared;
  if (__builtin_expect(prepared.state.load(std::memory_order_acquire) ==
                               hot.state.load(std::memory_order_relaxed) &&
                           slots == prepared.slots &&
                           (results || !prepared.hasResults) &&
                           !interruptRequested(),
                       true))
    return launchPrepared(kernel, args, results);
  if (safepoint::isInHandler())
    if (Status status = kernel.checkHandler(); !status)
      return status;
  // Only a launch that is recorded needs the addresses of adjoints in its
  // arguments.
  if (__builtin_expect(slots != kernel.tapeSlots(), false)) {
    Recorder *tape = parts.recordings.current();
    bool recorded = tape && !tape->isSuspended();
    if (recorded || slots != kernel.argSlots())
      return wrongSlots(
          kernel, recorded ? kernel.tapeSlots() : kernel.argSlots(), slots);
  }
  Recorder *tape = parts.recordings.current();
  if (__builtin_expect(!tape && parts.recordings.areAnyHeld(), false))
    if (Status status = checkHolds(kernel); !status)
      return status;
  Status status;
  {
    TakenLaunch launch(*this, /*isUnrecorded=*/!tape);
    uint64_t number = hot.launches.fetch_add(1, std::memory_order_relaxed);
    kernel.setLastLaunch(number);
    status =
        launch.finish(__builtin_expect(tape != nullptr, false)
                          ? tape->launch(*launch, kernel, args, results, number)
                          : run(*launch, kernel, args, results, number));
  }
  if (status)
    prepare(kernel);
  return status;
}

Status Launcher::launchAdjoint(Kernel &kernel, const uint64_t *args,
                               int64_t slots) {
  if (slots != kernel.tapeSlots())
    return wrongSlots(kernel, kernel.tapeSlots(), slots);
  Status status;
  if (safepoint::isInHandler())
    status = kernel.checkHandler();
  if (status)
    status = kernel.bind(parts.state.epoch());
  if (!status)
    return status;
  if (__builtin_expect(parts.recordings.areAnyHeld(), false))
    status = checkAdjointHolds(kernel);
  if (!status)
    return status;
  parts.gradients.settle(fieldsOf(kernel));
  const AdjointAccesses &plan = kernel.adjoint().plan();
  if (plan.parts.size() == 1)
    return Status::failure(
        StatusCode::Usage,
        "iterations of a parallel loop of kernel '" + kernel.name() +
            "' may store to one element, or read what another one stores: only "
            "a launch under a tape finds the last of them, to which the "
            "gradient belongs; launch the kernel under a tape, or run the loop "
            "on one thread (ti.loop_config(serialize=True))");
  if (!plan.before.empty() || !plan.parts.empty())
    return Status::failure(
        StatusCode::Usage,
        "the gradient of kernel '" + kernel.name() +
            "' needs values that the kernel itself overwrites, which only a "
            "tape keeps: launch it under a tape, or store the new values to "
            "other elements");
  Kernel *adjoint = nullptr;
  bool canZero = kernel.adjoint().canZero();
  status = kernel.adjoint().resolve(
      adjoint, plan.zeroes || (canZero && !kernel.bound.overwritten.empty()));
  if (!status)
    return status;
  LoopLists loops;
  bool wasLaunched = false;
  if (Recorder *sweep = parts.recordings.sweeping())
    status = sweep->findLoops(kernel, loops, wasLaunched);
  else
    status = kernel.lastActivity.check(kernel, loops, wasLaunched);
  if (!status)
    return status;
  TakenLaunch launch(*this, /*isUnrecorded=*/!parts.recordings.sweeping());
  uint64_t number = kernel.lastLaunch();
  if (adjoint)
    status = runAdjoint(*launch, kernel, *adjoint, args, number,
                        wasLaunched ? &loops : nullptr);
  return launch.finish(std::move(status));
}

Status Launcher::runAdjoint(Launch &launch, Kernel &kernel, Kernel &adjoint,
                            const uint64_t *args, uint64_t number,
                            const LoopLists *given) {
  uint64_t epoch = parts.state.epoch();
  if (__builtin_expect(
          kernel.boundEpoch.load(std::memory_order_acquire) != epoch, false)) {
    Status status = kernel.bind(epoch);
    if (!status)
      return status;
  }
  // The adjoint fields are marked as changed here, because the adjoint kernel
  // may have no summary of its own.
  for (Field *field : kernel.bound.adjointTargets)
    field->adjoint()->markDirty();
  // An adjoint that was written by hand may change any field.
  if (__builtin_expect(countsWrites.load(std::memory_order_relaxed), false) &&
      !kernel.adjoint().canZero())
    noteUnknownWrites();
  launch.given = given;
  launch.primalName = &kernel.name();
  if (!kernel.bound.sparseNodes.empty() &&
      parts.options.skips.has(Skip::ZeroAdjoints) &&
      !parts.recordings.isForward())
    launch.flags = &kernel.adjoint().plan().flags;
  Status status = run(launch, adjoint, args, nullptr, number);
  launch.given = nullptr;
  launch.flags = nullptr;
  launch.filtered.clear();
  launch.fetched.clear();
  return status;
}
