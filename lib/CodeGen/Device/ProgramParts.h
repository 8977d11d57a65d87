//===- ProgramParts.h - Bodies of kernels in a program ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_DEVICE_PROGRAMPARTS_H
#define TAI_LIB_CODEGEN_DEVICE_PROGRAMPARTS_H

#include "tai/CodeGen/Device/DeviceCompiler.h"
#include "llvm/IR/Module.h"
#include "llvm/Support/Error.h"

namespace mlir::tai {

/// Links the bitcode of a program part into a module, and returns the part's
/// function there, under a unique name.
llvm::Expected<llvm::Function *> addPart(llvm::Module &module, StringRef bytes,
                                         StringRef name, size_t number);

/// Makes, of each part, a kernel that itself waits for earlier kernels in the
/// queue (programmatic dependent launch).
llvm::Expected<runtime::DeviceImage>
makeOverlapped(DeviceCompiler &compiler, ArrayRef<runtime::ProgramPart> parts);

/// Removes invariant-load marks: an earlier step of the program may have
/// written the memory, so loads must not use the read-only cache.
void dropInvariantLoads(llvm::Function &function);

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_DEVICE_PROGRAMPARTS_H
