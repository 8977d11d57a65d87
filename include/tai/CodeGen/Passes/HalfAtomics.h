//===- HalfAtomics.h - Atomic operations on 16-bit floats -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_PASSES_HALFATOMICS_H
#define TAI_CODEGEN_PASSES_HALFATOMICS_H

namespace llvm {
class Module;
} // namespace llvm

namespace mlir::tai {

/// Expands atomic operations on f16 and bf16 to compare-exchange loops on the
/// bits in memory. LLVM's own expansion for a CPU keeps the expected value as a
/// float, and converts it to f32 and back: denormals may become zero and NaNs
/// may change, so that the exchange never succeeds.
void expandHalfAtomics(llvm::Module &module);

} // namespace mlir::tai

#endif // TAI_CODEGEN_PASSES_HALFATOMICS_H
