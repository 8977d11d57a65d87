//===- FormerCheckOps.td - Former names of checks ----------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
// Ops that the check dialect adds to the `tai` dialect. The parsers of these
// ops make the present ops; ops from the generic form, bytecode or C++ are
// replaced by canonicalisation, or by `upgradeFormerChecks`.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_CHECK_IR_FORMERCHECKOPS_TD
#define TAI_DIALECT_CHECK_IR_FORMERCHECKOPS_TD

include "tai/Dialect/Check/IR/CheckOpBase.td"
include "tai/Dialect/Tai/IR/TaiBase.td"

def FormerCheckGradientOp : Check_GradientBase<Tai_Dialect, "check_gradient"> {
  let summary = "a former name of `tai_check.gradient`";
  let hasCustomAssemblyFormat = 1;
  let hasCanonicalizeMethod = 1;
}

def FormerCheckCloseOp : Check_CloseBase<Tai_Dialect, "check_close"> {
  let summary = "a former name of `tai_check.close`";
  let hasCustomAssemblyFormat = 1;
  let hasCanonicalizeMethod = 1;
}

#endif // TAI_DIALECT_CHECK_IR_FORMERCHECKOPS_TD
