//===- TaiInterfaces.td - Interfaces of the tai dialect ----*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAIINTERFACES_TD
#define TAI_DIALECT_TAI_IR_TAIINTERFACES_TD

include "mlir/IR/OpBase.td"

def Tai_SNodeTypeInterface : TypeInterface<"SNodeTypeInterface"> {
  let cppNamespace = "::mlir::tai";
  let description = [{
    One level of a layout tree. A level divides the cells of its parent along
    some axes and holds one or more children in each of its own cells: further
    levels, or the record of places (`!tai.places`) that ends a path.

    A downstream dialect adds a kind of level by implementing this interface on
    a type of its own; the parser of `!tai.root` accepts such a type wherever a
    level may stand. Layout, lowering and runtime use levels through this
    interface only.

    The pool of a level is address space: every cell has an address in it,
    active or not (docs/decisions/0006-sparse-storage.md). The system commits a
    page when it is first written; memory of an inactive cell is zero.

    Cells are numbered row-major, the last axis of `getAxes` fastest, whatever
    their addresses are.
  }];
  let methods = [
    InterfaceMethod<
      "The axes divided by this level, in any order; axis 0 is `i`.",
      "::llvm::ArrayRef<unsigned>", "getAxes">,
    InterfaceMethod<
      "The number of cells along each axis of `getAxes`.",
      "::llvm::ArrayRef<int64_t>", "getShape">,
    InterfaceMethod<
      "The children held in each cell, in storage order.",
      "::llvm::ArrayRef<::mlir::Type>", "getChildren">,
    InterfaceMethod<
      "The keyword that names this kind of level, for messages.",
      "::llvm::StringRef", "getKind">,
    InterfaceMethod<
      "How the activity of cells is recorded. A level of lists has one axis.",
      "::mlir::tai::CellActivity", "getActivity">,

    // Cells and their addresses.
    InterfaceMethod<
      "The number of cells of this level below one parent cell.",
      "int64_t", "getNumCells", (ins), "", [{
        int64_t count = 1;
        for (int64_t extent : $_type.getShape())
          count *= extent;
        return count;
      }]>,
    InterfaceMethod<
      "The size of a cell in bytes.",
      "uint64_t", "getCellSize", (ins "const ::mlir::DataLayout &":$layout), "",
      [{ return ::mlir::tai::computeCellSize($_type.getChildren(), layout); }]>,
    InterfaceMethod<
      "The alignment of a cell of this level, in bytes.",
      "uint64_t", "getCellAlignment",
      (ins "const ::mlir::DataLayout &":$layout), "",
      [{ return ::mlir::tai::computeCellAlignment($_type.getChildren(),
                                                  layout); }]>,
    InterfaceMethod<
      "The strides of cells in bytes along each axis of `getAxes`, multiples "
      "of the alignment.",
      "::llvm::SmallVector<uint64_t>", "getCellStrides",
      (ins "const ::mlir::DataLayout &":$layout), "",
      [{ return ::mlir::tai::computeRowMajorStrides(
             $_type.getShape(), $_type.getCellSize(layout)); }]>,
    InterfaceMethod<
      "The size in bytes of the address space for all cells below one parent "
      "cell.",
      "uint64_t", "getPoolSize", (ins "const ::mlir::DataLayout &":$layout), "",
      [{ return $_type.getNumCells() * $_type.getCellSize(layout); }]>,

    // Activity, in code that is being built.
    InterfaceMethod<
      "Builds the test whether a cell is active, an `i1`.",
      "::mlir::Value", "emitIsActive",
      (ins "::mlir::OpBuilder &":$builder, "::mlir::Location":$loc,
           "const ::mlir::tai::CellRef &":$cell), "",
      [{ return ::mlir::tai::emitIsActive(builder, loc, $_type.getActivity(),
                                          cell); }]>,
    InterfaceMethod<
      "Builds the activation of a cell and its ancestors. Returns an `i1`: "
      "whether it succeeded. Must be thread-safe.",
      "::mlir::Value", "emitActivate",
      (ins "::mlir::OpBuilder &":$builder, "::mlir::Location":$loc,
           "const ::mlir::tai::CellRef &":$cell), "",
      [{ return ::mlir::tai::emitActivate(builder, loc, cell); }]>,
    InterfaceMethod<
      "Builds the deactivation of a cell, which also zeroes it, with all its "
      "descendants.",
      "void", "emitDeactivate",
      (ins "::mlir::OpBuilder &":$builder, "::mlir::Location":$loc,
           "const ::mlir::tai::CellRef &":$cell), "",
      [{ ::mlir::tai::emitDeactivate(builder, loc, cell); }]>,
    InterfaceMethod<
      "Builds the list of active cells: the address of their numbers, of 64 "
      "bits each and ascending, and their count.",
      "::mlir::tai::CellList", "emitActiveCells",
      (ins "::mlir::OpBuilder &":$builder, "::mlir::Location":$loc,
           "::mlir::Value":$tree, "unsigned":$node), "",
      [{ return ::mlir::tai::emitActiveCells(builder, loc, tree, node); }]>,
  ];
  let extraSharedClassDeclaration = [{
    /// True if a cell of this level can be inactive.
    bool isSparse() const {
      return $_type.getActivity() != ::mlir::tai::CellActivity::All;
    }
    /// True if the active cells are the first of each list.
    bool isList() const {
      return $_type.getActivity() == ::mlir::tai::CellActivity::Length;
    }
  }];
}

#endif // TAI_DIALECT_TAI_IR_TAIINTERFACES_TD
