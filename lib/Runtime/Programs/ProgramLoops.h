//===- ProgramLoops.h - Loops in sequences of work --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The steps of a simulation repeat, with parameters that are mostly constant or
// grow by a constant each time. Such a run of steps becomes a loop in the code
// of a program: no step is looked up in the table, and most parameters are
// constants of the kernel.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_PROGRAMS_PROGRAMLOOPS_H
#define TAI_LIB_RUNTIME_PROGRAMS_PROGRAMLOOPS_H

#include "tai/Runtime/Programs/ProgramPlan.h"
#include <cstddef>

namespace mlir::tai::runtime {

/// One step of a sequence, as input to the search for loops.
struct LoopStep {
  /// The number of the program part that the step runs; see
  /// tai/ABI/DeviceAbi.h.
  uint64_t part;
  /// Whether a barrier follows.
  bool waits;
  const uint64_t *slots;
  size_t numSlots;
};

/// Divides the steps of a sequence into segments: loops, and rows of a step
/// table for all other steps.
class ProgramLoops {
public:
  ProgramLoops() = default;
  /// Divides `steps` into segments. Without `useLoops`, all steps are rows of
  /// one step table.
  ProgramLoops(const std::vector<LoopStep> &steps, bool useLoops);

  /// True if all steps fit; false if there are too many tile chains, which
  /// cannot be rows of a table.
  bool isComplete() const { return fits; }
  const std::vector<ProgramSegment> &allSegments() const { return segments; }
  /// The number of words of loop parameters.
  size_t numWords() const { return origins.size(); }
  size_t numLoopSteps() const;
  /// The number of words in a row of the step table.
  size_t rowWords() const { return stride; }

  /// Makes parameters and table for steps of the same structure as those of the
  /// constructor. False if they do not fit, because parameters vary differently
  /// from step to step.
  bool pack(const std::vector<LoopStep> &steps, std::vector<uint64_t> &words,
            std::vector<uint64_t> &table) const;

private:
  bool addLoop(const std::vector<LoopStep> &steps, size_t first, size_t period,
               size_t count);
  bool packLoop(const ProgramSegment &segment,
                const std::vector<LoopStep> &steps,
                const std::vector<uint64_t> &words, uint64_t *list) const;

  /// The source of a loop's parameter word: a slot of `step`, or, if
  /// `isGrowth`, the difference of this slot in steps `next` and `step`.
  struct Origin {
    size_t step, slot;
    size_t next;
    bool isGrowth;
  };
  std::vector<ProgramSegment> segments;
  std::vector<Origin> origins;
  size_t stride = 0, tableWords = 0, numSteps = 0;
  bool fits = true;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_PROGRAMS_PROGRAMLOOPS_H
