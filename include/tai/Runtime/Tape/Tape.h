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
// then the adjoints of its read fields may be non-zero too.
//
// A launch that overwrites elements used by an earlier launch kills their old
// values: after its adjoint has run, the adjoints of these elements are zeroed.
// Fixed indices (x[t] from x[t-1]) show which accesses are disjoint; adjoints
// are zeroed only where accesses may overlap.
//
// Adjoints read primal values. Before a launch, a host function or a write of
// the host changes values that the adjoint of an earlier record reads, the tape
// saves them; the reverse sweep restores them when needed, and finally restores
// the memory that it found.
//
// A tape is made of parts; see docs/decisions/0025-parts-of-the-tape.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_TAPE_TAPE_H
#define TAI_RUNTIME_TAPE_TAPE_H

#include "tai/Runtime/Launch/Runtime.h"
#include "tai/Runtime/Tape/TapeTypes.h"

namespace mlir::tai::runtime {

class AccessChecks;
struct HostWrite;
struct Launch;

class Tape final : public Recorder {
public:
  /// Starts to record on the calling thread; see Runtime::beginTape. `clears`:
  /// sets gradients to zero first.
  static Status begin(Runtime &runtime, FieldPtr loss, bool clears,
                      std::unique_ptr<Tape> &tape);
  ~Tape() override;
  Tape(const Tape &) = delete;
  Tape &operator=(const Tape &) = delete;

  //===--------------------------------------------------------------------===//
  // Recording
  //===--------------------------------------------------------------------===//

  /// Stops recording. May be called twice. `isSwept`: backward() follows, so
  /// that a device may run the recording and the reverse sweep as one sequence.
  void end(bool isSwept = false);
  bool recording() const;
  /// Releases the fields that the tape holds against other threads. Reverse
  /// sweeps do so at their end.
  void releaseFields();
  /// Sets to zero the gradients that the reverse sweep adds to, and all other
  /// gradients that the calling thread has written.
  Status clearGradients();

  /// Suspend recording, and resume it: launches in between are not recorded.
  /// Calls nest.
  void suspend();
  Status resume();
  bool isSuspended() const override;

  void recordCallback(TapeCallback callback);

  /// Tell the tape of changes to arrays of the host. noteArrayCopy: the next
  /// launch gets a copy, at `address`, of an array of the host. noteArrayWrite:
  /// the host has changed an array since the last record.
  void noteArrayCopy(uint64_t address, const ArrayRange &array);
  void noteArrayWrite(const ArrayRange &array);

  /// Adds a loss, a field that the sweep starts from. A field of one number is
  /// treated as a sum: it is set to zero, and its seed is 1.
  Status addLoss(FieldPtr loss);
  /// Sets the adjoint of a loss at the start of a sweep: a row-major array of
  /// the scalar type of the adjoint.
  Status setSeed(const Field &loss, const void *array);

  /// Asks for the gradients of these fields only: launches that lead to none of
  /// them are not replayed, and after a sweep the gradients of all other fields
  /// that the sweep uses are zero, except those of losses. Call before anything
  /// is recorded.
  Status want(const std::vector<FieldPtr> &fields);

  /// Makes the tape incremental: a launch is recorded, and not run, if an
  /// earlier incremental tape has run it, and the fields that it reads and
  /// writes have not been written since. Call before anything is recorded. A
  /// tape with a checkpoint policy runs all launches.
  Status skipUnchanged();

  /// Sets the checkpoint policy of the tape. Must be called before anything is
  /// recorded.
  Status setCheckpoints(CheckpointPolicy policy);

  /// From now on, checks that launches follow the data access rules. Keeps the
  /// first `limit` violations; with `racesOnly`, only races.
  void checkAccesses(int64_t limit, bool racesOnly);
  /// The checker with the violations of the data access rules; null if accesses
  /// are not checked.
  const AccessChecks *accessChecks() const;

  //===--------------------------------------------------------------------===//
  // Replay
  //===--------------------------------------------------------------------===//

  /// The reverse sweep: ends recording, seeds the adjoints of the losses, and
  /// runs the adjoints in reverse. Fails if an adjoint would read a value that
  /// has been changed since the last launch of the sequence. Primal fields hold
  /// the same values before and after.
  Status backward();

  /// `forward`: runs the recorded launches again on the current contents of the
  /// fields, with new random numbers. `backward`: clears the gradients, then
  /// does backward().
  Status replay(bool forward, bool backward);

  /// Runs one record again, on the current contents of the fields and with the
  /// same random numbers. If another tape is recording, it records that launch.
  Status runRecord(int64_t record);

  //===--------------------------------------------------------------------===//
  // Inspection
  //===--------------------------------------------------------------------===//

  int64_t numRecords() const;
  /// The kernel that record number `record` launches; null for a host function.
  const Kernel *kernelOf(int64_t record) const;
  const uint64_t *argsOf(int64_t record) const;
  /// The number of records that the last reverse sweep skipped (before the
  /// first sweep: that a sweep seeded by the loss alone would skip).
  int64_t numSkipped();
  /// The adjoints that the reverse sweep would launch and that have not been
  /// compiled, so that the caller can compile them together before the sweep.
  /// `cleared`: gradients are cleared before the sweep, as in a replay.
  std::vector<PendingAdjoint> pendingAdjoints(bool cleared = false);
  /// Describes the last sweep, one line for each record: replayed or skipped,
  /// and why.
  const std::string &explain();
  TapeStats stats() const;
  std::vector<FieldOverwrite> overwrites() const;
  /// Warnings about the last reverse sweep, a line for each.
  const std::vector<std::string> &warnings() const;
  /// watchHealth: makes later reverse sweeps examine the result of each
  /// adjoint. health: the findings of the last sweep, in the order of the
  /// sweep.
  void watchHealth(bool on);
  const std::vector<RecordHealth> &health() const;

  //===--------------------------------------------------------------------===//
  // For the runtime
  //===--------------------------------------------------------------------===//

  /// Launches and records a kernel, or the parts that it was split into.
  Status launch(Launch &launch, Kernel &kernel, const uint64_t *args,
                uint64_t *results, uint64_t number) override;
  /// Performs a write of the host, and records it.
  Status write(const HostWrite &write) override;
  /// Notes the activity of the tree's cells. Must be called before the host
  /// activates cells of the tree.
  void watch(const TreePtr &tree) override;
  /// Runs `change`, which changes the activity of a tree, and records it.
  Status changeActivity(const TreePtr &tree,
                        std::function<Status()> change) override;
  /// True if the gradient needs the present values of `field`. With checkpoints
  /// it needs all values that launches read, because sweeps run launches again.
  bool needsValues(const Field &field) const override;
  /// True if the tape holds `field`, or has held it.
  bool uses(const FieldPtr &field) const override;
  /// While the reverse sweep runs a host function backwards: finds the cells
  /// that the loops of `kernel` visited when that function launched it.
  Status findLoops(Kernel &kernel, LoopLists &lists, bool &found) override;

private:
  struct Parts;
  Tape(Runtime &runtime, bool clears);

  Status adopt(Kernel &kernel);
  Status findUses(Kernel &kernel, const void *&uses);
  /// Runs `body`, a part of the recording. If memory runs out in it, the tape
  /// becomes unusable, because its records may lack some of their values; later
  /// calls say so.
  template <typename Body> Status unlessSpoilt(const Body &body);
  Status record(Launch &launch, Kernel &kernel, const uint64_t *args,
                uint64_t *results, uint64_t number);
  Status recordWrite(const HostWrite &write);
  Status recordActivity(const TreePtr &tree, std::function<Status()> change);
  Status runIfChanged(Launch &launch, Kernel &kernel, const uint64_t *args,
                      uint64_t *results, uint64_t number);
  Status launchOne(Launch &launch, Kernel &kernel, const void *known,
                   const uint64_t *args, uint64_t *results, uint64_t number);
  void plan(bool cleared = false);
  bool planHolds(bool cleared = false) const;
  Status sweep();
  Status runPlan();
  void forgetUnwanted();
  Status replayAll(bool forward, bool reverse);
  Status replayForward();

  std::unique_ptr<Parts> parts;
};

inline Status Runtime::beginTape(FieldPtr loss, bool clearGradients,
                                 std::unique_ptr<Tape> &tape) {
  return Tape::begin(*this, std::move(loss), clearGradients, tape);
}

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_TAPE_TAPE_H
