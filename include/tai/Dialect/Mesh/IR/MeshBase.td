//===- MeshBase.td - The dialect of meshes -----------------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_MESH_IR_MESHBASE_TD
#define TAI_DIALECT_MESH_IR_MESHBASE_TD

include "mlir/IR/DialectBase.td"
include "mlir/IR/EnumAttr.td"

def TaiMesh_Dialect : Dialect {
  let name = "tai_mesh";
  let cppNamespace = "::mlir::tai";
  let summary = "fields that several processes share";
  let description = [{
    A mesh is a set of processes, its ranks, that run the same program. The
    dialect adds a level to the layouts of `tai`, which divides the elements of
    fields among the ranks, and the ops by which the ranks communicate. Kernels
    are written without it; `tai-shard` creates the ops. See
    docs/decisions/0075-shards.md.
  }];
  let useDefaultTypePrinterParser = 1;
  let useDefaultAttributePrinterParser = 1;
}

def TaiMesh_ExchangeKind
    : I32EnumAttr<"ExchangeKind", "how ranks communicate about a field", [
    I32EnumAttrCase<"Fetch", 0, "fetch">, I32EnumAttrCase<"Clear", 1, "clear">,
    I32EnumAttrCase<"Collect", 2, "collect">,
    I32EnumAttrCase<"Open", 3, "open">, I32EnumAttrCase<"Sum", 4, "sum">,
    I32EnumAttrCase<"Min", 5, "min">, I32EnumAttrCase<"Max", 6, "max">,
    I32EnumAttrCase<"Gather", 7, "gather">,
    I32EnumAttrCase<"Stale", 8, "stale">]> {
  let cppNamespace = "::mlir::tai";
  let genSpecializedAttr = 0;
}
def TaiMesh_ExchangeKindAttr
    : EnumAttr<TaiMesh_Dialect, TaiMesh_ExchangeKind, "exchange_kind"> {
  let assemblyFormat = "$value";
}

#endif // TAI_DIALECT_MESH_IR_MESHBASE_TD
