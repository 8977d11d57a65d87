//===- VectorizeAtomics.h - Several atomic additions at once ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_PASSES_VECTORIZEATOMICS_H
#define TAI_CODEGEN_PASSES_VECTORIZEATOMICS_H

namespace llvm {
class Function;
class Pass;
} // namespace llvm

namespace mlir::tai {

/// Combines atomic additions of f32 to neighbouring addresses in global memory,
/// with unused results, into one `red.global.add.v2.f32` or `.v4.f32`. For
/// sm_90 and later, with PTX 8.1; runs after address spaces of the kernel's
/// parameters are inferred.
llvm::Pass *createVectorizeAtomicsPass();

/// Stores the known alignment of the addresses of atomics on the instructions,
/// so that it survives in a copy of the function whose parameters have no
/// alignment attributes.
void noteAtomicAlignment(llvm::Function &function);

} // namespace mlir::tai

#endif // TAI_CODEGEN_PASSES_VECTORIZEATOMICS_H
