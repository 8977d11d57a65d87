//===- AdjointAccess.h - Marks of accesses to adjoints ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_ADJOINTACCESS_H
#define TAI_LIB_CONVERSION_ADJOINTACCESS_H

#include "llvm/ADT/StringRef.h"

namespace mlir::tai {

/// The attribute that `tai-lower-layout` gives accesses to the adjoint of a
/// field in host code, for `tai-skip-zero-blocks`. Without it, no block is
/// skipped.
constexpr llvm::StringLiteral kAdjointAccess = "tai.adjoint_access";

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_ADJOINTACCESS_H
