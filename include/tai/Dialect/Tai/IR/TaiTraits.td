//===- TaiTraits.td - Traits for ops of other dialects -----*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
// See Traits.h.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAITRAITS_TD
#define TAI_DIALECT_TAI_IR_TAITRAITS_TD

include "mlir/IR/OpBase.td"

def Tai_RecordsLaunches : NativeOpTrait<"RecordsLaunches"> {
  let cppNamespace = "::mlir::tai";
}

def Tai_OnlyReports : NativeOpTrait<"OnlyReports"> {
  let cppNamespace = "::mlir::tai";
}

#endif // TAI_DIALECT_TAI_IR_TAITRAITS_TD
