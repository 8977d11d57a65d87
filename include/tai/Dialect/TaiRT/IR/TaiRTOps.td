//===- TaiRTOps.td - The level below: addresses and cells --*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAIRT_IR_TAIRTOPS_TD
#define TAI_DIALECT_TAIRT_IR_TAIRTOPS_TD

include "mlir/IR/BuiltinAttributes.td"
include "mlir/IR/CommonAttrConstraints.td"
include "mlir/IR/CommonTypeConstraints.td"
include "mlir/IR/OpBase.td"
include "mlir/IR/SymbolInterfaces.td"
include "mlir/Interfaces/SideEffectInterfaces.td"

def TaiRT_Dialect : Dialect {
  let name = "tai_rt";
  let cppNamespace = "::mlir::tai";
  let summary = "addresses of trees, and cells of sparse levels";
  let description = [{
    A level between `tai`, whose ops name fields, and the LLVM dialect:
    addresses of trees, and queries and changes of activity that become calls of
    the runtime. Memory has addresses, and layouts have been lowered. Created by
    `tai-lower-struct-for`, `tai-lower-layout` and the implementations of
    levels; not meant to be written by hand.
  }];
  let dependentDialects = ["::mlir::LLVM::LLVMDialect"];
}

class TaiRT_Op<string mnemonic, list<Trait> traits = []>
    : Op<TaiRT_Dialect, mnemonic, traits>;

def TaiRT_Pointer
    : Type<CPred<"::llvm::isa<::mlir::LLVM::LLVMPointerType>($_self)">,
           "LLVM pointer">;

def TaiRT_TreeBaseOp : TaiRT_Op<"tree_base", [
    Pure, DeclareOpInterfaceMethods<SymbolUserOpInterface>]> {
  let summary = "the address of a tree";
  let description = [{
    Returns the address of the storage of a tree. It is constant during a
    launch. Created by `tai-lower-layout`, and lowered by `convert-tai-to-scf`
    to a load from the frame of the launch.

    Example:

    ```mlir
    %base = tai_rt.tree_base @scene : !llvm.ptr
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$tree);
  let results = (outs TaiRT_Pointer:$base);
  let assemblyFormat = "$tree attr-dict `:` type($base)";
}

def TaiRT_StartsAtZeroOp : TaiRT_Op<"starts_at_zero", [Pure]> {
  let summary = "test whether an adjoint counts as zero";
  let description = [{
    True if the launch may take all elements of an adjoint field for zero, and
    has to store them: their memory holds old numbers. `number` is the position
    of the field in the attribute `tai.stores_first` of the kernel. The result
    is the same during a launch, and false unless a tape knows better. Created
    by `tai-store-first`, and lowered by `convert-tai-to-scf` to a load from the
    frame of the launch.

    Example:

    ```mlir
    %zero = tai_rt.starts_at_zero 0
    ```
  }];
  let arguments = (ins ConfinedAttr<I32Attr, [IntNonNegative,
                                              IntMaxValue<63>]>:$number);
  let results = (outs I1:$zero);
  let assemblyFormat = "$number attr-dict";
}

// The class of ops on cells of a sparse level. Cells are numbered row-major,
// level by level. `node` is the number of the level in its tree, parents before
// children.

def TaiRT_ActiveCellsOp : TaiRT_Op<"active_cells", [
    AllTypesMatch<["base", "cells"]>]> {
  let summary = "the list of active cells of a sparse level";
  let description = [{
    Returns the address and the length of an array of 64-bit numbers: those of
    the active cells of sparse level `node` of the tree at `base`, ascending.
    The array does not change until the kernel returns. With `reach`, cells are
    omitted if all adjoints within this distance, in cells, are zero; -1 means
    any distance. Created by `tai-lower-struct-for`.

    ```mlir
    %cells, %count = tai_rt.active_cells %base, 0 : !llvm.ptr
    ```
  }];
  let arguments = (ins TaiRT_Pointer:$base, I32Attr:$node,
                       OptionalAttr<I64Attr>:$reach);
  let results = (outs TaiRT_Pointer:$cells, Index:$count);
  let assemblyFormat = [{
    $base `,` $node (`reach` $reach^)? attr-dict `:` type($base)
  }];
  let builders = [OpBuilder<(ins "::mlir::Value":$base, "uint32_t":$node), [{
    build($_builder, $_state, base.getType(), $_builder.getIndexType(), base,
          node, ::mlir::IntegerAttr());
  }]>];
}

def TaiRT_ListIsCurrentOp : TaiRT_Op<"list_is_current"> {
  let summary = "test whether a loop visits all active cells";
  let description = [{
    False if `tai_rt.active_cells` of the same level returns another list than
    that of the currently active cells: the reverse of a loop visits the same
    cells as the loop did. Created by `tai-lower-layout`.

    ```mlir
    %all = tai_rt.list_is_current %base, 0 : !llvm.ptr
    ```
  }];
  let arguments = (ins TaiRT_Pointer:$base, I32Attr:$node);
  let results = (outs I1:$current);
  let assemblyFormat = "$base `,` $node attr-dict `:` type($base)";
}

def TaiRT_ActivateCellOp : TaiRT_Op<"activate_cell"> {
  let summary = "activate a cell and its ancestors";
  let description = [{
    Returns false if there is no memory for the cell; the launch has then
    failed, and the cell must not be written. Created by `tai-lower-layout`.

    ```mlir
    %ok = tai_rt.activate_cell %base, 0, %cell : !llvm.ptr
    ```
  }];
  let arguments = (ins TaiRT_Pointer:$base, I32Attr:$node, Index:$cell);
  let results = (outs I1:$done);
  let assemblyFormat = "$base `,` $node `,` $cell attr-dict `:` type($base)";
}

def TaiRT_DeactivateCellOp : TaiRT_Op<"deactivate_cell"> {
  let summary = "deactivate a cell";
  let description = [{
    Also zeroes it, with all its descendants; of a `dynamic` level, the whole
    list. Created by `tai-lower-layout`.

    ```mlir
    tai_rt.deactivate_cell %base, 0, %cell : !llvm.ptr
    ```
  }];
  let arguments = (ins TaiRT_Pointer:$base, I32Attr:$node, Index:$cell);
  let assemblyFormat = "$base `,` $node `,` $cell attr-dict `:` type($base)";
}

def TaiRT_AppendCellOp : TaiRT_Op<"append_cell"> {
  let summary = "append a cell to a list";
  let description = [{
    Returns the position of the new cell in list number `list` of a `dynamic`
    level, or -1 if the list is full; the launch has then failed. Created by
    `tai-lower-layout`.

    ```mlir
    %at = tai_rt.append_cell %base, 0, %list : !llvm.ptr
    ```
  }];
  let arguments = (ins TaiRT_Pointer:$base, I32Attr:$node, Index:$list);
  let results = (outs Index:$at);
  let assemblyFormat = "$base `,` $node `,` $list attr-dict `:` type($base)";
}

#endif // TAI_DIALECT_TAIRT_IR_TAIRTOPS_TD
