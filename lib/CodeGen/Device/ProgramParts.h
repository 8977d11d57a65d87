//===- ProgramParts.h - Code put together again -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_DEVICE_PROGRAMPARTS_H
#define TAI_LIB_CODEGEN_DEVICE_PROGRAMPARTS_H

#include "tai/CodeGen/DeviceCompiler.h"
#include "llvm/IR/Module.h"
#include "llvm/Support/Error.h"

namespace mlir::tai {

/// Adds the bitcode of a part to a module, and yields its function there: one
/// that is called and has a name of its own.
llvm::Expected<llvm::Function *> addPart(llvm::Module &module, StringRef bytes,
                                         StringRef name, size_t number);

/// A kernel of each part that waits by itself for what was queued before it.
llvm::Expected<runtime::DeviceImage>
makeOverlapped(DeviceCompiler &compiler, ArrayRef<runtime::ProgramPart> parts);

/// What one step reads may have been written by another: no load goes past the
/// caches of writes.
void forgetInvariance(llvm::Function &function);

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_DEVICE_PROGRAMPARTS_H
