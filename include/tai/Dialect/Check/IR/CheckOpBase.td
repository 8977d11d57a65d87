//===- CheckOpBase.td - Base classes of checks -------------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_CHECK_IR_CHECKOPBASE_TD
#define TAI_DIALECT_CHECK_IR_CHECKOPBASE_TD

include "mlir/IR/CommonAttrConstraints.td"
include "mlir/IR/CommonTypeConstraints.td"
include "mlir/IR/OpBase.td"
include "mlir/IR/SymbolInterfaces.td"
include "mlir/Interfaces/SideEffectInterfaces.td"
include "tai/Dialect/Tai/IR/TaiTraits.td"

class Check_CloseBase<Dialect dialect, string mnemonic>
    : Op<dialect, mnemonic, [
        AllTypesMatch<["actual", "expected"]>, MemoryEffects<[MemWrite]>,
        Tai_OnlyReports]> {
  let arguments = (ins AnyFloat:$actual, AnyFloat:$expected,
                       F64Attr:$tolerance);
}

class Check_GradientBase<Dialect dialect, string mnemonic>
    : Op<dialect, mnemonic, [
        SingleBlockImplicitTerminator<"::mlir::tai::YieldOp">,
        RecursiveMemoryEffects, Tai_RecordsLaunches,
        DeclareOpInterfaceMethods<SymbolUserOpInterface>]> {
  let arguments = (ins FlatSymbolRefAttr:$loss,
                       TypedArrayAttrBase<FlatSymbolRefAttr, "fields">:$wrt,
                       F64Attr:$tolerance);
  let regions = (region SizedRegion<1>:$body);
}

#endif // TAI_DIALECT_CHECK_IR_CHECKOPBASE_TD
