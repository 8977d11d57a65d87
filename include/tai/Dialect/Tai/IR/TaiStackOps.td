//===- TaiStackOps.td - Stacks of values -------------------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAISTACKOPS_TD
#define TAI_DIALECT_TAI_IR_TAISTACKOPS_TD

include "tai/Dialect/Tai/IR/TaiOpBase.td"

def Tai_AnyStack : Type<CPred<"::llvm::isa<::mlir::tai::StackType>($_self)">,
                        "stack", "::mlir::tai::StackType">;
def Tai_Scalar : AnyTypeOf<[AnySignlessInteger, AnyFloat, Index]>;

let opDocGroup = LocalOpGroup in {

def Tai_StackCreateOp : Tai_Op<"stack_create"> {
  let summary = "create an empty stack";
  let description = [{
    Creates a stack of scalars that grows as needed, and is freed by
    `tai.stack_destroy`. Adjoints that re-execute a kernel record each value
    that its reverse needs on a stack: each execution of a block pushes once,
    and each reversed execution pops once, so that the orders agree however
    loops are nested.

    A stack belongs to one iteration of the parallel loop around it. The first
    few values are stored inline, without an allocation.

    Example:

    ```mlir
    %s = tai.stack_create : !tai.stack<f32>
    tai.stack_push %x, %s : f32
    %y = tai.stack_pop %s : f32
    tai.stack_destroy %s : !tai.stack<f32>
    ```
  }];
  let results = (outs Res<Tai_AnyStack, "", [MemAlloc]>:$stack);
  let assemblyFormat = "attr-dict `:` qualified(type($stack))";
  let hasVerifier = 1;
  let hasCanonicalizeMethod = 1;
}

def Tai_StackPushOp : Tai_Op<"stack_push", [
    TypesMatchWith<"the stack holds the type of the value", "value", "stack",
                   "::mlir::tai::StackType::get($_self)">]> {
  let summary = "push a value on a stack";
  let description = [{
    See `tai.stack_create`.
  }];
  let arguments = (ins Tai_Scalar:$value,
                       Arg<Tai_AnyStack, "", [MemRead, MemWrite]>:$stack);
  let assemblyFormat = "$value `,` $stack attr-dict `:` type($value)";
}

def Tai_StackPopOp : Tai_Op<"stack_pop", [
    TypesMatchWith<"the stack holds the type of the value", "value", "stack",
                   "::mlir::tai::StackType::get($_self)">,
    TypesMatchWith<"the value is what the stack holds", "stack", "value",
                   "::llvm::cast<::mlir::tai::StackType>($_self)"
                   ".getElementType()">]> {
  let summary = "pop the last value from a stack";
  let description = [{
    The stack must not be empty. See `tai.stack_create`.
  }];
  let arguments = (ins Arg<Tai_AnyStack, "", [MemRead, MemWrite]>:$stack);
  let results = (outs Tai_Scalar:$value);
  let assemblyFormat = "$stack attr-dict `:` type($value)";
}

def Tai_StackDestroyOp : Tai_Op<"stack_destroy"> {
  let summary = "free the memory of a stack";
  let description = [{
    See `tai.stack_create`.
  }];
  let arguments = (ins Arg<Tai_AnyStack, "", [MemFree]>:$stack);
  let assemblyFormat = "$stack attr-dict `:` qualified(type($stack))";
}

} // opDocGroup = LocalOpGroup

#endif // TAI_DIALECT_TAI_IR_TAISTACKOPS_TD
