//===- TaiTypes.td - Types of the tai dialect --------------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAITYPES_TD
#define TAI_DIALECT_TAI_IR_TAITYPES_TD

include "mlir/IR/AttrTypeBase.td"
include "tai/Dialect/Tai/IR/TaiBase.td"
include "tai/Dialect/Tai/IR/TaiInterfaces.td"

class Tai_Type<string typeName, string mnemonic_, list<Trait> traits = []>
    : TypeDef<Tai_Dialect, typeName, traits> {
  let mnemonic = mnemonic_;
}

//===----------------------------------------------------------------------===//
// Layout types
//===----------------------------------------------------------------------===//

/// Base class of the types of layout levels that have axes, one extent per
/// axis, and children.
class Tai_LevelType<string typeName, string mnemonic_>
    : Tai_Type<typeName, mnemonic_, [
        DeclareTypeInterfaceMethods<Tai_SNodeTypeInterface, []>]> {
  let parameters = (ins
    ArrayRefParameter<"unsigned", "axes divided">:$axes,
    ArrayRefParameter<"int64_t", "cells along each axis">:$shape,
    ArrayRefParameter<"::mlir::Type", "what each cell holds">:$children
  );
  let hasCustomAssemblyFormat = 1;
  let genVerifyDecl = 1;
}

def Tai_RootType : Tai_Type<"Root", "root"> {
  let summary = "a whole layout tree";
  let description = [{
    The root of a layout. Its children are levels, or a record of places that
    have no index (0-D fields).

    ```mlir
    !tai.root<pointer<[i: 64, j: 64], dense<[i: 8, j: 8], {m: f32, v: vector<2xf32>}>>,
              dense<[i: 256], {mass: f32}>, {loss: f32}>
    ```

    Axes are the letters `i` to `t`. An axis may be divided by several levels
    on one path; the index along it then runs to the product of the extents.
    Extents need not be powers of two. The levels inside `!tai.root` are
    written without the `!tai.` prefix; a level of another dialect is written
    in full.
  }];
  let parameters = (ins ArrayRefParameter<"::mlir::Type">:$children);
  let hasCustomAssemblyFormat = 1;
  let genVerifyDecl = 1;
}

def Tai_DenseType : Tai_LevelType<"Dense", "dense"> {
  let summary = "a level whose cells all exist";
  let description = [{
    A contiguous row-major block of cells: `dense<[i: 8, j: 8], {x: f32}>`.
    The last axis listed is the fastest. All cells are always active.
    Several children in one cell are stored one after another (array of
    structures); separate `dense` levels give separate arrays.
  }];
}

def Tai_PointerType : Tai_LevelType<"Pointer", "pointer"> {
  let summary = "a level of cells that are activated on first write";
  let description = [{
    A level for coarse blocks of cells, named after Taichi's level of pointers.
    Address space is reserved for all cells, and a bit mask records which are
    active; memory is committed when a cell is first written, and starts as zero
    (docs/decisions/0006-sparse-storage.md).
  }];
}

def Tai_BitmaskedType : Tai_LevelType<"Bitmasked", "bitmasked"> {
  let summary = "a dense block with one activity bit per cell";
  let description = [{
    Storage as `dense`, and a bit mask that records which cells are active. A
    loop over the field visits active cells only.
  }];
}

def Tai_HashType : Tai_LevelType<"Hash", "hash"> {
  let summary = "a level of cells that are far apart";
  let description = [{
    Stored like `pointer`: for cells that are expected to be far apart. The name
    is that of Taichi's hashed level; there is no hash table.
  }];
}

def Tai_DynamicType : Tai_Type<"Dynamic", "dynamic", [
    DeclareTypeInterfaceMethods<Tai_SNodeTypeInterface,
                                ["getAxes", "getShape"]>]> {
  let summary = "a list of cells that grows by append";
  let description = [{
    A list along one axis, of at most the given number of cells: `dynamic<[i:
    1024], chunk 32, {x: f32}>`. The active cells are the first `tai.length` of
    them. The chunk size is accepted for compatibility and has no effect.
  }];
  let parameters = (ins
    "unsigned":$axis, "int64_t":$capacity, "int64_t":$chunkSize,
    ArrayRefParameter<"::mlir::Type">:$children
  );
  let hasCustomAssemblyFormat = 1;
  let genVerifyDecl = 1;
}

def Tai_PlacesType : Tai_Type<"Places", "places"> {
  let summary = "the record of values at the end of a path";
  let description = [{
    Names and element types of the places in one cell. Inside a level it is
    written in braces: `{m: f32, v: vector<2xf32>, "v.grad": vector<2xf32>}`.
    Element types are integers, floats, and vectors of them with one (vector)
    or two (matrix) static dimensions. A place is the storage of a field,
    which `tai.field` names.
  }];
  let parameters = (ins
    ArrayRefParameter<"::mlir::StringAttr">:$names,
    ArrayRefParameter<"::mlir::Type">:$types
  );
  let hasCustomAssemblyFormat = 1;
  let genVerifyDecl = 1;
}

//===----------------------------------------------------------------------===//
// Locals
//===----------------------------------------------------------------------===//

def Tai_LocalType : Tai_Type<"Local", "local"> {
  let summary = "a mutable local variable";
  let description = [{
    The handle of a variable made by `tai.alloca`. It lives in one iteration of
    the innermost parallel loop around it and cannot be captured by another.
  }];
  let parameters = (ins "::mlir::Type":$elementType);
  let builders = [TypeBuilderWithInferredContext<
      (ins "::mlir::Type":$elementType),
      [{ return $_get(elementType.getContext(), elementType); }]>];
  let assemblyFormat = "`<` $elementType `>`";
}

def Tai_StackType : Tai_Type<"Stack", "stack"> {
  let summary = "a growing stack of scalars";
  let description = [{
    The handle of a stack made by `tai.stack_create`. It is used in the iteration
    of the parallel loop that makes it, and cannot be captured by another.
  }];
  let parameters = (ins "::mlir::Type":$elementType);
  let builders = [TypeBuilderWithInferredContext<
      (ins "::mlir::Type":$elementType),
      [{ return $_get(elementType.getContext(), elementType); }]>];
  let assemblyFormat = "`<` $elementType `>`";
}

#endif // TAI_DIALECT_TAI_IR_TAITYPES_TD
