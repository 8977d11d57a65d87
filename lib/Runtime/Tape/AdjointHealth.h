//===- AdjointHealth.h - What adjoints leave in a sweep ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Looks at the numbers that each replayed record leaves in the adjoints of what
// it has read. It costs nothing while it is not asked for.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_ADJOINTHEALTH_H
#define TAI_LIB_RUNTIME_TAPE_ADJOINTHEALTH_H

#include "TapeRecording.h"

namespace mlir::tai::runtime {

class AdjointHealth {
public:
  void watch(bool on) {
    watching = on;
    examined.clear();
  }
  bool isWatching() const { return watching; }
  /// A sweep begins.
  void clear() { examined.clear(); }

  /// After the adjoint of a launch; and after the reverse of a host function,
  /// where only `live` fields may have adjoints.
  void examine(const TapeRecording &recording, size_t index);
  void examine(size_t index, const std::vector<Field *> &live);

  /// Of the last sweep, in its order.
  const std::vector<RecordHealth> &found() const { return examined; }

private:
  void look(size_t index, const Field &field, int64_t dimension,
            int64_t position);

  bool watching = false;
  std::vector<RecordHealth> examined;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_ADJOINTHEALTH_H
