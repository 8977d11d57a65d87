//===- ExtremeAtomics.h - Atomic minima and maxima --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_PASSES_EXTREMEATOMICS_H
#define TAI_CODEGEN_PASSES_EXTREMEATOMICS_H

namespace llvm {
class Module;
} // namespace llvm

namespace mlir::tai {

/// Guards atomic minima and maxima by a load and a test of whether they would
/// change the element. Most would not. On a CPU without instructions for atomic
/// extremes, they become a loop of exchanges, each of which takes the cache
/// line from the other processors even if it writes the old value.
void testExtremeAtomics(llvm::Module &module);

} // namespace mlir::tai

#endif // TAI_CODEGEN_PASSES_EXTREMEATOMICS_H
