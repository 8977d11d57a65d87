//===- KnownPlan.h - The last plan of a runtime -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Each iteration of an optimiser records the same launches on a new tape. Their
// plan is the same too, and a comparison of the records costs far less than a
// new plan.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_PLAN_KNOWNPLAN_H
#define TAI_LIB_RUNTIME_TAPE_PLAN_KNOWNPLAN_H

#include "../TapeServices.h"
#include "Overwrites.h"

namespace mlir::tai::runtime {

enum class PlanDecision : uint8_t {
  Replay,
  SkipNoDerivative, // the kernel has no derivative
  SkipUnreached,    // changes no field with a live adjoint
  SkipNoEffect,     // reads no field with an adjoint, overwrites none
  SkipUnwanted,     // leads to no gradient that is wanted
  Callback,
  SkipCallback, // nothing to call in reverse
  Unpruned,     // replayed although it has no effect: pruning is off
  Overwrite     // a write of the host: the adjoint of its elements becomes zero
};

/// The inputs of a plan for the reverse sweep, besides the records, on which
/// its decisions also depend.
struct PlanInputs {
  uint64_t epoch = 0;
  /// The fields whose adjoints may be non-zero at the start, and those whose
  /// gradients are wanted.
  std::vector<Field *> live;
  std::vector<const Field *> wanted;
  bool prunes = true;

  bool operator==(const PlanInputs &other) const {
    return epoch == other.epoch && live == other.live &&
           wanted == other.wanted && prunes == other.prunes;
  }
};

struct PlanResults {
  std::vector<PlanDecision> decisions;
  /// The records that the sweep replays, from last to first.
  std::vector<uint32_t> needed;
  Overwrites overwrites;
};

/// A plan for the reverse sweep, with the launches and inputs that it was made
/// for. Keeps neither kernels nor fields alive.
class KnownPlan {
public:
  /// Copies a plan with its recording and inputs. Null for a recording with
  /// host functions or writes of the host, and for one so long that the copy
  /// would take much memory.
  static std::shared_ptr<const KnownPlan> make(const TapeRecording &recording,
                                               const PlanInputs &inputs,
                                               const PlanResults &results);
  /// If the plan was made for this recording and these inputs, copies the
  /// results and returns true.
  bool find(const TapeRecording &recording, const PlanInputs &inputs,
            PlanResults &results) const;

  const TapeRecording::Launches &recorded() const { return launches; }

private:
  TapeRecording::Launches launches;
  std::vector<std::weak_ptr<Kernel>> kernels;
  PlanInputs inputs;
  /// The results of the plan. The fields in `overwrites.storedOnce` are null;
  /// the member `storedOnce` refers to them weakly.
  PlanResults results;
  std::vector<std::weak_ptr<Field>> storedOnce;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_PLAN_KNOWNPLAN_H
