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

    A downstream dialect adds a kind of level by implementing this interface
    on a type of its own; the parser of `!tai.root` accepts such a type
    wherever a level may stand.
  }];
  let methods = [
    InterfaceMethod<
      "The axes divided by this level, ascending in no particular order; axis "
      "0 is `i`.",
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
      "True if a cell of this level can be inactive.",
      "bool", "isSparse">,
    InterfaceMethod<
      "The number of cells of this level below one parent cell.",
      "int64_t", "getNumCells", (ins), "", [{
        int64_t count = 1;
        for (int64_t extent : $_type.getShape())
          count *= extent;
        return count;
      }]>,
    InterfaceMethod<
      "The distance in bytes from one cell of this level to the next.",
      "uint64_t", "getCellSize", (ins "const ::mlir::DataLayout &":$layout), "",
      [{ return ::mlir::tai::computeCellSize($_type.getChildren(), layout); }]>,
    InterfaceMethod<
      "The alignment of a cell of this level, in bytes.",
      "uint64_t", "getCellAlignment",
      (ins "const ::mlir::DataLayout &":$layout), "",
      [{ return ::mlir::tai::computeCellAlignment($_type.getChildren(),
                                                  layout); }]>,
  ];
}

#endif // TAI_DIALECT_TAI_IR_TAIINTERFACES_TD
