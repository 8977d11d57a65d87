//===- BuildId.h - Which build of the compiler this is ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_EXECUTIONENGINE_BUILDID_H
#define TAI_LIB_EXECUTIONENGINE_BUILDID_H

#include "mlir/IR/MLIRContext.h"
#include <string>

namespace mlir::tai {

/// Names all code that can take part in a compilation: the kernel ABI, the
/// libraries that hold tai, MLIR and LLVM, and what is loaded besides them and
/// uses them or holds a dialect of the context, such as plugins. Object code
/// made by other code is not used.
std::string getBuildId(MLIRContext *context);

} // namespace mlir::tai

#endif // TAI_LIB_EXECUTIONENGINE_BUILDID_H
