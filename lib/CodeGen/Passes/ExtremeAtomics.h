//===- ExtremeAtomics.h - Atomic minima and maxima --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_PASSES_EXTREMEATOMICS_H
#define TAI_LIB_CODEGEN_PASSES_EXTREMEATOMICS_H

namespace llvm {
class Module;
} // namespace llvm

namespace mlir::tai {

/// Puts atomic minima and maxima behind a load and a test of whether they
/// change the element. Most do not, and an exchange, which a CPU without an
/// instruction for extremes repeats until it succeeds, takes the line of the
/// cache from the other processors even if it writes the old value.
void testExtremeAtomics(llvm::Module &module);

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_PASSES_EXTREMEATOMICS_H
