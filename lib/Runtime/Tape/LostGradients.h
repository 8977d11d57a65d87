//===- LostGradients.h - Gradients that end where there is none -*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A value that is computed from a field with a gradient, kept in a float field
// or an array without one, and read from there on the way to the loss, passes
// no derivative on. That may be meant, and is said once. The look at the
// records is the second step: most sequences have no kernel that could do so,
// or are made of kernels that have been looked at together.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_LOSTGRADIENTS_H
#define TAI_LIB_RUNTIME_TAPE_LOSTGRADIENTS_H

#include "../Launch/FlowTracker.h"
#include "TapeRecording.h"
#include "TapeServices.h"

namespace mlir::tai::runtime {

class LostGradients {
public:
  /// Launches hold addresses. What else tells which of them use the same array:
  /// some memory is a copy for one launch; the host has changed an array before
  /// a record.
  void noteCopy(uint64_t address, const ArrayRange &array) {
    copies[address] = array;
  }
  void noteWrite(size_t record, const ArrayRange &array) {
    written.emplace_back(record, array);
  }

  /// Whether the kernels of the recording could lose a gradient at all.
  static bool mayHave(const TapeRecording &recording);
  /// Adds a line to `notes` for each kernel and place where a derivative ends,
  /// once in a runtime. `live`: fields whose adjoints may be non-zero.
  void find(const TapeServices &services, const TapeRecording &recording,
            const std::vector<Field *> &live,
            std::vector<std::string> &notes) const;

private:
  /// Equal for sequences in which the same is lost.
  size_t hash(const TapeRecording &recording, bool hasArrays) const;

  /// By the address of the copy.
  std::unordered_map<uint64_t, ArrayRange> copies;
  std::vector<std::pair<size_t, ArrayRange>> written;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_LOSTGRADIENTS_H
