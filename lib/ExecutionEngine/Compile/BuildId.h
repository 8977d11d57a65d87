//===- BuildId.h - Identity of the compiler build ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_EXECUTIONENGINE_COMPILE_BUILDID_H
#define TAI_LIB_EXECUTIONENGINE_COMPILE_BUILDID_H

#include "mlir/IR/MLIRContext.h"
#include <string>

namespace mlir::tai {

/// Identifies all code that can take part in a compilation: the kernel ABI, the
/// libraries with tai, MLIR and LLVM, and other loaded libraries that use them
/// or define a dialect of the context, such as plugins. Cached objects of
/// another build are not used.
std::string getBuildId(MLIRContext *context);

} // namespace mlir::tai

#endif // TAI_LIB_EXECUTIONENGINE_COMPILE_BUILDID_H
