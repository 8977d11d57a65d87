//===- ExpandBfloat.h - Rounding to bf16 by integers ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_PASSES_EXPANDBFLOAT_H
#define TAI_CODEGEN_PASSES_EXPANDBFLOAT_H

namespace llvm {
class Module;
} // namespace llvm

namespace mlir::tai {

/// Rounds f32 to bf16 by integer operations, to the nearest with ties to even,
/// and computes on bf16 in f32. The x86 instructions for this conversion flush
/// denormal inputs and results to zero, whatever the mode of the processor;
/// without these instructions, LLVM calls a function for each number.
void expandBfloat(llvm::Module &module);

} // namespace mlir::tai

#endif // TAI_CODEGEN_PASSES_EXPANDBFLOAT_H
