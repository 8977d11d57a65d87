//===- TaiAccessOps.td - Access to fields ------------------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAIACCESSOPS_TD
#define TAI_DIALECT_TAI_IR_TAIACCESSOPS_TD

include "tai/Dialect/Tai/IR/TaiOpBase.td"

/// Base class of accesses to one element of a field, or to one component of the
/// element. Memory effects are on the field's symbol, so that accesses to
/// distinct fields commute.
class Tai_AccessOp<string mnemonic, string access, string value = "",
                   list<Trait> traits = []>
    : Tai_Op<mnemonic, !listconcat(traits, [
        DeclareOpInterfaceMethods<SymbolUserOpInterface>,
        DeclareOpInterfaceMethods<MemoryEffectsOpInterface>,
        DeclareOpInterfaceMethods<Tai_FieldAccessOpInterface,
          !if(!empty(value), ["getFieldAccess"],
              ["getFieldAccess", "getAccessedValue"])>])> {
  let extraClassDefinition = [{
    void $cppClass::getEffects(
        ::llvm::SmallVectorImpl<::mlir::MemoryEffects::EffectInstance>
            &effects) {
      ::mlir::tai::addFieldEffects(effects, getFieldAccess(), getFieldAttr());
    }
    ::mlir::tai::FieldAccess $cppClass::getFieldAccess() {
      return ::mlir::tai::FieldAccess::}] # access # [{;
    }
  }] # !if(!empty(value), "", [{
    ::mlir::Value $cppClass::getAccessedValue() { return get}] # value # [{(); }
  }]);
}

let opDocGroup = AccessOpGroup in {

def Tai_LoadOp : Tai_AccessOp<"load", "Read", "Value", [
    AttrSizedOperandSegments,
    DeclareOpInterfaceMethods<ConditionallySpeculatable>]> {
  let summary = "read one element of a field";
  let description = [{
    Reads the element of `field` at `indices`, one index for each dimension.
    An element below an inactive cell reads as zero and does not activate it.
    With `component`, reads one component of a vector or matrix element: one
    index for each dimension of the element type.

    An index outside the field is an error. If it depends on the arguments of
    the launch alone, the launch is refused; otherwise it is reported with
    `bounds=check`, clamped with `bounds=clamp`, and undefined behaviour without
    either (see `tai-check-bounds`).

    1. (load_c1) `field` names a `tai.field`.
    2. (load_c2) There is an index for each dimension of the field.
    3. (load_c3) There is no component, or one index for each dimension of the
       element type.
    4. (load_c4) The value has the type of an element, or of a component.

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

def Tai_StoreOp : Tai_AccessOp<"store", "Write", "Value", [
    AttrSizedOperandSegments]> {
  let summary = "write one element of a field";
  let description = [{
    Writes `value` to the element of `field` at `indices`, or to one component
    of it. Activates the cells on the path to the element. For the index rules
    see `tai.load`.

    1. (store_c1) to (store_c4): those of `tai.load`.

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

def Tai_AtomicOp : Tai_AccessOp<"atomic", "Combine", "Value", [
    AttrSizedOperandSegments, AllTypesMatch<["value", "old"]>]> {
  let summary = "combine a value into one element of a field";
  let description = [{
    Replaces the element (or component) by its combination with `value`,
    atomically for each component, and returns the old value. `add`, `sub`,
    `mul`, `min`, `max` are for integers and floats, `and`, `or`, `xor` for
    integers.

    `exclusive` states that no other iteration of the enclosing parallel loop
    reaches the element, so that a non-atomic update is enough. `reduction` is
    the decision of `tai-relax-atomics` (see `#tai.reduction`); without it the
    update is atomic.

    1. (atomic_c1) to (atomic_c4): those of `tai.load`.
    2. (atomic_c5) `and`, `or`, `xor`, `minu` and `maxu` combine integers; the last two
       take them as unsigned, `min` and `max` as signed.
    3. (atomic_c6) An `exclusive` update has no `reduction`. A reduction with other digits
       than its own, or in fixed point, adds or subtracts floats.

    Example:

    ```mlir
    %old = tai.atomic add %f, @force[%a] : vector<2xf32>
    ```
  }];
  let arguments = (ins Tai_AtomicKindAttr:$kind, Tai_Value:$value,
                       FlatSymbolRefAttr:$field, Variadic<Index>:$indices,
                       Variadic<Index>:$components,
                       OptionalAttr<Tai_ReductionAttr>:$reduction,
                       UnitAttr:$exclusive);
  let results = (outs Tai_Value:$old);
  let assemblyFormat = [{
    `` $kind $value `,` $field `[` $indices `]`
    (`component` `[` $components^ `]`)? (`exclusive` $exclusive^)?
    (`reduction` $reduction^)? attr-dict `:` type($value)
  }];
  let hasVerifier = 1;
  let builders = [OpBuilder<(ins "::mlir::tai::AtomicKind":$kind,
    "::mlir::Value":$value, "::mlir::FlatSymbolRefAttr":$field,
    "::mlir::ValueRange":$indices,
    CArg<"::mlir::ValueRange", "{}">:$components,
    CArg<"bool", "false">:$exclusive)>];
}

} // opDocGroup = AccessOpGroup

//===----------------------------------------------------------------------===//
// Sparse topology
//===----------------------------------------------------------------------===//

/// Base class of ops on the cell that lies `level` levels above the place of a
/// field; level 1 is the innermost SNode.
class Tai_TopologyOp<string mnemonic, string access, string value = "">
    : Tai_AccessOp<mnemonic, access, value>;

let opDocGroup = TopologyOpGroup in {

def Tai_ActivateOp : Tai_TopologyOp<"activate", "WriteCells"> {
  let summary = "activate a cell";
  let description = [{
    Activates the cell above the element of `field` at `indices`, `level` levels
    up (1 is the innermost), and its ancestors.

    ```mlir
    tai.activate @x[%i] level 1
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$field, Variadic<Index>:$indices,
                       ConfinedAttr<I64Attr, [IntPositive]>:$level);
  let assemblyFormat = "$field `[` $indices `]` `level` $level attr-dict";
}

def Tai_DeactivateOp : Tai_TopologyOp<"deactivate", "WriteCells"> {
  let summary = "deactivate a cell";
  let description = [{
    Deactivates the cell with all its descendants; elements below it then read
    as zero.

    ```mlir
    tai.deactivate @x[%i] level 1
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$field, Variadic<Index>:$indices,
                       ConfinedAttr<I64Attr, [IntPositive]>:$level);
  let assemblyFormat = "$field `[` $indices `]` `level` $level attr-dict";
}

def Tai_IsActiveOp : Tai_TopologyOp<"is_active", "ReadCells"> {
  let summary = "test whether a cell is active";
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
  let summary = "test whether a loop visits all active cells";
  let description = [{
    True if a loop over the field visits all currently active cells. The reverse
    of a loop visits the same cells as the loop did, which may be fewer. Created
    by `tai-scatter-to-gather`.

    ```mlir
    %all = tai.visits_all @x
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$field);
  let results = (outs I1:$all);
  let assemblyFormat = "$field attr-dict";
}

def Tai_AppendOp : Tai_TopologyOp<"append", "Append", "Value"> {
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

def Tai_LengthOp : Tai_TopologyOp<"length", "ReadCells"> {
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

} // opDocGroup = TopologyOpGroup

#endif // TAI_DIALECT_TAI_IR_TAIACCESSOPS_TD
