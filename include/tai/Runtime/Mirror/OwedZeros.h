//===- OwedZeros.h - Zeros that are stored on demand ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// After a reverse sweep the adjoint of an element that the recorded launches
// have overwritten is zero. Most of these elements are never read: they are the
// later slots of a field with a time axis, and are cleared with the whole field
// before the next sweep. So they are zeroed lazily, before the first access of
// the host or of a launch; see docs/decisions/0017-overwritten-gradients.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_MIRROR_OWEDZEROS_H
#define TAI_RUNTIME_MIRROR_OWEDZEROS_H

#include "tai/Runtime/Storage/Field.h"

namespace mlir::tai::runtime {

struct OwedZeros {
  /// A half-open box of positions, counted from 0 along each dimension.
  struct Box {
    std::vector<int64_t> lower, upper;
  };
  std::vector<Box> boxes;

  /// Adds a box of zero elements; merges it with the last box if it continues
  /// the last box along the dimension.
  void add(Box box, int64_t dimension);
  /// True if some box of zero elements covers this position along the
  /// dimension.
  bool contains(int64_t dimension, int64_t position) const;
  void store(const Field &field) const;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_MIRROR_OWEDZEROS_H
