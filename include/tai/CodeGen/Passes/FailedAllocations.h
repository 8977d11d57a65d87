//===- FailedAllocations.h - Failed allocations on a device -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_PASSES_FAILEDALLOCATIONS_H
#define TAI_CODEGEN_PASSES_FAILEDALLOCATIONS_H

#include "llvm/IR/Module.h"

namespace mlir::tai {

/// Exits a thread whose allocation failed, at the allocation or at the first
/// use of the memory; see lib/Conversion/ToNVVM/LocalMemory.cpp.
void exitOnFailedAllocations(llvm::Module &module);

} // namespace mlir::tai

#endif // TAI_CODEGEN_PASSES_FAILEDALLOCATIONS_H
