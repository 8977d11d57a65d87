//===- TaiLayoutOps.td - Trees and fields ------------------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAILAYOUTOPS_TD
#define TAI_DIALECT_TAI_IR_TAILAYOUTOPS_TD

include "tai/Dialect/Tai/IR/TaiOpBase.td"

let opDocGroup = LayoutOpGroup in {

def Tai_TreeOp : Tai_Op<"tree", [Symbol]> {
  let summary = "declare a tree of storage";
  let description = [{
    Declares the storage whose layout is the given `!tai.root` type. Storage
    starts as zero. The names of all places in one tree are distinct.

    Example:

    ```mlir
    tai.tree @scene : !tai.root<dense<[i: 256], {x: vector<2xf32>, m: f32}>>
    ```
  }];
  let arguments = (ins SymbolNameAttr:$sym_name, TypeAttrOf<Tai_RootType>:$layout,
                       OptionalAttr<StrAttr>:$sym_visibility);
  let assemblyFormat = "$sym_name `:` $layout attr-dict";
  let hasVerifier = 1;
}

def Tai_FieldOp : Tai_Op<"field", [Symbol,
    DeclareOpInterfaceMethods<SymbolUserOpInterface>]> {
  let summary = "name a place of a tree as a field";
  let description = [{
    A field is what kernels read and write. It has the element type of its
    place, and one index for each axis divided on the path to the place; the
    indices are in the order of the axes `i`, `j`, `k`, … unless `order` lists
    the axes otherwise. `offset` is the index of the first element along each
    dimension, zero where absent.

    `adjoint` names the field, of the same element type and rank, that
    accumulates the derivative of the loss with respect to this one. `dual`
    names the field that holds its tangent in forward mode.

    `initial` has the contents of all elements, row-major, with which a program
    is loaded (by `tai-run` and the C API); zero where absent. Code compiled
    ahead of time has no storage of its own, and leaves it to the host.

    1. (field_c1) No other field has the same place.
    2. (field_c2) The adjoint and the dual are fields of their own: each belongs
       to one field, in one role, and no field is its own adjoint, directly or
       through other adjoints.
    3. (field_c3) `initial` has the shape of the field, followed by that of its
       elements, and their scalar type.

    Example:

    ```mlir
    tai.tree @scene : !tai.root<dense<[i: 256], {x: f32, x_grad: f32}>>
    tai.field @x_grad = @scene["x_grad"] : f32, rank 1
    tai.field @x = @scene["x"] : f32, rank 1, adjoint @x_grad
    ```
  }];
  let arguments = (ins
    SymbolNameAttr:$sym_name,
    FlatSymbolRefAttr:$tree,
    StrAttr:$place,
    TypeAttr:$type,
    I64Attr:$rank,
    OptionalAttr<FlatSymbolRefAttr>:$adjoint,
    OptionalAttr<FlatSymbolRefAttr>:$dual,
    OptionalAttr<DenseI64ArrayAttr>:$offset,
    OptionalAttr<DenseI64ArrayAttr>:$order,
    OptionalAttr<ElementsAttr>:$initial,
    OptionalAttr<StrAttr>:$sym_visibility
  );
  let assemblyFormat = [{
    $sym_name `=` $tree `[` $place `]` `:` $type `,` `rank` $rank
    `` custom<FieldClauses>($adjoint, $dual, $offset, $order, $initial)
    attr-dict
  }];
  let hasVerifier = 1;
}

} // opDocGroup = LayoutOpGroup

#endif // TAI_DIALECT_TAI_IR_TAILAYOUTOPS_TD
