//===- HelpfulPasses.h - Upstream passes in front of ours -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_HELPFULPASSES_H
#define TAI_ANALYSIS_HELPFULPASSES_H

#include "mlir/IR/Diagnostics.h"

namespace mlir::tai {

/// Name of an attribute on a copy of a function that is prepared for
/// differentiation. The attribute holds the symbol of the original function.
constexpr llvm::StringLiteral kPreparedFor = "tai.prepared_for";

/// The name of the pass that turns `op` into ops that have derivatives, or an
/// empty string. A pass that has run on the function around `op` does not
/// count.
StringRef getHelpfulPass(Operation *op);

/// Adds to the diagnostic a note with the name of the pass that turns `op` into
/// ops that have derivatives. False if there is no such pass.
bool attachHelpfulPass(InFlightDiagnostic &diag, Operation *op);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_HELPFULPASSES_H
