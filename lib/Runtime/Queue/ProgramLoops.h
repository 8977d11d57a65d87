//===- ProgramLoops.h - What repeats in a sequence of work ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The steps of a simulation come again and again, with parameters that mostly
// stay as they are or grow by the same amount each time. Such a run of steps
// becomes a loop in the code of a program: no step has to look up what to do,
// and most parameters are constants of the kernel.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_QUEUE_PROGRAMLOOPS_H
#define TAI_LIB_RUNTIME_QUEUE_PROGRAMLOOPS_H

#include "tai/Runtime/Queue/DeviceQueue.h"
#include <cstddef>

namespace mlir::tai::runtime {

/// One step, as far as loops are concerned.
struct LoopStep {
  /// The number of the part; see tai/Runtime/DeviceAbi.h.
  uint64_t part;
  /// Whether all threads meet after it.
  bool waits;
  const uint64_t *slots;
  size_t numSlots;
};

/// The segments of a sequence: loops, and rows of a table for the rest.
class ProgramLoops {
public:
  ProgramLoops() = default;
  /// `useLoops`: otherwise all is one table.
  ProgramLoops(const std::vector<LoopStep> &steps, bool useLoops);

  /// False for more chains than there is room for: they cannot be rows.
  bool isComplete() const { return fits; }
  const std::vector<ProgramSegment> &getSegments() const { return segments; }
  /// How many words of parameters the loops take.
  size_t numWords() const { return origins.size(); }
  size_t numLoopSteps() const;
  /// The words of a row of the table.
  size_t getStride() const { return stride; }

  /// Makes parameters and table for these steps, which are of the same kinds as
  /// the first ones. False if they do not fit: parameters change in another way
  /// from step to step.
  bool pack(const std::vector<LoopStep> &steps, std::vector<uint64_t> &words,
            std::vector<uint64_t> &table) const;

private:
  bool addLoop(const std::vector<LoopStep> &steps, size_t first, size_t period,
               size_t count);
  bool packLoop(const ProgramSegment &segment,
                const std::vector<LoopStep> &steps,
                const std::vector<uint64_t> &words, uint64_t *list) const;

  /// The parameter of the first of two steps that a word is taken from, and,
  /// for what it grows by, that of the second.
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

#endif // TAI_LIB_RUNTIME_QUEUE_PROGRAMLOOPS_H
