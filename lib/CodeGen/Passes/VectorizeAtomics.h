//===- VectorizeAtomics.h - Several atomic additions at once ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_PASSES_VECTORIZEATOMICS_H
#define TAI_LIB_CODEGEN_PASSES_VECTORIZEATOMICS_H

namespace llvm {
class Function;
class Pass;
} // namespace llvm

namespace mlir::tai {

/// Makes atomic additions of f32 to neighbours in global memory, whose results
/// nobody uses, one `red.global.add.v2.f32` or `.v4.f32`. For sm_90 and later,
/// with PTX 8.1; after addresses of the kernel's parameters are known to be
/// global.
llvm::Pass *createVectorizeAtomicsPass();

/// Writes what is known of the addresses of atomics down where they stand, so
/// that it is still known in a copy whose parameters come from elsewhere.
void noteAtomicAlignment(llvm::Function &function);

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_PASSES_VECTORIZEATOMICS_H
