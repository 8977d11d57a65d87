//===- TaiAccessOps.td - Access to fields ------------------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAIACCESSOPS_TD
#define TAI_DIALECT_TAI_IR_TAIACCESSOPS_TD

include "tai/Dialect/Tai/IR/TaiOpBase.td"

/// An access to one element of a field, or to one component of it. Effects
/// are on the field's symbol, so that accesses to distinct fields commute.
class Tai_AccessOp<string mnemonic, list<Trait> traits = []>
    : Tai_Op<mnemonic, !listconcat(traits, [
        DeclareOpInterfaceMethods<SymbolUserOpInterface>,
        DeclareOpInterfaceMethods<MemoryEffectsOpInterface>])>;

def Tai_LoadOp : Tai_AccessOp<"load", [AttrSizedOperandSegments,
    DeclareOpInterfaceMethods<ConditionallySpeculatable>]> {
  let summary = "read one element of a field";
  let description = [{
    Reads the element of `field` at `indices`, one index for each dimension.
    An element below an inactive cell reads as zero and does not activate it.
    With `component`, reads one component of a vector or matrix element: one
    index for each dimension of the element type.

    An index outside the field is an error. Where what the launch is given
    decides, the launch is refused; else it is reported with `bounds=check`,
    replaced with `bounds=clamp`, and without either the behaviour is undefined
    (see `tai-check-bounds`).

    Example:

    ```mlir
    %v = tai.load @v[%i, %j] : vector<2xf32>
    %y = tai.load @v[%i, %j] component [%c1] : f32
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$field, Variadic<Index>:$indices,
                       Variadic<Index>:$components);
  let results = (outs Tai_Value:$value);
  let assemblyFormat = [{
    $field `[` $indices `]` (`component` `[` $components^ `]`)? attr-dict
    `:` type($value)
  }];
  let builders = [OpBuilder<(ins "::mlir::Type":$type,
    "::mlir::FlatSymbolRefAttr":$field, "::mlir::ValueRange":$indices), [{
      build($_builder, $_state, type, field, indices, ::mlir::ValueRange());
    }]>];
}

def Tai_StoreOp : Tai_AccessOp<"store", [AttrSizedOperandSegments]> {
  let summary = "write one element of a field";
  let description = [{
    Writes `value` to the element of `field` at `indices`, or to one component
    of it. Activates the cells on the way. For the index rules see `tai.load`.

    Example:

    ```mlir
    tai.store %v, @v[%i, %j] : vector<2xf32>
    tai.store %y, @v[%i, %j] component [%c1] : f32
    ```
  }];
  let arguments = (ins Tai_Value:$value, FlatSymbolRefAttr:$field,
                       Variadic<Index>:$indices, Variadic<Index>:$components);
  let assemblyFormat = [{
    $value `,` $field `[` $indices `]` (`component` `[` $components^ `]`)?
    attr-dict `:` type($value)
  }];
  let builders = [OpBuilder<(ins "::mlir::Value":$value,
    "::mlir::FlatSymbolRefAttr":$field, "::mlir::ValueRange":$indices), [{
      build($_builder, $_state, value, field, indices, ::mlir::ValueRange());
    }]>];
}

def Tai_AtomicOp : Tai_AccessOp<"atomic", [AttrSizedOperandSegments,
    AllTypesMatch<["value", "old"]>]> {
  let summary = "combine a value into one element of a field";
  let description = [{
    Replaces the element (or component) by its combination with `value`, in
    one indivisible step for each component, and yields what it was before.
    `add`, `sub`, `mul`, `min`, `max` take integers and floats, `and`, `or`,
    `xor` integers.

    `exclusive` says that no other iteration of the enclosing parallel loop
    reaches the element, so that a plain read and write does.

    Example:

    ```mlir
    %old = tai.atomic add %f, @force[%a] : vector<2xf32>
    ```
  }];
  let arguments = (ins Tai_AtomicKindAttr:$kind, Tai_Value:$value,
                       FlatSymbolRefAttr:$field, Variadic<Index>:$indices,
                       Variadic<Index>:$components, UnitAttr:$exclusive);
  let results = (outs Tai_Value:$old);
  let assemblyFormat = [{
    `` $kind $value `,` $field `[` $indices `]`
    (`component` `[` $components^ `]`)? (`exclusive` $exclusive^)?
    attr-dict `:` type($value)
  }];
  let hasVerifier = 1;
  let builders = [OpBuilder<(ins "::mlir::tai::AtomicKind":$kind,
    "::mlir::Value":$value, "::mlir::FlatSymbolRefAttr":$field,
    "::mlir::ValueRange":$indices,
    CArg<"::mlir::ValueRange", "{}">:$components,
    CArg<"bool", "false">:$exclusive)>];
}

//===----------------------------------------------------------------------===//
// Sparse topology
//===----------------------------------------------------------------------===//

/// An op on the cell `level` levels above the place of a field; level 1 is the
/// innermost SNode.
class Tai_TopologyOp<string mnemonic, list<Trait> traits = []>
    : Tai_AccessOp<mnemonic, traits>;

def Tai_ActivateOp : Tai_TopologyOp<"activate"> {
  let summary = "make a cell active";
  let description = [{
    Activates the cell above the element of `field` at `indices`, `level`
    levels up (1 is the innermost), and the cells above it.

    ```mlir
    tai.activate @x[%i] level 1
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$field, Variadic<Index>:$indices,
                       ConfinedAttr<I64Attr, [IntPositive]>:$level);
  let assemblyFormat = "$field `[` $indices `]` `level` $level attr-dict";
}

def Tai_DeactivateOp : Tai_TopologyOp<"deactivate"> {
  let summary = "make a cell inactive";
  let description = [{
    Deactivates the cell; what lies below it reads as zero from then on.

    ```mlir
    tai.deactivate @x[%i] level 1
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$field, Variadic<Index>:$indices,
                       ConfinedAttr<I64Attr, [IntPositive]>:$level);
  let assemblyFormat = "$field `[` $indices `]` `level` $level attr-dict";
}

def Tai_IsActiveOp : Tai_TopologyOp<"is_active"> {
  let summary = "tell whether a cell is active";
  let description = [{
    ```mlir
    %a = tai.is_active @x[%i] level 1
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$field, Variadic<Index>:$indices,
                       ConfinedAttr<I64Attr, [IntPositive]>:$level);
  let results = (outs I1:$active);
  let assemblyFormat = "$field `[` $indices `]` `level` $level attr-dict";
}

def Tai_VisitsAllOp : Tai_Op<"visits_all", [
    DeclareOpInterfaceMethods<SymbolUserOpInterface>]> {
  let summary = "tell whether a loop goes over all active cells";
  let description = [{
    True if a loop over the field visits the cells that are active now. The
    reverse of a loop visits what the loop visited, which may be fewer. Made by
    `tai-scatter-to-gather`.

    ```mlir
    %all = tai.visits_all @x
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$field);
  let results = (outs I1:$all);
  let assemblyFormat = "$field attr-dict";
}

def Tai_AppendOp : Tai_TopologyOp<"append"> {
  let summary = "add a cell to a dynamic list";
  let description = [{
    Appends `value` to the `dynamic` list above `field`; `indices` are those of
    the list, without the appended one. Yields the index of the new cell. A
    full list is an error.

    ```mlir
    %at = tai.append %v, @x[%i] : f32
    ```
  }];
  let arguments = (ins Tai_Value:$value, FlatSymbolRefAttr:$field,
                       Variadic<Index>:$indices);
  let results = (outs Index:$at);
  let assemblyFormat = "$value `,` $field `[` $indices `]` attr-dict `:` type($value)";
}

def Tai_LengthOp : Tai_TopologyOp<"length"> {
  let summary = "the number of cells of a dynamic list";
  let description = [{
    ```mlir
    %n = tai.length @x[%i]
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$field, Variadic<Index>:$indices);
  let results = (outs Index:$count);
  let assemblyFormat = "$field `[` $indices `]` attr-dict";
}

#endif // TAI_DIALECT_TAI_IR_TAIACCESSOPS_TD
