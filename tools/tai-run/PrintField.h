//===- PrintField.h - The contents of a field as text -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TOOLS_TAIRUN_PRINTFIELD_H
#define TAI_TOOLS_TAIRUN_PRINTFIELD_H

#include "tai/Runtime/Launch/Runtime.h"
#include "llvm/Support/raw_ostream.h"

namespace mlir::tai {

/// Prints "@x : 2x3xf32 = [[…], […]]", every number with enough digits to read
/// back the same value.
runtime::Status printField(llvm::raw_ostream &stream,
                           const runtime::Field &field);

} // namespace mlir::tai

#endif // TAI_TOOLS_TAIRUN_PRINTFIELD_H
