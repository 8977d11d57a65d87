//===- MeshOps.td - Levels and ops for meshes --------------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_MESH_IR_MESHOPS_TD
#define TAI_DIALECT_MESH_IR_MESHOPS_TD

include "mlir/IR/AttrTypeBase.td"
include "mlir/IR/BuiltinAttributes.td"
include "mlir/IR/CommonAttrConstraints.td"
include "mlir/IR/CommonTypeConstraints.td"
include "mlir/IR/OpBase.td"
include "mlir/IR/SymbolInterfaces.td"
include "mlir/Interfaces/SideEffectInterfaces.td"
include "tai/Dialect/Mesh/IR/MeshBase.td"
include "tai/Dialect/Tai/IR/TaiInterfaces.td"

def TaiMesh_ShardType : TypeDef<TaiMesh_Dialect, "Shard", [
    DeclareTypeInterfaceMethods<Tai_SNodeTypeInterface,
                                ["getAxes", "getShape"]>]> {
  let mnemonic = "shard";
  let summary = "a level whose rows belong to the ranks of a mesh";
  let description = [{
    Divides the elements below it among ranks: of the fields of

    ```mlir
    !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64, j: 8], {x: f32}>>>
    ```

    rank 0 has the first 16 rows along axis `i`, and rank 3 the last 16. A rank
    computes and stores its own rows, and copies of rows of other ranks around
    them, which are its halos; see `tai-shard`.

    The level has a single cell and no part in indices and addresses: kernels
    use the indices of the whole field, and every rank reserves address space
    for all rows. Below a shard, one level divides its axis, and the number of
    ranks divides that level's extent. All levels above and below are `dense`.
  }];
  let parameters = (ins
    "unsigned":$axis, "int64_t":$ranks,
    ArrayRefParameter<"::mlir::Type">:$children
  );
  let hasCustomAssemblyFormat = 1;
  let genVerifyDecl = 1;
}

class TaiMesh_Op<string mnemonic, list<Trait> traits = []>
    : Op<TaiMesh_Dialect, mnemonic, traits>;

def TaiMesh_RankOp : TaiMesh_Op<"rank", [MemoryEffects<[MemRead, MemWrite]>]> {
  let summary = "the number of this process in its mesh";
  let description = [{
    Yields the number of the process that runs the kernel, from 0 to `ranks` - 1.
    The launch fails if the mesh of the process has another number of ranks;
    this is why an op without users stays. Created by `tai-shard`. If the module
    has the attribute `tai_mesh.rank_of_process`, the users of the op take that
    number instead.

    ```mlir
    %rank = tai_mesh.rank of 4
    ```
  }];
  let arguments = (ins ConfinedAttr<I64Attr, [IntPositive]>:$ranks);
  let results = (outs Index:$rank);
  let assemblyFormat = "`of` $ranks attr-dict";
}

def TaiMesh_ExchangeOp : TaiMesh_Op<"exchange", [
    MemoryEffects<[MemRead, MemWrite]>,
    DeclareOpInterfaceMethods<SymbolUserOpInterface>]> {
  let summary = "let ranks exchange elements of a field";
  let description = [{
    All ranks of the mesh execute this op together. The first five kinds are
    for a field below a `shard` level. Its halos are the `before` rows in front
    of the rows of this rank, and the `after` rows behind them, as far as the
    field has such rows:

    - `fetch` copies the halos from the ranks that own them;
    - `clear` sets the halos to zero, in this rank's memory alone;
    - `collect` adds the halos of all ranks to the rows of the owners;
    - `gather` copies all rows from the ranks that own them;
    - `stale` notes that rows have changed. A `fetch` of halos that the rank has
      fetched before, and of which no row can have changed, does nothing.

    The other kinds are for a field of which each rank has its own copy. `open`
    and `sum` are for sharded fields, too, and then about all rows:

    - `open` sets the elements to zero on all ranks but rank 0, or those of rows
      of other ranks, in preparation for `sum`;
    - `sum`, `min` and `max` replace each element by the combination of the
      copies of all ranks.

    `at` limits the op to the elements with the given indices along the
    dimensions `dims`; nothing happens if one of them is not in the field.
    `digest` identifies the kernel: ranks that run different kernels report an
    error. Created by `tai-shard`.

    1. (exchange_c1) `field` names a `tai.field`, without sparse levels.
    2. (exchange_c2) The field is below a `shard` level for the first
       five kinds, and not for `min` and `max`.
    3. (exchange_c3) `before` and `after` are from 0 to the number of rows of a
       rank, and 0 for fields that are not sharded.
    4. (exchange_c4) `dims` are ascending dimensions of the field, one for each
       index, and do not include the sharded one.

    ```mlir
    tai_mesh.exchange fetch @x before 1 after 1 at [%t] dims [0]
    tai_mesh.exchange sum @loss
    ```
  }];
  let arguments = (ins TaiMesh_ExchangeKindAttr:$kind, FlatSymbolRefAttr:$field,
                       DefaultValuedAttr<I64Attr, "0">:$before,
                       DefaultValuedAttr<I64Attr, "0">:$after,
                       Variadic<Index>:$at,
                       DefaultValuedAttr<DenseI64ArrayAttr, "{}">:$dims,
                       OptionalAttr<I64Attr>:$digest);
  let assemblyFormat = [{
    $kind $field (`before` $before^)? (`after` $after^)?
    (`at` `[` $at^ `]` `dims` $dims)? attr-dict
  }];
}

#endif // TAI_DIALECT_MESH_IR_MESHOPS_TD
