//===- TapeWrite.h - A recorded change by the host --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_TAPEWRITE_H
#define TAI_LIB_RUNTIME_TAPE_TAPEWRITE_H

#include "../Host/HostWrite.h"
#include "tai/Runtime/Tape/Tape.h"

namespace mlir::tai::runtime {

/// Owns what a HostWrite points to.
struct Tape::Write {
  Write(FieldPtr fieldPtr, const HostWrite &write)
      : field(std::move(fieldPtr)), view(write),
        bytes(static_cast<const char *>(write.bytes),
              static_cast<const char *>(write.bytes) + write.numBytes()) {
    if (write.index)
      index.assign(write.index, write.index + field->rank());
  }

  HostWrite get() const {
    HostWrite write = view;
    write.bytes = bytes.data();
    write.index = index.data();
    return write;
  }

  FieldPtr field;
  HostWrite view;
  std::vector<char> bytes;
  std::vector<int64_t> index;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_TAPEWRITE_H
