//===- TaiAttrs.td - Attributes of the tai dialect ---------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAIATTRS_TD
#define TAI_DIALECT_TAI_IR_TAIATTRS_TD

include "mlir/IR/AttrTypeBase.td"
include "mlir/IR/EnumAttr.td"
include "tai/Dialect/Tai/IR/TaiBase.td"

def Tai_AtomicKind : I32EnumAttr<"AtomicKind", "read-modify-write operation", [
    I32EnumAttrCase<"Add", 0, "add">, I32EnumAttrCase<"Sub", 1, "sub">,
    I32EnumAttrCase<"Mul", 2, "mul">, I32EnumAttrCase<"Min", 3, "min">,
    I32EnumAttrCase<"Max", 4, "max">, I32EnumAttrCase<"And", 5, "and">,
    I32EnumAttrCase<"Or", 6, "or">, I32EnumAttrCase<"Xor", 7, "xor">,
    I32EnumAttrCase<"MinU", 8, "minu">, I32EnumAttrCase<"MaxU", 9, "maxu">]> {
  let cppNamespace = "::mlir::tai";
  let genSpecializedAttr = 0;
}
def Tai_AtomicKindAttr
    : EnumAttr<Tai_Dialect, Tai_AtomicKind, "atomic_kind"> {
  let assemblyFormat = "$value";
}

def Tai_AccumulationStrategy
    : I32EnumAttr<"AccumulationStrategy", "how updates of a loop are done", [
    I32EnumAttrCase<"Register", 0, "register">,
    I32EnumAttrCase<"Private", 1, "private">]> {
  let cppNamespace = "::mlir::tai";
  let genSpecializedAttr = 0;
}
def Tai_AccumulationStrategyAttr
    : EnumAttr<Tai_Dialect, Tai_AccumulationStrategy, "strategy"> {
  let assemblyFormat = "$value";
}

def Tai_FieldUse : I32EnumAttr<"FieldUse", "how a kernel uses a field", [
    I32EnumAttrCase<"Read", 0, "read">, I32EnumAttrCase<"Write", 1, "write">,
    I32EnumAttrCase<"Accumulate", 2, "accumulate">]> {
  let cppNamespace = "::mlir::tai";
  let genSpecializedAttr = 0;
}

/// How a kernel touches one field.
def Tai_AccessAttr : AttrDef<Tai_Dialect, "Access"> {
  let mnemonic = "access";
  let summary = "one access of a kernel to a field";
  let description = [{
    `#tai.access<read @x, affine_map<(d0)[s0] -> (s0 - 1, d0)>>`: `kind` is one
    of `read`, `write`, `accumulate`; `map`, where the indices are affine, maps
    the loop indices of the enclosing loops (dimensions) and the integer
    arguments of the kernel (symbols) to the indices of the field.
  }];
  let parameters = (ins
    EnumParameter<Tai_FieldUse>:$kind,
    "::mlir::FlatSymbolRefAttr":$field,
    OptionalParameter<"::mlir::AffineMapAttr">:$map
  );
  let assemblyFormat = "`<` $kind $field (`,` $map^)? `>`";
}

#endif // TAI_DIALECT_TAI_IR_TAIATTRS_TD
