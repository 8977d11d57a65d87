//===- Passes.h - Lowering passes -------------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CONVERSION_PASSES_H
#define TAI_CONVERSION_PASSES_H

#include "mlir/Pass/Pass.h"
#include "tai/Support/SkipOption.h"
#include "tai/Transforms/UsedDialects.h"

namespace mlir::tai {
#define GEN_PASS_DECL
#include "tai/Conversion/Passes.h.inc"

#define GEN_PASS_REGISTRATION
#include "tai/Conversion/Passes.h.inc"
/// The symbol of the compiled function of a kernel or host function: `name`, or
/// `name.entry` where a library function that compiled code may call has this
/// name (`math.tan` in a kernel `@tan` must not call the kernel).
std::string getEntryPointName(StringRef name);

} // namespace mlir::tai

#endif // TAI_CONVERSION_PASSES_H
