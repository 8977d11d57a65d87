//===- TapeServices.h - What tapes ask of the runtime -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// All that the parts of a tape use of a runtime, its kernels and fields beyond
// what these offer to everybody. Everything is inline: the path of a replayed
// launch goes through here.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_TAPESERVICES_H
#define TAI_LIB_RUNTIME_TAPE_TAPESERVICES_H

#include "../Host/HostWrite.h"
#include "../Launch/Launch.h"
#include "../Mirror/DeviceContext.h"
#include "tai/Runtime/Launch/Runtime.h"
#include <algorithm>

namespace mlir::tai::runtime {

class TapeServices {
public:
  explicit TapeServices(Runtime &runtime) : runtime(runtime) {}
  Runtime &owner() const { return runtime; }
  bool isForward() const { return runtime.isForward(); }
  bool skips(Skip skip) const { return runtime.skips(skip); }
  void count(SkipCount what, int64_t n = 1) const {
    runtime.skipCounts.bump(what, n);
  }

  //===--------------------------------------------------------------------===//
  // Launches
  //===--------------------------------------------------------------------===//

  Status ready(Kernel &kernel) const { return runtime.ready(kernel); }
  Status run(Launch &launch, Kernel &kernel, const uint64_t *args,
             uint64_t *results, uint64_t number) const {
    return runtime.run(launch, kernel, args, results, number);
  }
  Status runAdjoint(Launch &launch, Kernel &kernel, Kernel &adjoint,
                    const uint64_t *args, uint64_t number,
                    const LoopLists *given) const {
    return runtime.runAdjoint(launch, kernel, adjoint, args, number, given);
  }
  static Status failureOf(Launch &launch, const Kernel &kernel) {
    return Runtime::failureOf(launch, kernel);
  }
  Launch *acquireLaunch() const { return runtime.acquireLaunch(); }
  void releaseLaunch(Launch *launch) const { runtime.releaseLaunch(launch); }
  void noteFailure(Status status) const {
    runtime.noteFailure(std::move(status));
  }
  uint64_t seed() const { return runtime.opts.seed; }
  /// Whether nothing but the code of kernels runs in a launch, as far as the
  /// runtime is concerned.
  bool runsDirectly() const {
    return runtime.fusesLaunches && !runtime.device && !runtime.isForward() &&
           !runtime.opts.profiler;
  }

  /// The number of the next launch; takes so many of them; and sets it, for
  /// launches that are made again. Returns what it was.
  uint64_t nextLaunch() const {
    return runtime.hot.launches.load(std::memory_order_relaxed);
  }
  uint64_t takeLaunches(uint64_t count) const {
    return runtime.hot.launches.fetch_add(count, std::memory_order_relaxed);
  }
  uint64_t exchangeNextLaunch(uint64_t number) const {
    return runtime.hot.launches.exchange(number);
  }

  //===--------------------------------------------------------------------===//
  // Tapes
  //===--------------------------------------------------------------------===//

  void add(Tape &tape) const { runtime.tapes.push_back(&tape); }
  void remove(Tape &tape) const {
    runtime.tapes.erase(
        std::find(runtime.tapes.begin(), runtime.tapes.end(), &tape));
  }
  void beginRecording(Tape &tape) const { runtime.beginRecording(tape); }
  void endRecording(Tape &tape) const { runtime.endRecording(tape); }
  bool anyRecording() const { return runtime.numRecording > 0; }
  /// Several tapes record at a time.
  bool recordsTogether() const {
    return runtime.recordsTogether.load(std::memory_order_relaxed);
  }
  Status hold(const Tape &tape, Field &field, HoldKind kind) const {
    return runtime.hold(tape, field, kind);
  }
  void release(const Tape &tape, Field &field) const {
    runtime.release(tape, field);
  }
  Status checkHold(const Field &field, HoldKind kind) const {
    return runtime.checkHold(field, kind);
  }
  /// One more tape holds fields, or one less.
  void countHolding(int change) const {
    runtime.numHolding += change;
    runtime.updateLaunchState();
  }
  static bool isOfAnotherThread(const Field &adjoint) {
    return Runtime::isOfAnotherThread(adjoint);
  }
  const FieldPtr &firstOf(const Tree &tree) const {
    return runtime.firstOf(tree);
  }

  /// While it lives, the sweep of a tape has called a function of the host.
  class HostFunction {
  public:
    HostFunction(const TapeServices &services, Tape &tape)
        : runtime(services.runtime),
          outer(std::exchange(runtime.sweeping, &tape)),
          thread(
              std::exchange(runtime.sweepThread, __builtin_thread_pointer())) {}
    ~HostFunction() {
      runtime.sweeping = outer;
      runtime.sweepThread = thread;
    }
    HostFunction(const HostFunction &) = delete;
    HostFunction &operator=(const HostFunction &) = delete;

  private:
    Runtime &runtime;
    Tape *outer;
    const void *thread;
  };

  //===--------------------------------------------------------------------===//
  // Storage
  //===--------------------------------------------------------------------===//

  const std::vector<FieldPtr> &fields() const { return runtime.fieldList; }
  uint64_t epoch() const {
    return runtime.storageEpoch.load(std::memory_order_relaxed);
  }
  /// A number that no plan has had.
  uint64_t nextMark() const { return ++runtime.stamps; }
  void perform(const HostWrite &write) const { runtime.perform(write); }
  Status activateFor(const HostWrite &write) const {
    return runtime.activateFor(write);
  }
  Status change(const HostWrite &write) const { return runtime.change(write); }
  void oweZeros(const FieldPtr &adjoint,
                std::shared_ptr<const OwedZeros> zeros) const {
    runtime.oweZeros(adjoint, std::move(zeros));
  }
  /// Calls body(kernel) for those that there are. Other threads may define
  /// kernels meanwhile.
  template <typename Body> void forEachKernel(const Body &body) const {
    std::lock_guard<std::mutex> lock(runtime.launchMutex);
    for (const std::weak_ptr<Kernel> &entry : runtime.kernelList)
      if (KernelPtr kernel = entry.lock())
        body(*kernel);
  }
  /// True once for each sequence of launches in which derivatives may end, and
  /// for each place where they do.
  bool isNewSequence(size_t hash) const {
    return runtime.sequencesSeen.insert(hash).second;
  }
  bool isNewCut(const std::string &name) const {
    return runtime.cutsSaid.insert(name).second;
  }

private:
  Runtime &runtime;
};

/// The same of kernels.
struct TapedKernel {
  static KernelInfo &info(Kernel &kernel) { return kernel.info; }
  static const KernelInfo &info(const Kernel &kernel) { return kernel.info; }
  static Status bind(Kernel &kernel, uint64_t epoch) {
    return kernel.bind(epoch);
  }
  static std::atomic<uint64_t> &lastLaunch(Kernel &kernel) {
    return kernel.prepared.lastLaunch;
  }
  /// Whether calling the function, with its trees and arguments, is all that a
  /// launch does.
  static bool isDirect(const Kernel &kernel) {
    return kernel.sparseNodes.empty() && kernel.loopLevels.empty() &&
           kernel.info.resultSlots == 0 &&
           kernel.info.callerAdjoints.slots == 0;
  }
  static int32_t call(Kernel &kernel, Launch &launch) {
    launch.trees = kernel.bases.data();
    launch.loopTimes = &kernel.loopTimes;
    return kernel.function.load(std::memory_order_relaxed)(&launch);
  }
  /// What a tape knows of it, if that is the tape with the stamp that has
  /// looked last.
  static const void *knownTo(const Kernel &kernel, uint64_t stamp) {
    return kernel.tapeStamp == stamp ? kernel.tapeUses : nullptr;
  }
  static void setKnown(Kernel &kernel, uint64_t stamp, const void *uses) {
    kernel.tapeUses = uses;
    kernel.tapeStamp = stamp;
  }

  /// Fields whose adjoints its adjoint adds to, fields whose adjoints it reads,
  /// those of them that are overwritten, and adjoints that a launch may change.
  static const std::vector<Field *> &targets(const Kernel &kernel) {
    return kernel.adjointTargets;
  }
  static const std::vector<Field *> &sources(const Kernel &kernel) {
    return kernel.adjointSources;
  }
  static const std::vector<Field *> &overwritten(const Kernel &kernel) {
    return kernel.overwritten;
  }
  static const std::vector<Field *> &changedAdjoints(const Kernel &kernel) {
    return kernel.changedAdjoints;
  }
  static const std::vector<SparseNode *> &sparseNodes(const Kernel &kernel) {
    return kernel.sparseNodes;
  }
  static const AdjointPlan &adjointPlan(const Kernel &kernel) {
    return *kernel.adjointPlan;
  }
  static bool adjointReruns(const Kernel &kernel) {
    return kernel.adjointReruns;
  }
  static bool loadsStored(const Kernel &kernel) { return kernel.loadsStored; }
  /// The adjoint always zeroes the adjoints of what the kernel overwrites.
  static bool alwaysZeroes(const Kernel &kernel) { return kernel.alwaysTakes; }

  /// A form of the adjoint if it has been found, and whether it was asked for.
  static Kernel *known(const Kernel &kernel, bool zeroes, bool stored) {
    return form(kernel, zeroes, stored).known.load(std::memory_order_acquire);
  }
  static bool isAsked(const Kernel &kernel, bool zeroes, bool stored) {
    const Kernel::AdjointForm &found = form(kernel, zeroes, stored);
    return found.known.load(std::memory_order_relaxed) || found.asked;
  }

private:
  static const Kernel::AdjointForm &form(const Kernel &kernel, bool zeroes,
                                         bool stored) {
    return stored ? kernel.storedForms[zeroes] : kernel.adjointForms[zeroes];
  }
};

/// The same of fields.
struct TapedField {
  static const TreePtr &tree(const Field &field) { return field.owner; }
  static const FieldPtr &adjoint(const Field &field) {
    return field.adjointField;
  }
  static uint64_t hostVersion(const Field &field) { return field.hostVersion; }
  static void setClean(Field &field) {
    field.lastWriter.store(0, std::memory_order_relaxed);
  }
  /// Marks of plans; see TapeServices::nextMark.
  static uint64_t &planMark(Field &field) { return field.planMark; }
  static uint64_t planMark(const Field &field) { return field.planMark; }
  /// The number of a field among those that an analysis has seen; `isNew` if
  /// this is the first time, and the number is `next`.
  static size_t number(Field &field, uint64_t mark, size_t next, bool &isNew) {
    isNew = field.seenMark != mark;
    if (isNew) {
      field.seenMark = mark;
      field.seenIndex = next;
    }
    return field.seenIndex;
  }
};

/// A launch for as long as a sweep or a replay takes.
class HeldLaunch {
public:
  explicit HeldLaunch(const TapeServices &services)
      : services(services), launch(services.acquireLaunch()) {}
  ~HeldLaunch() { services.releaseLaunch(launch); }
  HeldLaunch(const HeldLaunch &) = delete;
  HeldLaunch &operator=(const HeldLaunch &) = delete;
  Launch &get() const { return *launch; }

private:
  TapeServices services;
  Launch *launch;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_TAPESERVICES_H
