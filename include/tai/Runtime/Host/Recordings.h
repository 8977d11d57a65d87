//===- Recordings.h - The tapes of several threads --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Each thread may record a tape, and be in forward mode. A tape holds the
// fields that it uses: an access of another thread to a held field fails if it
// would change a gradient; see docs/decisions/0022-tapes-of-threads.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_HOST_RECORDINGS_H
#define TAI_RUNTIME_HOST_RECORDINGS_H

#include "tai/Runtime/Host/OtherLaunches.h"
#include "tai/Runtime/Host/Recorder.h"
#include "tai/Runtime/Storage/TreeStore.h"
#include <unordered_set>

namespace mlir::tai::runtime {

class KnownPlan;
class KnownRuns;

class Recordings {
public:
  Recordings(LaunchState &state, const TreeStore &store)
      : state(state), store(store) {}
  Recordings(const Recordings &) = delete;
  Recordings &operator=(const Recordings &) = delete;

  /// Sets the registry of running launches; null means that no launch runs.
  void setLaunches(OtherLaunches *made) { launches = made; }

  //===--------------------------------------------------------------------===//
  // Recording
  //===--------------------------------------------------------------------===//

  /// The tape that records the calling thread, or null.
  Recorder *current() const {
    return __builtin_expect(isAny(), false) ? find() : nullptr;
  }
  /// isAny: true if any thread records a tape. areTogether: true if several
  /// threads have recorded at the same time since the last moment at which no
  /// thread recorded.
  bool isAny() const {
    return numRecording.load(std::memory_order_relaxed) != 0;
  }
  bool areTogether() const { return together.load(std::memory_order_relaxed); }
  void begin(Recorder &tape);
  void end(Recorder &tape);

  /// Registers a tape of any thread, whether it records at present or not.
  void add(Recorder &tape);
  void remove(Recorder &tape);
  bool areThereTapes() const {
    return numTapes.load(std::memory_order_relaxed) != 0;
  }
  /// True if the gradient of any registered tape needs the present values of
  /// `field`.
  bool needsValues(const Field &field) const;

  /// The tape whose sweep is calling a function of the host on this thread, or
  /// null.
  Recorder *sweeping() const {
    return sweepThread.load(std::memory_order_relaxed) ==
                   __builtin_thread_pointer()
               ? sweeper
               : nullptr;
  }
  /// The scope of a call of a host function by a reverse sweep.
  class ReverseFunction {
  public:
    ReverseFunction(Recordings &recordings, Recorder &tape);
    ~ReverseFunction();
    ReverseFunction(const ReverseFunction &) = delete;
    ReverseFunction &operator=(const ReverseFunction &) = delete;

  private:
    Recordings &recordings;
    Recorder *outer;
    const void *outerThread;
  };

  //===--------------------------------------------------------------------===//
  // Forward mode
  //===--------------------------------------------------------------------===//

  bool isForward() const {
    return __builtin_expect(numForward.load(std::memory_order_relaxed) != 0,
                            false) &&
           isForwardHere();
  }
  /// Turns forward mode on or off for the calling thread.
  void setForward(bool on);

  //===--------------------------------------------------------------------===//
  // Holds
  //===--------------------------------------------------------------------===//

  /// Bracket a period in which some tape may hold fields; calls nest.
  void beginHolding();
  void endHolding();
  bool areAnyHeld() const {
    return numHolding.load(std::memory_order_relaxed) != 0;
  }
  /// Registers that the tape uses a field. Fails on a conflict with a hold of
  /// another thread's tape, or if a running kernel of another thread changes
  /// the field.
  Status hold(const Recorder &tape, Field &field, HoldKind kind);
  void release(const Recorder &tape, Field &field);
  /// Fails if an access of this kind to `field` by the calling thread conflicts
  /// with a hold of another thread's tape.
  Status check(const Field &field, HoldKind kind) const;
  /// Fails if a change of the activity of a tree's cells conflicts with a hold
  /// of another thread's tape.
  Status checkActivity(const Tree &tree) const;

  /// The last plan for a reverse sweep that a tape of any thread has made, or
  /// null.
  std::shared_ptr<const KnownPlan> knownPlan() const;
  void setKnownPlan(std::shared_ptr<const KnownPlan> plan);

  /// The launches of incremental tapes, of the last tape that used them; null
  /// before the first one.
  std::shared_ptr<KnownRuns> knownRuns() const;
  void setKnownRuns(std::shared_ptr<KnownRuns> runs);

  /// sequencesSeen: hashes of the kernel sequences that have been checked for
  /// lost gradients. cutsSaid: the warnings about lost gradients already given.
  std::unordered_set<size_t> sequencesSeen;
  std::unordered_set<std::string> cutsSaid;

private:
  Recorder *find() const;
  bool isForwardHere() const;
  void publishState() const {
    if (launches)
      launches->publishState();
  }
  Status noteHold(const Recorder &tape, Field &field, HoldKind kind);
  Status checkRunning(const Field &field, HoldKind kind);
  Status describe(const Field &field, HoldKind kind, const Hold &other) const;

  LaunchState &state;
  const TreeStore &store;
  OtherLaunches *launches = nullptr;
  struct Recording {
    uint64_t thread;
    Recorder *tape;
  };
  std::vector<Recording> recordings;
  /// Guards `recordings`, and the holds of all fields.
  mutable std::mutex mutex;
  std::atomic<int> numRecording{0};
  /// A number that changes whenever a thread begins or ends to record; no two
  /// runtimes ever use the same number.
  std::atomic<uint64_t> version{0};
  std::atomic<bool> together{false};
  std::atomic<int> numHolding{0};
  std::atomic<int> numForward{0};
  /// Tapes that record or have recorded, guarded by `tapesMutex`, which is also
  /// held while tapes are asked whether they need values.
  std::vector<Recorder *> tapes;
  mutable std::mutex tapesMutex;
  std::shared_ptr<const KnownPlan> lastPlan; // guarded by tapesMutex
  std::shared_ptr<KnownRuns> runs;           // guarded by tapesMutex
  std::atomic<size_t> numTapes{0};
  Recorder *sweeper = nullptr;
  std::atomic<const void *> sweepThread{nullptr};
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_HOST_RECORDINGS_H
