//===- TapeServices.h - The runtime as seen by tapes ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The operations of a runtime, its kernels and fields that only the parts of a
// tape use. All are inline, because they are on the path of a replayed launch.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_TAPESERVICES_H
#define TAI_LIB_RUNTIME_TAPE_TAPESERVICES_H

#include "tai/Runtime/Host/HostWrite.h"
#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Mirror/DeviceContext.h"
#include "tai/Runtime/Tape/Tape.h"

namespace mlir::tai::runtime {

class TapeServices {
public:
  explicit TapeServices(Runtime &runtime) : runtime(runtime) {}
  Runtime &owner() const { return runtime; }
  bool isForward() const { return runtime.recordings().isForward(); }
  bool skips(Skip skip) const { return runtime.skips(skip); }
  void count(SkipCount what, int64_t n = 1) const {
    runtime.skipCounters().bump(what, n);
  }

  //===--------------------------------------------------------------------===//
  // Launches
  //===--------------------------------------------------------------------===//

  Status ready(Kernel &kernel) const {
    return runtime.launcher().ready(kernel);
  }
  Status run(Launch &launch, Kernel &kernel, const uint64_t *args,
             uint64_t *results, uint64_t number) const {
    return runtime.launcher().run(launch, kernel, args, results, number);
  }
  Status runAdjoint(Launch &launch, Kernel &kernel, Kernel &adjoint,
                    const uint64_t *args, uint64_t number,
                    const LoopLists *given) const {
    return runtime.launcher().runAdjoint(launch, kernel, adjoint, args, number,
                                         given);
  }
  static Status failureOf(Launch &launch, const Kernel &kernel) {
    return Launcher::failureOf(launch, kernel);
  }
  Launch *acquireLaunch() const { return runtime.launcher().acquire(); }
  void releaseLaunch(Launch *launch) const {
    runtime.launcher().release(launch);
  }
  void noteFailure(Status status) const {
    runtime.devices().noteFailure(std::move(status));
  }
  uint64_t seed() const { return runtime.options().seed; }
  /// True if launches need no steps of the runtime around the call of the
  /// kernel's code.
  bool runsDirectly() const { return runtime.launcher().runsDirectly(); }

  /// The number of the next launch; takeLaunches reserves `count` numbers, and
  /// exchangeNextLaunch sets it for re-executed launches; both return the
  /// previous number.
  uint64_t nextLaunch() const {
    return runtime.launcher().numbers().load(std::memory_order_relaxed);
  }
  uint64_t takeLaunches(uint64_t count) const {
    return runtime.launcher().numbers().fetch_add(count,
                                                  std::memory_order_relaxed);
  }
  uint64_t exchangeNextLaunch(uint64_t number) const {
    return runtime.launcher().numbers().exchange(number);
  }

  //===--------------------------------------------------------------------===//
  // Tapes
  //===--------------------------------------------------------------------===//

  void add(Tape &tape) const { runtime.recordings().add(tape); }
  void remove(Tape &tape) const { runtime.recordings().remove(tape); }
  void beginRecording(Tape &tape) const { runtime.recordings().begin(tape); }
  void endRecording(Tape &tape) const { runtime.recordings().end(tape); }
  bool anyRecording() const { return runtime.recordings().isAny(); }
  /// True if several tapes record at the same time.
  bool recordsTogether() const { return runtime.recordings().areTogether(); }
  Status hold(const Tape &tape, Field &field, HoldKind kind) const {
    return runtime.recordings().hold(tape, field, kind);
  }
  void release(const Tape &tape, Field &field) const {
    runtime.recordings().release(tape, field);
  }
  Status checkHold(const Field &field, HoldKind kind) const {
    return runtime.recordings().check(field, kind);
  }
  /// Bracket a period in which a tape holds fields.
  void beginHolding() const { runtime.recordings().beginHolding(); }
  void endHolding() const { runtime.recordings().endHolding(); }
  FieldPtr firstOf(const Tree &tree) const {
    return runtime.store().firstOf(tree);
  }

  /// The scope of a call of a host function by a reverse sweep.
  class HostFunction {
  public:
    HostFunction(const TapeServices &services, Tape &tape)
        : calling(services.runtime.recordings(), tape) {}

  private:
    Recordings::ReverseFunction calling;
  };

  //===--------------------------------------------------------------------===//
  // Storage
  //===--------------------------------------------------------------------===//

  const std::vector<FieldPtr> &fields() const {
    return runtime.store().fields();
  }
  uint64_t epoch() const { return runtime.storageEpoch(); }
  /// Performs a write of the host. Returns false if the host interrupted it.
  bool perform(const HostWrite &write,
               FieldCopies::Interrupts interrupts =
                   FieldCopies::Interrupts::Wait) const {
    return runtime.writes().perform(write, interrupts);
  }
  Status activateFor(const HostWrite &write) const {
    return runtime.writes().activateFor(write);
  }
  Status change(const HostWrite &write) const {
    return runtime.writes().change(write);
  }
  void oweZeros(const FieldPtr &adjoint,
                std::shared_ptr<const OwedZeros> zeros) const {
    runtime.gradients().owe(adjoint, std::move(zeros));
  }
  /// Calls body(kernel) for each kernel of the runtime. Other threads may
  /// create kernels at the same time.
  template <typename Body> void forEachKernel(const Body &body) const {
    runtime.launcher().kernels().forEach(body);
  }
  /// The last plan of a sweep; null if it may not be used again.
  std::shared_ptr<const KnownPlan> knownPlan() const {
    return runtime.recordings().knownPlan();
  }
  void setKnownPlan(std::shared_ptr<const KnownPlan> plan) const {
    runtime.recordings().setKnownPlan(std::move(plan));
  }
  std::shared_ptr<KnownRuns> knownRuns() const {
    return runtime.recordings().knownRuns();
  }
  void setKnownRuns(std::shared_ptr<KnownRuns> runs) const {
    runtime.recordings().setKnownRuns(std::move(runs));
  }
  /// isNewSequence: true at the first call for a sequence, which is then
  /// checked for lost gradients. isNewCut: true at the first call for a place
  /// where gradients are lost.
  bool isNewSequence(size_t hash) const {
    return runtime.recordings().sequencesSeen.insert(hash).second;
  }
  bool isNewCut(const std::string &name) const {
    return runtime.recordings().cutsSaid.insert(name).second;
  }

private:
  Runtime &runtime;
};

/// Owns a launch object for a reverse sweep or a replay.
class HeldLaunch {
public:
  explicit HeldLaunch(const TapeServices &services)
      : services(services), launch(services.acquireLaunch()) {}
  ~HeldLaunch() {
    if (std::uncaught_exceptions() > exceptions)
      launch->recover();
    services.releaseLaunch(launch);
  }
  HeldLaunch(const HeldLaunch &) = delete;
  HeldLaunch &operator=(const HeldLaunch &) = delete;
  Launch &get() const { return *launch; }

private:
  TapeServices services;
  Launch *launch;
  int exceptions = std::uncaught_exceptions();
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_TAPESERVICES_H
