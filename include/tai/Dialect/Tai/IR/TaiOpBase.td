//===- TaiOpBase.td - Base classes and groups of ops -------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAIOPBASE_TD
#define TAI_DIALECT_TAI_IR_TAIOPBASE_TD

include "mlir/IR/BuiltinAttributes.td"
include "mlir/IR/CommonAttrConstraints.td"
include "mlir/IR/CommonTypeConstraints.td"
include "mlir/IR/OpAsmInterface.td"
include "mlir/IR/OpBase.td"
include "mlir/IR/SymbolInterfaces.td"
include "mlir/Interfaces/CallInterfaces.td"
include "mlir/Interfaces/ControlFlowInterfaces.td"
include "mlir/Interfaces/FunctionInterfaces.td"
include "mlir/Interfaces/InferTypeOpInterface.td"
include "mlir/Interfaces/LoopLikeInterface.td"
include "mlir/Interfaces/SideEffectInterfaces.td"
include "tai/Dialect/Tai/IR/TaiAttrs.td"
include "tai/Dialect/Tai/IR/TaiTraits.td"
include "tai/Dialect/Tai/IR/TaiTypes.td"
include "tai/Interfaces/FieldAccessInterface.td"

// The chapters of the generated op reference.
def LayoutOpGroup : OpDocGroup {
  let summary = "Trees and fields";
  let description = "Storage: its layout, and the names that kernels use.";
}
def KernelOpGroup : OpDocGroup {
  let summary = "Kernels and loops";
  let description = "Programs over fields, their parallel loops, their terminators.";
}
def LocalOpGroup : OpDocGroup {
  let summary = "Local variables and stacks";
  let description = "Private state of one iteration of a parallel loop.";
}
def MessageOpGroup : OpDocGroup {
  let summary = "Random numbers, checks, output";
  let description = "Random draws, checks and output of an iteration.";
}
def AccessOpGroup : OpDocGroup {
  let summary = "Accesses to elements of fields";
  let description = [{
    Ops that implement `FieldAccessOpInterface`: they have a field and indices.
    Their effects are on the symbol of the field.
  }];
}
def TopologyOpGroup : OpDocGroup {
  let summary = "Cells of sparse levels";
  let description = "Queries and changes of activity.";
}
def MatrixOpGroup : OpDocGroup {
  let summary = "Small vectors and matrices";
  let description = "Algebra with analytic derivatives.";
}
def HostOpGroup : OpDocGroup {
  let summary = "Host programs";
  let description = "Launches and tapes. Checks of results are in `tai_check`.";
}

class Tai_Op<string mnemonic, list<Trait> traits = []>
    : Op<Tai_Dialect, mnemonic, traits>;

/// A type whose values a field or a local variable can hold.
def Tai_Value : AnyTypeOf<[AnySignlessInteger, AnyFloat,
    VectorOfAnyRankOf<[AnySignlessInteger, AnyFloat]>]>;
def Tai_FloatOrVector : AnyTypeOf<[AnyFloat, VectorOfAnyRankOf<[AnyFloat]>]>;
def Tai_NumberVector : VectorOfRankAndType<[1], [AnySignlessInteger, AnyFloat]>;
def Tai_FloatVector : VectorOfRankAndType<[1], [AnyFloat]>;
def Tai_FloatMatrix : VectorOfRankAndType<[2], [AnyFloat]>;
def Tai_NumberMatrix : VectorOfRankAndType<[2], [AnySignlessInteger, AnyFloat]>;
def Tai_AnyLocal : Type<CPred<"::llvm::isa<::mlir::tai::LocalType>($_self)">,
                        "local variable", "::mlir::tai::LocalType">;

#endif // TAI_DIALECT_TAI_IR_TAIOPBASE_TD
