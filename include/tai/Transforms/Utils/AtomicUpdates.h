//===- AtomicUpdates.h - Read-modify-write of memory ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_UTILS_ATOMICUPDATES_H
#define TAI_TRANSFORMS_UTILS_ATOMICUPDATES_H

#include "tai/Analysis/Reductions/Accumulation.h"
#include "tai/Transforms/Utils/FieldAddress.h"

namespace mlir::tai {

/// On tai.parallel_for: the LLVM access group of the loop's memory accesses.
constexpr llvm::StringLiteral kAccessGroupAttrName = "tai.access_group";

/// If the loop has a fixed order, emits an error and fails at a float addition
/// to memory that several iterations may reach in any order.
LogicalResult checkOrderIsFixed(ParallelForOp loop);

/// Emits the combination of `a` and `b` by an update of the given kind, such as
/// their sum, for scalars or vectors.
Value emitCombination(OpBuilder &builder, Location loc, AtomicKind kind,
                      Value a, Value b);

/// Emits a read-modify-write of memory that no other thread accesses, without
/// an atomic operation. Returns the old value.
Value emitPlainUpdate(OpBuilder &builder, Location loc, AtomicKind kind,
                      Value value, Value pointer, AliasScopes scopes);

/// Emits a read-modify-write of memory by one atomic operation. Returns the old
/// value.
Value emitAtomicUpdate(OpBuilder &builder, Location loc, AtomicKind kind,
                       Value value, Value pointer, AliasScopes scopes);

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_ATOMICUPDATES_H
