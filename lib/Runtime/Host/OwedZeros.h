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

#ifndef TAI_LIB_RUNTIME_HOST_OWEDZEROS_H
#define TAI_LIB_RUNTIME_HOST_OWEDZEROS_H

#include "tai/Runtime/Launch/Kernel.h"

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
  /// Whether a launch may touch one of the elements by this access.
  bool meets(const Access &access, const uint64_t *args) const;
  void store(const Field &field) const;
};

/// The elements of a box in a launch with these arguments, those within the
/// field; false where there are none.
bool findElements(const StoredBox &box, const Field &field,
                  const uint64_t *args, OwedZeros::Box &elements);

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_HOST_OWEDZEROS_H
