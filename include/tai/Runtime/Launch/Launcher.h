//===- Launcher.h - The path of a launch ------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A small simulation makes hundreds of thousands of launches, so the common
// path has no lock, allocation or table look-up. Several threads may launch at
// once; a parallel loop that finds the workers busy runs on its own thread.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_LAUNCHER_H
#define TAI_RUNTIME_LAUNCH_LAUNCHER_H

#include "tai/Runtime/Host/Gradients.h"
#include "tai/Runtime/Host/HostWrites.h"
#include "tai/Runtime/Launch/DeviceLaunches.h"
#include "tai/Runtime/Launch/KernelList.h"
#include "tai/Runtime/Launch/Options.h"
#include "tai/Runtime/Launch/RunningLaunches.h"

/// The base class of Runtime. Abi.h only declares this type, and compiled code
/// passes on a pointer to it.
struct TaiRuntime {};

namespace mlir::tai::runtime {

class TangentFlows;
struct Launch;

class Launcher {
public:
  /// References to the parts of the runtime that the launcher uses.
  struct Parts {
    const Options &options;
    const TreeStore &store;
    LaunchState &state;
    Recordings &recordings;
    Gradients &gradients;
    const FieldCopies &copies;
    DeviceHost &devices;
    SkipCounters &counters;
  };
  /// `owner` is TaiFrame::runtime.
  Launcher(TaiRuntime &owner, const Parts &parts);
  ~Launcher();
  Launcher(const Launcher &) = delete;
  Launcher &operator=(const Launcher &) = delete;

  KernelList &kernels() { return kernelList; }
  DeviceLaunches &onDevice() { return deviceLaunches; }
  /// The registry of launches that run at present, on any thread.
  RunningLaunches &running() { return runningLaunches; }

  /// Launches a kernel, and records it if a tape is recording. `results` may be
  /// null for a kernel without results.
  Status launch(Kernel &kernel, const uint64_t *args, int64_t slots,
                uint64_t *results);
  /// Launches the adjoint of `kernel` with the arguments of the primal; no tape
  /// records the launch. Afterwards the adjoints of the elements that the
  /// primal stores are zero.
  Status launchAdjoint(Kernel &kernel, const uint64_t *args, int64_t slots);

  /// Asks running launches to stop at their next safepoint; they fail with
  /// Interrupted. Safe in a signal handler. The request stands until it is
  /// cleared.
  void interrupt() { hot.interrupted.store(true, std::memory_order_relaxed); }
  void clearInterrupt() {
    hot.interrupted.store(false, std::memory_order_relaxed);
  }
  bool interruptRequested() const {
    return hot.interrupted.load(std::memory_order_relaxed);
  }

  /// Sets the seed and restarts the numbering of launches, so that later
  /// launches repeat their random numbers.
  void setSeed(uint64_t seed);
  /// A counter: the number that the next launch gets.
  std::atomic<uint64_t> &numbers() { return hot.launches; }
  const std::atomic<uint64_t> &numbers() const { return hot.launches; }

  /// Counts the writes of all launches from now on in the fields that they
  /// change (Field::numWrites). unknownWrites: a number that changes when a
  /// field may have been written by something that does not count.
  void countWrites();
  uint64_t unknownWrites() const {
    return numUnknown.load(std::memory_order_relaxed);
  }
  void noteUnknownWrites() {
    numUnknown.fetch_add(1, std::memory_order_relaxed);
  }

  /// Tracks the flow of tangents of these fields until forgetTangents().
  /// lostTangents describes where tangents ended on the way to `outputs`, a
  /// line for each place that has not been reported yet.
  OverwriteWatcher *followTangents(const std::vector<FieldPtr> &inputs);
  std::vector<std::string> lostTangents(const std::vector<FieldPtr> &outputs);
  void forgetTangents();

  //===--------------------------------------------------------------------===//
  // Functions for tapes and host programs
  //===--------------------------------------------------------------------===//

  /// Gets a launch object, which the caller must release(). `isUnrecorded`: the
  /// launch is neither recorded by a tape nor part of a reverse sweep.
  Launch *acquire(bool isUnrecorded = false);
  void release(Launch *launch);
  /// Destroys all launch objects; none may be running.
  void dropLaunches();

  Status ready(Kernel &kernel);
  Status run(Launch &launch, Kernel &kernel, const uint64_t *args,
             uint64_t *results, uint64_t number) {
    if (parts.recordings.isForward())
      return runTangent(launch, kernel, args, results, number);
    return runCode(launch, kernel, args, results, number);
  }
  /// Runs `adjoint`, the adjoint of `kernel`. `given`: the cells that the loops
  /// of `kernel` over sparse levels visited; null to visit the currently active
  /// cells.
  Status runAdjoint(Launch &launch, Kernel &kernel, Kernel &adjoint,
                    const uint64_t *args, uint64_t number,
                    const LoopLists *given);
  /// True if a launch is a mere call of the kernel's code: no device, no
  /// profiler, no forward mode.
  bool runsDirectly() const;
  /// Sets whether several consecutive launches may run as one fused launch.
  void setFuse(bool on) { fusesLaunches = on; }
  static Status failureOf(Launch &launch, const Kernel &kernel);

private:
  /// Fills the PreparedLaunch, the data for the fast path, of a kernel that has
  /// been launched.
  void prepare(Kernel &kernel);
  Launch *take();
  bool isReady(const Kernel &kernel) const;
  Status launchPrepared(Kernel &kernel, const uint64_t *args,
                        uint64_t *results);
  Status runCode(Launch &launch, Kernel &kernel, const uint64_t *args,
                 uint64_t *results, uint64_t number);
  Status runBegun(Launch &launch, Kernel &kernel, const uint64_t *args,
                  uint64_t *results, uint64_t number);
  Status runTangent(Launch &launch, Kernel &kernel, const uint64_t *args,
                    uint64_t *results, uint64_t number);
  int32_t runTimed(Launch &launch, Kernel &kernel, TaiKernelFn function);
  void settleZeros(const Kernel &kernel, const uint64_t *args);
  static void countWrites(const Kernel &kernel);
  void takeOverTangents(const Kernel &kernel);
  /// Fail if the kernel (or its adjoint) accesses a field that the tape of
  /// another thread holds in a conflicting way.
  Status checkHolds(const Kernel &kernel) const;
  Status checkAdjointHolds(const Kernel &kernel) const;

  /// The data that each launch reads, in one cache line: a driver call evicts
  /// most of the cache.
  struct alignas(64) Hot {
    /// The storage's epoch while prepared launches are allowed. Otherwise, for
    /// example while a tape records, a number that no epoch has.
    std::atomic<uint64_t> state{1};
    std::atomic<uint64_t> launches{0};
    /// Options::seed.
    uint64_t seed = 0;
    /// The first thread that launches keeps its own launch object, which it
    /// acquires without atomic operations.
    std::atomic<const void *> thread{nullptr};
    std::atomic<Launch *> launch{nullptr};
    bool isTaken = false;
    std::atomic<bool> interrupted{false};
  } hot;

  TaiRuntime &owner;
  const Parts parts;
  DeviceLaunches deviceLaunches;
  KernelList kernelList;
  bool fusesLaunches = true;
  std::atomic<bool> countsWrites{false};
  std::atomic<uint64_t> numUnknown{0};
  std::unique_ptr<TangentFlows> tangentFlows;

  std::atomic<Launch *> spareLaunch{nullptr};
  std::vector<std::unique_ptr<Launch>> launches;
  std::vector<Launch *> freeLaunches;
  RunningLaunches runningLaunches;
  std::mutex mutex;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_LAUNCHER_H
