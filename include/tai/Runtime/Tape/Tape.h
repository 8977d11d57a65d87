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
  /// Starts to record on the calling thread; see Runtime::beginTape. `stamp`: a
  /// number that no other tape of the runtime has. `clears`: sets gradients to
  /// zero first.
  static Status begin(Runtime &runtime, uint64_t stamp, FieldPtr loss,
                      bool clears, std::unique_ptr<Tape> &tape);
  ~Tape() override;
  Tape(const Tape &) = delete;
  Tape &operator=(const Tape &) = delete;

  //===--------------------------------------------------------------------===//
  // Recording
  //===--------------------------------------------------------------------===//

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
  bool isSuspended() const override;

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

  /// Checks the access rules in the launches from now on; the first `limit`
  /// violations are kept; of races alone, if so asked.
  void checkAccesses(int64_t limit, bool racesOnly);
  /// What has been found, or null where nothing is checked.
  const AccessChecks *accessChecks() const;

  //===--------------------------------------------------------------------===//
  // Replay
  //===--------------------------------------------------------------------===//

  /// Seeds the adjoints of the losses and replays the adjoints in reverse. Ends
  /// recording first. Fails if an adjoint would read what has been changed
  /// since the last launch of the sequence. Primal fields are as they were
  /// before, whatever was put back in between.
  Status backward();

  /// Runs the recorded launches again on the present contents of the fields.
  /// backward: clears the gradients, then as backward(). Random numbers are
  /// drawn anew by a forward replay.
  Status replay(bool forward, bool backward);

  /// Launches one record again, on what the fields hold now and with the random
  /// numbers it had. Another tape that records records it.
  Status runRecord(int64_t record);

  //===--------------------------------------------------------------------===//
  // What one sees
  //===--------------------------------------------------------------------===//

  int64_t numRecords() const;
  /// The kernel of a record, or null for a host function.
  const Kernel *kernelOf(int64_t record) const;
  const uint64_t *argsOf(int64_t record) const;
  /// Records that the last reverse sweep skipped (before the first: that one
  /// seeded by the loss alone would).
  int64_t numSkipped();
  /// Adjoints that the reverse sweep would launch and that have not been made,
  /// so that they can be compiled together ahead of it. `cleared`: the
  /// gradients will be cleared before, as a replay does.
  std::vector<PendingAdjoint> pendingAdjoints(bool cleared = false);
  /// One line for each record: replayed or skipped, and why.
  const std::string &explain();
  TapeStats stats() const;
  std::vector<FieldOverwrite> overwrites() const;
  /// What a careful user should know about the last sweep, one line each.
  const std::vector<std::string> &warnings() const;
  /// Whether reverse sweeps from now on examine each adjoint they replay, and
  /// what the last one found, in its order.
  void watchHealth(bool on);
  const std::vector<RecordHealth> &health() const;

  //===--------------------------------------------------------------------===//
  // For the runtime
  //===--------------------------------------------------------------------===//

  /// Launches and records, with its parts where it is made of such.
  Status launch(Launch &launch, Kernel &kernel, const uint64_t *args,
                uint64_t *results, uint64_t number) override;
  /// Changes a field on behalf of the host, and records that.
  Status write(const HostWrite &write) override;
  /// To be called before the host makes cells of the tree active.
  void watch(const TreePtr &tree) override;
  /// Changes the activity of a tree on behalf of the host, and records that.
  Status changeActivity(const TreePtr &tree,
                        std::function<Status()> change) override;
  /// Whether the gradient needs what the field holds. What is recomputed reads
  /// whatever launches read.
  bool minds(const Field &field) const override;
  /// Whether it holds the field, or has.
  bool uses(const FieldPtr &field) const override;
  /// What the loops of a kernel went over that the host function launched whose
  /// reverse is running.
  Status findLoops(Kernel &kernel, LoopLists &lists, bool &found) override;

private:
  struct Parts;
  Tape(Runtime &runtime, uint64_t stamp, bool clears);

  Status adopt(Kernel &kernel);
  Status findUses(Kernel &kernel, const void *&uses);
  Status launchOne(Launch &launch, Kernel &kernel, const void *known,
                   const uint64_t *args, uint64_t *results, uint64_t number);
  void plan(bool cleared = false);
  bool planHolds(bool cleared = false) const;
  Status sweep();
  Status runPlan();
  Status replayAll(bool forward, bool reverse);
  Status replayForward();

  std::unique_ptr<Parts> parts;
};

inline Status Runtime::beginTape(FieldPtr loss, bool clearGradients,
                                 std::unique_ptr<Tape> &tape) {
  return Tape::begin(*this, tapes.nextStamp(), std::move(loss), clearGradients,
                     tape);
}

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_TAPE_TAPE_H
