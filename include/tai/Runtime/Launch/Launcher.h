//===- Launcher.h - The way of a launch -------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Of launches a small simulation makes hundreds of thousands: no lock, no
// allocation, no look-up. They may come from several threads at once; a
// parallel loop that finds the workers taken runs on its own thread.
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

/// What the opaque pointer of Abi.h points to.
struct TaiRuntime {};

namespace mlir::tai::runtime {

class TangentFlows;
struct Launch;

class Launcher {
public:
  /// What it goes by.
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
  /// `owner` is what frames point to.
  Launcher(TaiRuntime &owner, const Parts &parts);
  ~Launcher();
  Launcher(const Launcher &) = delete;
  Launcher &operator=(const Launcher &) = delete;

  KernelList &kernels() { return kernelList; }
  DeviceLaunches &onDevice() { return deviceLaunches; }
  /// Which kernels run.
  RunningLaunches &running() { return runningLaunches; }

  /// Launches and, where a tape records, records. `results` may be null for a
  /// kernel without results.
  Status launch(Kernel &kernel, const uint64_t *args, int64_t slots,
                uint64_t *results);
  /// Launches the adjoint with the arguments of the primal; never recorded. The
  /// adjoints of the elements that the primal stores are zero afterwards.
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

  /// Also restarts the numbering of launches, so that what follows draws the
  /// same random numbers again.
  void setSeed(uint64_t seed);
  /// The number of the next launch.
  std::atomic<uint64_t> &numbers() { return hot.launches; }
  const std::atomic<uint64_t> &numbers() const { return hot.launches; }

  /// Follows the tangents of these fields until they are forgotten; and: what
  /// has ended them on the way to the others, one line each, said once.
  OverwriteWatcher *followTangents(const std::vector<FieldPtr> &inputs);
  std::vector<std::string> lostTangents(const std::vector<FieldPtr> &outputs);
  void forgetTangents();

  //===--------------------------------------------------------------------===//
  // For tapes and host programs
  //===--------------------------------------------------------------------===//

  /// The state of a launch, to be given back. `isPlain`: for one that no tape
  /// makes.
  Launch *acquire(bool isPlain = false);
  void release(Launch *launch);
  /// Those that there are go; none may run.
  void dropLaunches();

  Status ready(Kernel &kernel);
  Status run(Launch &launch, Kernel &kernel, const uint64_t *args,
             uint64_t *results, uint64_t number) {
    if (parts.recordings.isForward())
      return runTangent(launch, kernel, args, results, number);
    return runCode(launch, kernel, args, results, number);
  }
  /// `given`: what the loops of the primal over sparse levels went over; null
  /// for what is active now.
  Status runAdjoint(Launch &launch, Kernel &kernel, Kernel &adjoint,
                    const uint64_t *args, uint64_t number,
                    const LoopLists *given);
  /// Whether there is nothing to do around the code of kernels.
  bool runsPlainly() const;
  /// Whether launches that come one after another may become one piece of work.
  void setFuse(bool on) { fusesLaunches = on; }
  static Status failureOf(Launch &launch, const Kernel &kernel);

private:
  /// Finds out what the launches of a kernel that has been launched have in
  /// common.
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
  void takeOverTangents(const Kernel &kernel);
  /// Fails where the calling thread changes what a tape of another thread uses.
  Status checkHolds(const Kernel &kernel) const;
  Status checkAdjointHolds(const Kernel &kernel) const;

  /// What each launch looks at, side by side: after a call of a driver little
  /// else is in the caches.
  struct alignas(64) Hot {
    /// The epoch of the storage where launches that have been prepared go their
    /// short way, and never while a tape records, for example.
    std::atomic<uint64_t> state{1};
    std::atomic<uint64_t> launches{0};
    /// As in the options.
    uint64_t seed = 0;
    /// The thread that has launched first has a launch of its own, for which it
    /// needs no atomic operation.
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
  std::unique_ptr<TangentFlows> tangentFlows;

  std::atomic<Launch *> spareLaunch{nullptr};
  std::vector<std::unique_ptr<Launch>> launches;
  std::vector<Launch *> freeLaunches;
  RunningLaunches runningLaunches;
  std::mutex mutex;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_LAUNCHER_H
