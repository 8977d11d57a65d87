//===- Passes.h - Passes on kernels -----------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_PASSES_H
#define TAI_TRANSFORMS_PASSES_H

#include "mlir/Pass/Pass.h"
#include "tai/Support/BoundsMode.h"
#include "tai/Support/SkipOption.h"
#include "tai/Transforms/UsedDialects.h"
#include <memory>

namespace mlir::tai {

/// The attribute of a kernel that checks, while it runs, its updates of
/// elements that several iterations may share.
constexpr llvm::StringLiteral kCheckUpdatesAttrName = "tai.check_updates";

#define GEN_PASS_DECL
#define GEN_PASS_REGISTRATION
#include "tai/Transforms/Passes.h.inc"

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_PASSES_H
