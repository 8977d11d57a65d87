//===- Recordings.h - The tapes of several threads --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Each thread may record a tape, and be in forward mode. What a tape uses, it
// holds: what other threads do to such a field meanwhile fails where it would
// change a gradient; see docs/decisions/0022-tapes-of-threads.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_HOST_RECORDINGS_H
#define TAI_RUNTIME_HOST_RECORDINGS_H

#include "tai/Runtime/Host/OtherLaunches.h"
#include "tai/Runtime/Host/Recorder.h"
#include "tai/Runtime/Storage/TreeStore.h"
#include <unordered_set>

namespace mlir::tai::runtime {

class Recordings {
public:
  Recordings(LaunchState &state, const TreeStore &store)
      : state(state), store(store) {}
  Recordings(const Recordings &) = delete;
  Recordings &operator=(const Recordings &) = delete;

  /// Who knows what other threads run; until then, nothing runs.
  void setLaunches(OtherLaunches *made) { launches = made; }

  //===--------------------------------------------------------------------===//
  // Who records
  //===--------------------------------------------------------------------===//

  /// The tape that records what the calling thread does, or null.
  Recorder *current() const {
    return __builtin_expect(isAny(), false) ? find() : nullptr;
  }
  /// Whether any thread records; and whether, since none did, several have at a
  /// time.
  bool isAny() const {
    return numRecording.load(std::memory_order_relaxed) != 0;
  }
  bool areTogether() const { return together.load(std::memory_order_relaxed); }
  void begin(Recorder &tape);
  void end(Recorder &tape);

  /// Tapes that there are, whether they record or not.
  void add(Recorder &tape) { tapes.push_back(&tape); }
  void remove(Recorder &tape);
  bool areThereTapes() const { return !tapes.empty(); }
  /// Whether the gradient of any of them needs what the field holds.
  bool minds(const Field &field) const;
  /// Numbers of tapes and of their plans.
  uint64_t nextStamp() { return ++stamps; }

  /// The tape whose sweep has called a function of the host on this thread, or
  /// null.
  Recorder *sweeping() const {
    return sweepThread.load(std::memory_order_relaxed) ==
                   __builtin_thread_pointer()
               ? sweeper
               : nullptr;
  }
  /// Around such a call.
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
  /// Of the calling thread.
  void setForward(bool on);

  //===--------------------------------------------------------------------===//
  // Holds
  //===--------------------------------------------------------------------===//

  /// Between the two, a tape may hold fields.
  void beginHolding();
  void endHolding();
  bool areAnyHeld() const {
    return numHolding.load(std::memory_order_relaxed) != 0;
  }
  /// Notes that the tape uses a field. Fails where tapes of other threads use
  /// it so that one of the two would go wrong, or a kernel changes it that
  /// another thread has launched before.
  Status hold(const Recorder &tape, Field &field, HoldKind kind);
  void release(const Recorder &tape, Field &field);
  /// Fails where the calling thread changes what a tape of another thread uses.
  Status check(const Field &field, HoldKind kind) const;
  /// The same for the activity of cells, of which a field stands for all.
  Status checkActivity(const Tree &tree) const;

  /// What tapes have said of gradients that get lost, and for which sets of
  /// kernels, hashed.
  std::unordered_set<size_t> sequencesSeen;
  std::unordered_set<std::string> cutsSaid;

private:
  Recorder *find() const;
  bool isForwardHere() const;
  void letLaunchesSee() const {
    if (launches)
      launches->letThemSee();
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
  /// Of them, and of the holds of all fields.
  mutable std::mutex mutex;
  std::atomic<int> numRecording{0};
  /// Changes whenever recordings do; no two runtimes have the same.
  std::atomic<uint64_t> version{0};
  std::atomic<bool> together{false};
  std::atomic<int> numHolding{0};
  std::atomic<int> numForward{0};
  std::vector<Recorder *> tapes;
  uint64_t stamps = 0;
  Recorder *sweeper = nullptr;
  std::atomic<const void *> sweepThread{nullptr};
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_HOST_RECORDINGS_H
