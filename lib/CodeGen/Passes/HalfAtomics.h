//===- HalfAtomics.h - Atomic operations on 16-bit floats -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_PASSES_HALFATOMICS_H
#define TAI_LIB_CODEGEN_PASSES_HALFATOMICS_H

namespace llvm {
class Module;
} // namespace llvm

namespace mlir::tai {

/// Makes loops of compare-and-exchange of atomic operations on f16 and bf16,
/// which compare the bits that lie in memory. Those that LLVM makes for a CPU
/// hold what they expect there as a float, and a float of 16 bits goes through
/// one of 32: denormals may become zero on the way, and NaNs others, so that
/// the exchange never succeeds.
void expandHalfAtomics(llvm::Module &module);

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_PASSES_HALFATOMICS_H
