//===- LostGradients.h - Gradients lost in plain fields ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// If a value with a derivative is stored in a float field or an array without
// gradient, and read from there on the way to the loss, the derivative is cut
// off. That may be intended, so it is a warning, given once. Records are
// examined in a second step only: most sequences have no kernel that could do
// this, or consist of kernels that have been examined before.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_RECORD_LOSTGRADIENTS_H
#define TAI_LIB_RUNTIME_TAPE_RECORD_LOSTGRADIENTS_H

#include "../TapeServices.h"
#include "TapeRecording.h"
#include "tai/Runtime/Launch/FlowTracker.h"

namespace mlir::tai::runtime {

class LostGradients {
public:
  /// Launches record only the addresses of arrays. noteCopy: `address` holds a
  /// copy of `array` for one launch. noteWrite: the host has changed `array`
  /// before this record.
  void noteCopy(uint64_t address, const ArrayRange &array) {
    copies[address] = array;
  }
  void noteWrite(size_t record, const ArrayRange &array) {
    written.emplace_back(record, array);
  }

  /// True if kernels of the recording could lose a gradient at all.
  static bool mayHave(const TapeRecording &recording);
  /// Adds a line to `notes` for each kernel and source location where a
  /// derivative is cut off, once in a runtime. `live`: fields whose adjoints
  /// may be non-zero.
  void find(const TapeServices &services, const TapeRecording &recording,
            const std::vector<Field *> &live,
            std::vector<std::string> &notes) const;

private:
  /// A hash that is equal for sequences that lose the same gradients.
  size_t hash(const TapeRecording &recording, bool hasArrays) const;

  /// The arrays of which launches got copies, by the address of the copy.
  std::unordered_map<uint64_t, ArrayRange> copies;
  std::vector<std::pair<size_t, ArrayRange>> written;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_RECORD_LOSTGRADIENTS_H
