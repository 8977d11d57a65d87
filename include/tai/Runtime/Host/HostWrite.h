//===- HostWrite.h - Changes that the host makes to fields ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A write of the host as data: a tape records it and repeats it in a forward
// replay.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_HOST_HOSTWRITE_H
#define TAI_RUNTIME_HOST_HOSTWRITE_H

#include "tai/Runtime/Storage/Field.h"

namespace mlir::tai::runtime {

struct HostWrite {
  enum class What : uint8_t { Fill, Array, Element };

  What what;
  Field *field;
  /// The value that the host writes: one scalar of the field's type or, for an
  /// array, all scalars.
  const void *bytes;
  /// For `What::Element`.
  const int64_t *index = nullptr;
  int64_t component = 0;

  /// True if the write overwrites the whole field.
  bool replacesAll() const {
    return what != What::Element ||
           field->numElements() * field->numComponents() == 1;
  }
  int64_t numBytes() const {
    return what == What::Array ? field->hostBytes() : byteSize(field->scalar());
  }
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_HOST_HOSTWRITE_H
