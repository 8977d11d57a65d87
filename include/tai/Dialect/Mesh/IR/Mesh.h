//===- Mesh.h - The dialect of meshes ---------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Fields that are divided among processes, and the ops by which the processes
// communicate.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_MESH_IR_MESH_H
#define TAI_DIALECT_MESH_IR_MESH_H

#include "mlir/Bytecode/BytecodeOpInterface.h"
#include "mlir/IR/BuiltinAttributes.h"
#include "mlir/IR/Dialect.h"
#include "mlir/IR/OpDefinition.h"
#include "mlir/IR/OpImplementation.h"
#include "mlir/IR/SymbolTable.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Dialect/Tai/IR/Layout.h"

#include "tai/Dialect/Mesh/IR/MeshDialect.h.inc"
#include "tai/Dialect/Mesh/IR/MeshEnums.h.inc"

#define GET_ATTRDEF_CLASSES
#include "tai/Dialect/Mesh/IR/MeshAttrs.h.inc"
#define GET_TYPEDEF_CLASSES
#include "tai/Dialect/Mesh/IR/MeshTypes.h.inc"
#define GET_OP_CLASSES
#include "tai/Dialect/Mesh/IR/MeshOps.h.inc"

namespace mlir::tai {

/// The attribute of a parallel loop with the number of rows, on either side of
/// those of a rank, among which data may choose: an integer, -1 for all rows.
/// Without the attribute, such accesses to sharded fields are refused.
inline constexpr llvm::StringLiteral kHaloAttrName = "tai_mesh.halo";

/// The attribute of a module with the number of the process that runs its
/// kernels, an integer. `tai-shard` removes it.
inline constexpr llvm::StringLiteral kRankAttrName = "tai_mesh.rank_of_process";

/// How a `shard` level divides a field among ranks: rank r has the `block` rows
/// from `first` + r * `block` on, by their indices along `dimension`.
struct Sharding {
  unsigned dimension;
  int64_t ranks, block, first;
};

/// The sharding of a field; none if each rank has all of it.
std::optional<Sharding> getSharding(const FieldLayout &layout);
/// The same for the field that `name` refers to from `user`.
std::optional<Sharding> findSharding(Operation *user, FlatSymbolRefAttr name);

/// True if the tree has a `shard` level.
bool hasShards(TreeOp tree);
/// Reports levels that cannot stand above a `shard` level.
LogicalResult verifyShards(TreeOp tree);

} // namespace mlir::tai

#endif // TAI_DIALECT_MESH_IR_MESH_H
