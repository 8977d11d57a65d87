//===- TaiLoweringOps.td - What stands between kernels and LLVM ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAILOWERINGOPS_TD
#define TAI_DIALECT_TAI_IR_TAILOWERINGOPS_TD

include "tai/Dialect/Tai/IR/TaiOpBase.td"

def Tai_LLVMPointer
    : Type<CPred<"::llvm::isa<::mlir::LLVM::LLVMPointerType>($_self)">,
           "LLVM pointer">;

def Tai_TreeBaseOp : Tai_Op<"tree_base", [
    Pure, DeclareOpInterfaceMethods<SymbolUserOpInterface>]> {
  let summary = "the address of a tree";
  let description = [{
    Yields the address of the storage of a tree. It is the same throughout a
    launch. Made by `tai-lower-layout`, and taken from the frame of the launch
    by `convert-tai-to-scf`.

    Example:

    ```mlir
    %base = tai.tree_base @scene : !llvm.ptr
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$tree);
  let results = (outs Tai_LLVMPointer:$base);
  let assemblyFormat = "$tree attr-dict `:` type($base)";
}

#endif // TAI_DIALECT_TAI_IR_TAILOWERINGOPS_TD
