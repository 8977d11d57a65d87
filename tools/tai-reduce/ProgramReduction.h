//===- ProgramReduction.h - Smaller programs that still fail ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TOOLS_TAI_REDUCE_PROGRAMREDUCTION_H
#define TAI_TOOLS_TAI_REDUCE_PROGRAMREDUCTION_H

namespace mlir::tai {

/// Registers the pass `tai-reduction`.
void registerProgramReduction();

} // namespace mlir::tai

#endif // TAI_TOOLS_TAI_REDUCE_PROGRAMREDUCTION_H
