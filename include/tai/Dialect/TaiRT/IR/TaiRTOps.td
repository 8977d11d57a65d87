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
    What lies between the ops of `tai`, which name fields, and the LLVM dialect: the
    address of a tree, and the questions and changes of activity that become
    calls of the runtime. Made by `tai-lower-struct-for`, `tai-lower-layout` and the
    kinds of levels; never written by hand. Memory has addresses here, layouts
    are gone.
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
    Yields the address of the storage of a tree. It is the same throughout a
    launch. Made by `tai-lower-layout`, and taken from the frame of the launch
    by `convert-tai-to-scf`.

    Example:

    ```mlir
    %base = tai_rt.tree_base @scene : !llvm.ptr
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$tree);
  let results = (outs TaiRT_Pointer:$base);
  let assemblyFormat = "$tree attr-dict `:` type($base)";
}

// Cells of a sparse level are numbered row-major, level below level. `node` is
// the number of the level in its tree, those above before those below.

def TaiRT_ActiveCellsOp : TaiRT_Op<"active_cells", [
    AllTypesMatch<["base", "cells"]>]> {
  let summary = "the list of the active cells of a sparse level";
  let description = [{
    Yields the address and the length of an array of 64-bit numbers: those of
    the active cells of sparse level `node` of the tree at `base`, ascending.
    The array stays as it is until the kernel returns. With `reach`, cells are
    left out around which, so many cells far, no adjoint is other than zero; -1
    looks at all cells. Made by `tai-lower-struct-for`.

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
  let summary = "tell whether a loop goes over all active cells";
  let description = [{
    False if `tai_rt.active_cells` of the same level yields another list than that
    of the cells that are active now: the reverse of a loop goes over what the
    loop went over. Made by `tai-lower-layout`.

    ```mlir
    %all = tai_rt.list_is_current %base, 0 : !llvm.ptr
    ```
  }];
  let arguments = (ins TaiRT_Pointer:$base, I32Attr:$node);
  let results = (outs I1:$current);
  let assemblyFormat = "$base `,` $node attr-dict `:` type($base)";
}

def TaiRT_ActivateCellOp : TaiRT_Op<"activate_cell"> {
  let summary = "make a cell and those above it active";
  let description = [{
    Yields false if there is no memory for the cell; the launch has failed then,
    and nothing must be written to the cell. Made by `tai-lower-layout`.

    ```mlir
    %ok = tai_rt.activate_cell %base, 0, %cell : !llvm.ptr
    ```
  }];
  let arguments = (ins TaiRT_Pointer:$base, I32Attr:$node, Index:$cell);
  let results = (outs I1:$done);
  let assemblyFormat = "$base `,` $node `,` $cell attr-dict `:` type($base)";
}

def TaiRT_DeactivateCellOp : TaiRT_Op<"deactivate_cell"> {
  let summary = "make a cell inactive";
  let description = [{
    Also zeroes it, with all that lies below; of a `dynamic` level, the whole
    list. Made by `tai-lower-layout`.

    ```mlir
    tai_rt.deactivate_cell %base, 0, %cell : !llvm.ptr
    ```
  }];
  let arguments = (ins TaiRT_Pointer:$base, I32Attr:$node, Index:$cell);
  let assemblyFormat = "$base `,` $node `,` $cell attr-dict `:` type($base)";
}

def TaiRT_AppendCellOp : TaiRT_Op<"append_cell"> {
  let summary = "lengthen a list by one cell";
  let description = [{
    Yields the position of the new cell in list number `list` of a `dynamic`
    level, or -1 if the list is full; the launch has failed then. Made by
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
