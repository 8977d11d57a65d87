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
// Adjoints read primal values. Where a launch, a host function or a write of
// the host is about to change what an earlier adjoint reads, the tape keeps the
// old contents; the reverse sweep puts them back at their place, and leaves
// memory as it found it.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_TAPE_TAPE_H
#define TAI_RUNTIME_TAPE_TAPE_H

#include "tai/Runtime/Launch/AccessChecks.h"
#include "tai/Runtime/Launch/Runtime.h"

namespace mlir::tai::runtime {

/// A host function in the sequence. It may be called again by a replay.
struct TapeCallback {
  /// Called by a forward replay in place of what ran when it was recorded; may
  /// be empty.
  std::function<Status()> forward;
  /// Called at its place in the reverse sweep; may be empty.
  std::function<Status()> backward;
};

struct HostWrite;
struct Launch;
struct TapeArrays;
class Checkpoints;
class TapeMemory;
class TapeTopology;
/// What a tape keeps.
struct TapeStats {
  /// Bytes of overwritten values that it keeps now, and most at any time.
  int64_t savedBytes = 0;
  int64_t peakBytes = 0;
  /// With a checkpoint policy: the most snapshots at any time, the bytes of the
  /// largest, how many records have been run again in all sweeps, and how many
  /// a sweep that knew their number beforehand would run again with as many
  /// snapshots, by the binomial formula.
  int64_t snapshots = 0;
  int64_t snapshotBytes = 0;
  int64_t recomputed = 0;
  int64_t optimum = 0;
};

/// How a tape recomputes values instead of saving all that are overwritten.
struct CheckpointPolicy {
  enum class Kind : uint8_t {
    None,     // saves
    Periodic, // snapshots at even distances, saves between two of them
    Binomial, // snapshots alone
    Mixed     // as periodic where the values between two fit
  };
  Kind kind = Kind::None;
  /// Most snapshots; 0 for about the square root of the number of records.
  int64_t snapshots = 0;
  /// Most bytes of snapshots and saved values; 0 for no limit.
  int64_t budget = 0;
};

class Tape final : public Recorder {
public:
  /// As Runtime::beginTape.
  static Status begin(Runtime &runtime, FieldPtr loss, bool clearGradients,
                      std::unique_ptr<Tape> &tape);
  ~Tape() override;
  Tape(const Tape &) = delete;
  Tape &operator=(const Tape &) = delete;

  /// Whether the gradient needs what the field holds. What is recomputed reads
  /// whatever launches read.
  bool minds(const Field &field) const override;
  bool uses(const FieldPtr &field) const override {
    return touched.count(field) != 0;
  }
  bool isSuspended() const override { return suspended > 0; }
  /// Stops recording. Ending twice is harmless. `isSwept`: backward() comes
  /// next, so that a device may run both as one.
  void end(bool isSwept = false);
  bool recording() const;
  /// Lets other threads change what the tape has used. Sweeps do so at their
  /// end.
  void releaseFields();
  /// Sets the gradients to zero that its sweep adds to, and all others that
  /// the calling thread has left.
  Status clearGradients();

  /// Launches between the two are not recorded. Pairs nest.
  void suspend();
  Status resume();

  void recordCallback(TapeCallback callback);

  /// The launch to come gets a copy of an array, and copies it back; and: the
  /// host has changed an array since the last record.
  void noteArrayCopy(uint64_t address, const ArrayRange &array);
  void noteArrayWrite(const ArrayRange &array);

  /// Adds a field that the sweep starts from. A field of one number is a sum:
  /// it is set to zero, and its seed is 1.
  Status addLoss(FieldPtr loss);
  /// What the adjoint of a loss is at the start of a sweep: a row-major array
  /// of the scalar type of the adjoint.
  Status setSeed(const Field &loss, const void *array);

  /// To be called before anything is recorded.
  Status setCheckpoints(CheckpointPolicy policy);

  /// Seeds the adjoints of the losses and replays the adjoints in reverse. Ends
  /// recording first. Fails if an adjoint would read what has been changed
  /// since the last launch of the sequence. Primal fields are as they were
  /// before, whatever was put back in between.
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
    bool stored;
    bool operator==(const Pending &other) const {
      return kernel == other.kernel && takes == other.takes &&
             stored == other.stored;
    }
    /// Makes the adjoint now.
    Status resolve() const;
  };
  /// Adjoints that the reverse sweep would launch and that have not been made,
  /// so that they can be compiled together ahead of it. `cleared`: the
  /// gradients will be cleared before, as a replay does.
  std::vector<Pending> pendingAdjoints(bool cleared = false);
  /// One line for each record: replayed or skipped, and why.
  const std::string &explain();
  TapeStats stats() const;
  /// What a careful user should know about the last sweep, one line each.
  const std::vector<std::string> &warnings() const { return notes; }
  /// Whether the sweep launches the adjoint of the record in the form that
  /// loads what the launch has stored, if there is one.
  bool readsStoredAt(size_t record) const;
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
  /// Whether reverse sweeps from now on examine each adjoint they replay.
  void watchHealth(bool on);
  /// Of the last sweep, in the order of the sweep.
  const std::vector<Health> &health() const { return examined; }

private:
  class HeldLaunch;
  Tape(Runtime &runtime, uint64_t stamp, bool clears);

  enum class Kind : uint8_t { Launch, Callback, Write };
  struct Record {
    Kernel *kernel;   // of a launch
    uint64_t launch;  // number, relative to firstLaunch
    uint64_t payload; // first argument slot, or number of callback or write
    Kind kind = Kind::Launch;
  };
  struct Write;
  struct Loss {
    FieldPtr field;
    /// Of the adjoint; empty for 1.
    std::vector<char> seed;
  };
  enum class Decision : uint8_t {
    Replay,
    SkipNoDerivative, // the kernel has none
    SkipUnreached,    // changes no field with a live adjoint
    SkipNoEffect,     // reads no field with an adjoint, overwrites none
    Callback,
    SkipCallback, // nothing to call in reverse
    Unpruned,     // replayed although it has no effect: pruning is off
    Overwrite     // the adjoint of what the host wrote becomes zero
  };

  /// Launches and records, with its parts where it is made of such.
  Status launch(Launch &launch, Kernel &kernel, const uint64_t *args,
                uint64_t *results, uint64_t number) override;
  Status launchOne(Launch &launch, Kernel &kernel, const void *known,
                   const uint64_t *args, uint64_t *results, uint64_t number);
  Status adopt(Kernel &kernel);
  /// What it knows of a kernel, which it adopts if it has not yet.
  Status findUses(Kernel &kernel, const void *&uses);
  /// Notes what a launch uses, until releaseFields(), and takes over gradients
  /// that other threads have left.
  Status touch(const Kernel &kernel);
  Status touch(const FieldPtr &field, HoldKind kind);
  /// Holds all of that for the calling thread, again.
  Status holdFields();
  void record(Kernel &kernel, const uint64_t *args, uint64_t launch);
  /// Changes a field and records that.
  Status write(const HostWrite &write) override;
  /// To be called before the host makes cells of the tree active.
  void watch(const TreePtr &tree) override;
  /// Changes the activity of a tree on behalf of the host, and records that.
  Status changeActivity(const TreePtr &tree,
                        std::function<Status()> change) override;
  /// Fails if the adjoint of a record asks for activity that the record itself
  /// has changed.
  Status checkActivity(size_t index);
  Status checkActivity(Kernel &kernel, size_t index);
  /// What the loops of a kernel went over that the host function launched whose
  /// reverse is running.
  Status findLoops(Kernel &kernel, LoopLists &lists, bool &found) override;
  Status callReverse(size_t index);
  /// What the reverse sweep does with a record, given which fields are live:
  /// have an adjoint that may be non-zero.
  template <typename Live>
  Decision decide(size_t index, const Live &live) const;
  /// The same where everything that can be replayed is.
  Decision withoutPruning(size_t index, Decision decision) const;
  static bool isReplayed(Decision decision) {
    return decision == Decision::Replay || decision == Decision::Overwrite ||
           decision == Decision::Unpruned;
  }
  /// Decides on all records, from the summaries alone.
  void plan(bool cleared = false);
  bool planHolds(bool cleared = false) const;
  /// The reverse sweep by the plan, or, around callbacks, by what is dirty.
  Status sweepPlanned();
  Status sweepAroundCallbacks();
  /// One record of such a sweep.
  Status reverseRecord(Launch &launch, size_t index);

  // TapeRecompute.cpp
  Status sweepRecomputing();
  Status reverseRange(Launch &launch, size_t from, size_t to);
  Status reverseSaving(Launch &launch, size_t from, size_t to);
  Status recompute(Launch &launch, size_t index, bool saving, size_t oldest);
  Status recomputeRange(Launch &launch, size_t from, size_t to);
  Status runAgain(Launch &launch, size_t index);
  Status runAgain(bool forward, bool reverse);
  Status sweep();
  template <typename Body> Status forEachChange(size_t index, const Body &body);
  bool mayNeed(size_t index) const;
  bool isShort(size_t from, size_t to) const;
  int64_t freeSnapshots() const;
  int64_t bestSnapshots() const;
  /// Runs the adjoint of a record and, where it stored elements again, zeroes
  /// the adjoints of those.
  Status replayAdjoint(Launch &launch, size_t index);
  Status runAdjoint(Launch &launch, size_t index);
  Status findAdjoint(size_t index, Kernel *&adjoint);
  /// Finds the records that store elements which an earlier one has used, and
  /// the elements that others store.
  void findRepeatedStores();
  /// Zeroes the adjoints of the latter, or leaves that to who looks at them.
  void oweZeros();
  Status runForward();
  std::vector<Field *> liveFields(bool cleared = false) const;
  void examine(size_t index);
  void explainStored(size_t index);

  // TapePlain.cpp
  bool isPlain() const;
  /// Whether nothing but calls of kernels, or of adjoints by the plan, is to be
  /// done; and that.
  bool findPlainForward();
  bool findPlainReverse();
  Status runPlainForward(Launch &launch);
  Status runPlainReverse(Launch &launch);
  Status callPlainly(Launch &launch, Kernel &kernel, size_t index);
  void explainPlain();

  Status seed();
  void clearSum(Field &loss);
  bool isLoss(const Field &field) const;
  HostWrite getWrite(const Record &record) const;
  Status overwrite(const HostWrite &write);
  /// Remembers what the fields hold now, and finds out what has changed since.
  void markVersions();
  Status checkVersions();
  void checkEffect();
  // TapeFlows.cpp
  /// Notes derivatives that end in fields or arrays without gradients, where a
  /// record stores to one.
  void noteCuts();
  size_t hashSequence(bool hasArrays) const;

  Runtime &runtime;
  std::vector<Loss> losses;
  uint64_t stamp;
  int suspended = 0;
  std::unique_ptr<AccessChecks> checks;
  std::unique_ptr<TapeMemory> memory;
  std::unique_ptr<TapeTopology> topology;
  std::unique_ptr<TapeArrays> arrays;
  std::unique_ptr<Checkpoints> checkpoints;
  /// How often records were run again, and each of them.
  int64_t recomputed = 0;
  std::vector<uint32_t> recomputedAt;
  bool sweptBefore = false;
  /// Number of the first launch of the host function to come.
  uint64_t suspendedAt = UINT64_MAX;
  std::vector<Record> records;
  std::vector<std::unique_ptr<Write>> writes;
  std::vector<uint64_t> slots;
  std::vector<TapeCallback> callbacks;
  std::vector<KernelPtr> kernels; // keeps the recorded kernels alive
  /// The fields that it uses, and whether it holds them now.
  std::unordered_map<FieldPtr, HoldKind> touched;
  bool holding = false;
  bool isOpen = false;
  bool clears;
  uint64_t firstLaunch = 0;
  uint64_t lastLaunch = 0;
  bool anyLaunch = false;
  /// Changes by the host when the sequence last ran, and the number of the next
  /// launch then.
  std::vector<std::pair<FieldPtr, uint64_t>> versions;
  uint64_t endLaunch = 0;
  /// Some field has changed since then that launches have stored to.
  bool lostStored = false;
  std::vector<std::string> notes;

  /// For each record, whether it stores elements with an adjoint that an
  /// earlier one has used, as far as summaries tell.
  std::vector<bool> storesAgain;
  /// What the others store, which no record has used before: after a sweep the
  /// adjoints of these elements are zero.
  std::vector<std::pair<FieldPtr, std::shared_ptr<const OwedZeros>>> storedOnce;
  bool reverseCallbacks = false;
  /// The host function whose reverse is running.
  size_t reverseFunction = 0;

  bool watching = false;
  std::vector<Health> examined;

  /// The plan of the reverse sweep, and what it holds for.
  std::vector<Decision> decisions;
  std::vector<uint32_t> needed;
  /// Of each of them, where they are called one after another.
  std::vector<Kernel *> plainAdjoints;
  std::vector<Field *> plainTargets;
  std::vector<Field *> plannedLive;
  uint64_t plannedEpoch = 0;
  std::string explanation;
};

inline Status Runtime::beginTape(FieldPtr loss, bool clearGradients,
                                 std::unique_ptr<Tape> &tape) {
  return Tape::begin(*this, std::move(loss), clearGradients, tape);
}

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_TAPE_TAPE_H
