//===- TapePlan.h - The plan of a reverse sweep -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A decision for each record, made once for a sequence of records and a set of
// adjoints that are non-zero at the start of the sweep. A host function may
// change any adjoint, so from there on decisions are made during the sweep,
// from the dirty flags of adjoint fields, which every launch and every write of
// the host maintain. Nothing is launched here.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_PLAN_TAPEPLAN_H
#define TAI_LIB_RUNTIME_TAPE_PLAN_TAPEPLAN_H

#include "KnownPlan.h"
#include "Overwrites.h"

namespace mlir::tai::runtime {

class TapePlan {
public:
  using Decision = PlanDecision;
  static bool isReplayed(Decision decision) {
    return decision == Decision::Replay || decision == Decision::Overwrite ||
           decision == Decision::Unpruned;
  }

  /// Decides on all records from the summaries of kernels. `live`: the fields
  /// whose adjoints may be non-zero at the start. `wanted`: those whose
  /// gradients are asked for; all if there are none.
  void make(const TapeServices &services, const TapeRecording &recording,
            std::vector<Field *> live, const std::vector<FieldPtr> &wanted);
  /// True if decisions for these records exist, whether or not they are still
  /// valid.
  bool isMade(const TapeRecording &recording) const {
    return results.decisions.size() == recording.size();
  }
  /// True if the decisions are valid for this storage epoch and these fields
  /// with non-zero adjoints.
  bool holds(const TapeRecording &recording, uint64_t epoch,
             const std::vector<Field *> &live) const {
    return isMade(recording) && inputs.epoch == epoch && inputs.live == live;
  }
  /// Decides on a record again, from the adjoints that may be non-zero now.
  void decideAgain(const TapeRecording &recording, size_t index);

  Decision operator[](size_t index) const { return results.decisions[index]; }
  /// The records that the sweep replays, from last to first.
  const std::vector<uint32_t> &replayed() const { return results.needed; }
  bool replaysAny() const;
  int64_t numSkipped() const;
  int64_t numUnwanted() const;
  /// The statistics counter for a record that is skipped by the given decision.
  static SkipCount counterOf(Decision decision) {
    return decision == Decision::SkipUnwanted ? SkipCount::UnwantedLaunches
                                              : SkipCount::TapeSkipped;
  }
  /// True if the adjoint of a record must zero the adjoints of elements that
  /// the record overwrites.
  bool zeroesAt(size_t index) const {
    return results.overwrites.isRepeated[index];
  }
  /// Elements whose adjoints the runtime sets to zero after the sweep.
  const Overwrites::Zeros &zerosAfter() const {
    return results.overwrites.storedOnce;
  }

private:
  template <typename Live>
  Decision decide(const TapeRecording &recording, size_t index,
                  const Live &live) const;

  void findUnwanted(const TapeRecording &recording,
                    const std::vector<FieldPtr> &wanted);
  void decideAll(const TapeRecording &recording);

  /// For each record, how much its launch matters for the wanted gradients.
  enum class Interest : uint8_t {
    Leads, // it reads values that depend on wanted fields
    Ends,  // it only overwrites such values
    None
  };
  std::vector<Interest> interests;
  /// The inputs of the plan for which the decisions are valid.
  PlanInputs inputs;
  PlanResults results;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_PLAN_TAPEPLAN_H
