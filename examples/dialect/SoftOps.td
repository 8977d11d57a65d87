//===- SoftOps.td - Smooth versions of kinked functions ----*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef SOFT_OPS_TD
#define SOFT_OPS_TD

include "mlir/IR/OpBase.td"
include "mlir/Interfaces/SideEffectInterfaces.td"
include "tai/Interfaces/DifferentiableInterfaces.td"
include "tai/Interfaces/FieldAccessInterface.td"

def Soft_Dialect : Dialect {
  let name = "soft";
  let cppNamespace = "::soft";
}

// An op that says itself how it is differentiated.
def Soft_PlusOp : Op<Soft_Dialect, "plus", [
    Pure, AllTypesMatch<["value", "result"]>,
    DeclareOpInterfaceMethods<Tai_DifferentiableOpInterface>]> {
  let summary = "log(1 + exp(x)), a ramp without a kink";
  let arguments = (ins AnyFloat:$value);
  let results = (outs AnyFloat:$result);
  let assemblyFormat = "$value attr-dict `:` type($value)";
}

// An op that accesses a field. Passes that list the accesses of a kernel, such
// as tai-summarize-kernels and tai-check-bounds, count it among the reads.
def Soft_ReadOp : Op<Soft_Dialect, "read", [
    DeclareOpInterfaceMethods<MemoryEffectsOpInterface>,
    DeclareOpInterfaceMethods<Tai_FieldAccessOpInterface,
                              ["getFieldAccess", "getAccessedValue"]>]> {
  let summary = "log(1 + exp(x)) of an element of a field";
  let arguments = (ins FlatSymbolRefAttr:$field, Variadic<Index>:$indices);
  let results = (outs AnyFloat:$value);
  let assemblyFormat = "$field `[` $indices `]` attr-dict `:` type($value)";
}

#endif // SOFT_OPS_TD
