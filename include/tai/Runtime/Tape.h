//===- Tape.h - Recorded launches and their reverse replay ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The tape is data: a list of (kernel, argument slots). The reverse sweep
// launches the adjoints in reverse order, and only those that can contribute: a
// launch is needed if it changes a field whose adjoint may be non-zero, and
// then the adjoints of what it reads may be non-zero too.
//
// A launch that stores elements again ends the life of what stood there and was
// written or read before: after its adjoint has run, the adjoints of these
// elements are zeroed. Indices that are fixed in a launch (x[t] from x[t-1])
// tell which accesses do not meet; only where they may meet is anything zeroed.
//
// The tape claims nothing about values that a later launch overwrote and the
// adjoint of an earlier one reads. `overwrites` lists the candidates for a
// checkpoint planner.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_TAPE_H
#define TAI_RUNTIME_TAPE_H

#include "tai/Runtime/AccessChecks.h"
#include "tai/Runtime/Kernel.h"

namespace mlir::tai::runtime {

/// A host function in the sequence. It may be called again by a replay.
struct TapeCallback {
  /// Called by a forward replay in place of what ran when it was recorded; may
  /// be empty.
  std::function<Status()> forward;
  /// Called at its place in the reverse sweep; may be empty.
  std::function<Status()> backward;
};

struct Launch;

class Tape {
public:
  /// Made by Runtime::beginTape.
  ~Tape();
  Tape(const Tape &) = delete;
  Tape &operator=(const Tape &) = delete;

  /// Stops recording. Ending twice is harmless.
  void end();
  bool recording() const;

  /// Launches between the two are not recorded. Pairs nest.
  void suspend() { ++suspended; }
  Status resume();

  void recordCallback(TapeCallback callback);

  /// Seeds the adjoint of the loss with 1 (if there is a loss) and replays the
  /// adjoints in reverse. Ends recording first.
  Status backward();

  /// Runs the recorded launches again on the present contents of the fields.
  /// backward: clears the gradients, then as backward(). Random numbers are
  /// drawn anew by a forward replay.
  Status replay(bool forward, bool backward);

  /// Checks the access rules in the launches from now on; the first `limit`
  /// violations are kept; of races alone, if so asked.
  void checkAccesses(int64_t limit, bool racesOnly) {
    checks = std::make_unique<AccessChecks>(runtime, limit, racesOnly);
  }
  /// What has been found, or null where nothing is checked.
  const AccessChecks *accessChecks() const { return checks.get(); }
  /// What checks the next launch, or null.
  AccessChecks *activeChecks() const {
    return suspended ? nullptr : checks.get();
  }

  int64_t numRecords() const { return static_cast<int64_t>(records.size()); }
  /// Records that the last reverse sweep skipped (before the first: that one
  /// seeded by the loss alone would).
  int64_t numSkipped();
  /// An adjoint, in one of its two forms.
  struct Pending {
    Kernel *kernel;
    bool takes;
    bool operator==(const Pending &other) const {
      return kernel == other.kernel && takes == other.takes;
    }
  };
  /// Adjoints that the reverse sweep would launch and that have not been made,
  /// so that they can be compiled together ahead of it.
  std::vector<Pending> pendingAdjoints();
  /// One line for each record: replayed or skipped, and why.
  const std::string &explain();
  /// Whether the sweep launches the adjoint of the record in the form that
  /// takes.
  bool takesAt(int64_t record) const { return storesAgain[record]; }

  /// A launch that writes a field which an earlier record reads or writes.
  struct Overwrite {
    int64_t record;
    const Field *field;
    int64_t earlier; // the last such record before it
  };
  std::vector<Overwrite> overwrites() const;

  //===--------------------------------------------------------------------===//
  // Tools for trust (TapeTrust.cpp)
  //===--------------------------------------------------------------------===//

  /// Launches one record again, on what the fields hold now and with the random
  /// numbers it had. Another tape that records records it.
  Status runRecord(int64_t record);
  /// The kernel of a record, or null for a host function.
  const Kernel *kernelOf(int64_t record) const {
    return records[record].kernel;
  }
  const uint64_t *argsOf(int64_t record) const {
    return slots.data() + records[record].payload;
  }

  /// What the adjoint of a record left in the adjoint of a field that it adds
  /// to; of the elements at the record's fixed index, where it has one. For a
  /// host function, one line for each adjoint that may be non-zero.
  struct Health {
    int64_t record;
    const Field *field;
    int64_t nans;
    int64_t infs;
    double maxAbs;     // of the finite numbers
    double sumSquares; // of the finite numbers
  };
  /// Whether reverse sweeps from now on treat every element that is stored as
  /// one that was used before, so that all gradients are by what the fields
  /// held at the start.
  void takeAll(bool on) {
    takesAll = on;
    decisions.clear();
  }
  /// Whether reverse sweeps from now on examine each adjoint they replay.
  void watchHealth(bool on);
  /// Of the last sweep, in the order of the sweep.
  const std::vector<Health> &health() const { return examined; }

private:
  friend class Runtime;
  class HeldLaunch;
  Tape(Runtime &runtime, FieldPtr loss, uint64_t stamp);

  struct Record {
    Kernel *kernel;   // null for a callback
    uint64_t launch;  // number, relative to firstLaunch
    uint64_t payload; // first argument slot, or number of the callback
  };
  enum class Decision : uint8_t {
    Replay,
    SkipNoDerivative, // the kernel has none
    SkipUnreached,    // changes no field with a live adjoint
    SkipNoEffect,     // reads no field with an adjoint, overwrites none
    Callback,
    SkipCallback // nothing to call in reverse
  };

  /// Called by the launch.
  void record(Kernel &kernel, const uint64_t *args, uint64_t launch);
  /// What the reverse sweep does with a record, given which fields are live:
  /// have an adjoint that may be non-zero.
  template <typename Live>
  Decision decide(size_t index, const Live &live) const;
  /// Decides on all records, from the summaries alone.
  void plan();
  bool planHolds() const;
  /// The reverse sweep by the plan, or, around callbacks, by what is dirty.
  Status sweepPlanned();
  Status sweepAroundCallbacks();
  /// Runs the adjoint of a record and, where it stored elements again, zeroes
  /// the adjoints of those.
  Status replayAdjoint(Launch &launch, size_t index);
  /// Finds the records that store elements which an earlier one has used.
  void findRepeatedStores();
  Status runForward();
  std::vector<Field *> liveFields() const;
  void examine(size_t index);

  Runtime &runtime;
  FieldPtr loss;
  uint64_t stamp;
  int suspended = 0;
  std::unique_ptr<AccessChecks> checks;
  std::vector<Record> records;
  std::vector<uint64_t> slots;
  std::vector<TapeCallback> callbacks;
  std::vector<KernelPtr> kernels; // keeps the recorded kernels alive
  uint64_t firstLaunch = 0;
  uint64_t lastLaunch = 0;
  bool anyLaunch = false;

  /// For each record, whether it stores elements with an adjoint that an
  /// earlier one has used, as far as summaries tell.
  std::vector<bool> storesAgain;
  bool reverseCallbacks = false;

  bool takesAll = false;
  bool watching = false;
  std::vector<Health> examined;

  /// The plan of the reverse sweep, and what it holds for.
  std::vector<Decision> decisions;
  std::vector<uint32_t> needed;
  std::vector<Field *> plannedLive;
  uint64_t plannedEpoch = 0;
  std::string explanation;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_TAPE_H
