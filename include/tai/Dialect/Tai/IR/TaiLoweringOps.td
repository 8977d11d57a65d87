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

// Cells of a sparse level are numbered row-major, level below level. `node` is
// the number of the level in its tree, those above before those below.

def Tai_ActiveCellsOp : Tai_Op<"active_cells", [
    AllTypesMatch<["base", "cells"]>]> {
  let summary = "the list of the active cells of a sparse level";
  let description = [{
    Yields the address and the length of an array of 64-bit numbers: those of
    the active cells of sparse level `node` of the tree at `base`, ascending.
    The array stays as it is until the kernel returns. Made by
    `tai-lower-struct-for`.

    ```mlir
    %cells, %count = tai.active_cells %base, 0 : !llvm.ptr
    ```
  }];
  let arguments = (ins Tai_LLVMPointer:$base, I32Attr:$node);
  let results = (outs Tai_LLVMPointer:$cells, Index:$count);
  let assemblyFormat = "$base `,` $node attr-dict `:` type($base)";
}

def Tai_ListIsCurrentOp : Tai_Op<"list_is_current"> {
  let summary = "tell whether a loop goes over all active cells";
  let description = [{
    False if `tai.active_cells` of the same level yields another list than that
    of the cells that are active now: the reverse of a loop goes over what the
    loop went over. Made by `tai-lower-layout`.

    ```mlir
    %all = tai.list_is_current %base, 0 : !llvm.ptr
    ```
  }];
  let arguments = (ins Tai_LLVMPointer:$base, I32Attr:$node);
  let results = (outs I1:$current);
  let assemblyFormat = "$base `,` $node attr-dict `:` type($base)";
}

def Tai_ActivateCellOp : Tai_Op<"activate_cell"> {
  let summary = "make a cell and those above it active";
  let description = [{
    Yields false if there is no memory for the cell; the launch has failed then,
    and nothing must be written to the cell. Made by `tai-lower-layout`.

    ```mlir
    %ok = tai.activate_cell %base, 0, %cell : !llvm.ptr
    ```
  }];
  let arguments = (ins Tai_LLVMPointer:$base, I32Attr:$node, Index:$cell);
  let results = (outs I1:$done);
  let assemblyFormat = "$base `,` $node `,` $cell attr-dict `:` type($base)";
}

def Tai_DeactivateCellOp : Tai_Op<"deactivate_cell"> {
  let summary = "make a cell inactive";
  let description = [{
    Also zeroes it, with all that lies below; of a `dynamic` level, the whole
    list. Made by `tai-lower-layout`.

    ```mlir
    tai.deactivate_cell %base, 0, %cell : !llvm.ptr
    ```
  }];
  let arguments = (ins Tai_LLVMPointer:$base, I32Attr:$node, Index:$cell);
  let assemblyFormat = "$base `,` $node `,` $cell attr-dict `:` type($base)";
}

def Tai_AppendCellOp : Tai_Op<"append_cell"> {
  let summary = "lengthen a list by one cell";
  let description = [{
    Yields the position of the new cell in list number `list` of a `dynamic`
    level, or -1 if the list is full; the launch has failed then. Made by
    `tai-lower-layout`.

    ```mlir
    %at = tai.append_cell %base, 0, %list : !llvm.ptr
    ```
  }];
  let arguments = (ins Tai_LLVMPointer:$base, I32Attr:$node, Index:$list);
  let results = (outs Index:$at);
  let assemblyFormat = "$base `,` $node `,` $list attr-dict `:` type($base)";
}

#endif // TAI_DIALECT_TAI_IR_TAILOWERINGOPS_TD
