//===- ExplainPasses.h - Reports what passes did to kernels -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TOOLS_TAI_OPT_EXPLAINPASSES_H
#define TAI_TOOLS_TAI_OPT_EXPLAINPASSES_H

namespace mlir {
class PassManager;
} // namespace mlir

namespace mlir::tai {

/// Has `manager` report on standard error, for each kernel and function, which
/// passes changed it and how, and their remarks. Passes run on one thread.
void explainPasses(PassManager &manager);

} // namespace mlir::tai

#endif // TAI_TOOLS_TAI_OPT_EXPLAINPASSES_H
