//===- BuildId.h - Which build of the compiler this is ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_EXECUTIONENGINE_BUILDID_H
#define TAI_LIB_EXECUTIONENGINE_BUILDID_H

#include "llvm/ADT/StringRef.h"

namespace mlir::tai {

/// Names the version of tai, of LLVM and of the kernel ABI, and the library
/// file that holds this code: object code made by another build is not used.
llvm::StringRef getBuildId();

} // namespace mlir::tai

#endif // TAI_LIB_EXECUTIONENGINE_BUILDID_H
