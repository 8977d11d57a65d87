//===- OwedZeros.h - Zeros that whoever looks stores ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// After a reverse sweep the adjoint of an element that the recorded launches
// have overwritten is zero. Most of these elements nobody ever looks at: they
// are the later slots of a field with a time axis, and are cleared with the
// whole field before the next sweep. So they are zeroed by the first who looks,
// be it the host or a launch; see docs/decisions/0017-overwritten-gradients.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_MIRROR_OWEDZEROS_H
#define TAI_LIB_RUNTIME_MIRROR_OWEDZEROS_H

#include "tai/Runtime/Storage/Field.h"

namespace mlir::tai::runtime {

struct OwedZeros {
  /// Positions along each dimension, counted from 0: the first, and the one
  /// behind the last.
  struct Box {
    std::vector<int64_t> lower, upper;
  };
  std::vector<Box> boxes;

  /// Adds a box; one that goes on where the last has ended becomes part of it.
  void add(Box box, int64_t dimension);
  /// Whether one of the elements has this position along a dimension.
  bool meets(int64_t dimension, int64_t position) const;
  void store(const Field &field) const;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_MIRROR_OWEDZEROS_H
