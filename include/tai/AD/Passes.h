//===- Passes.h - Differentiation passes ------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_PASSES_H
#define TAI_AD_PASSES_H

#include "mlir/Pass/Pass.h"
#include "tai/Interfaces/Differentiable.h"
#include "tai/Support/SkipOption.h"
#include <memory>

namespace mlir::tai {

#define GEN_PASS_DECL
#define GEN_PASS_REGISTRATION
#include "tai/AD/Passes.h.inc"

} // namespace mlir::tai

#endif // TAI_AD_PASSES_H
