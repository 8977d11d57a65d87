//===- AdjointHealth.h - Statistics of adjoints in a sweep ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Examines, after the adjoint of each record, the adjoint fields that it has
// added to. No cost unless turned on.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_SWEEP_ADJOINTHEALTH_H
#define TAI_LIB_RUNTIME_TAPE_SWEEP_ADJOINTHEALTH_H

#include "../Record/TapeRecording.h"

namespace mlir::tai::runtime {

class AdjointHealth {
public:
  void watch(bool on) {
    watching = on;
    examined.clear();
  }
  bool isWatching() const { return watching; }
  /// Forgets the findings. Must be called at the start of a sweep.
  void clear() { examined.clear(); }

  /// Examine adjoints after the adjoint of launch `index`, or after the reverse
  /// of host function `index`, when only adjoints of `live` fields can be
  /// non-zero.
  void examine(const TapeRecording &recording, size_t index);
  void examine(size_t index, const std::vector<Field *> &live);

  /// The findings about adjoints in the last sweep, in the order in which it
  /// visited records.
  const std::vector<RecordHealth> &found() const { return examined; }

private:
  void look(size_t index, const Field &field, int64_t dimension,
            int64_t position);

  bool watching = false;
  std::vector<RecordHealth> examined;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_SWEEP_ADJOINTHEALTH_H
