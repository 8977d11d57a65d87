//===- Accumulate.h - Read-modify-write of memory ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_UTILS_ACCUMULATE_H
#define TAI_LIB_TRANSFORMS_UTILS_ACCUMULATE_H

#include "FieldAddress.h"

namespace mlir::tai {

/// On tai.atomic: how `tai-relax-atomics` decided to do it, "register" or
/// "private". Absent: atomic, or plain if exclusive.
constexpr llvm::StringLiteral kAccumulateAttrName = "tai.accumulate";

/// On tai.parallel_for: no iteration touches memory that another writes, so
/// that LLVM may vectorise over them whatever the addresses.
constexpr llvm::StringLiteral kIndependentAttrName = "tai.independent";

/// On tai.parallel_for, for a GPU: one warp runs it, whose threads do their
/// additions together and in a fixed order.
constexpr llvm::StringLiteral kInWarpAttrName = "tai.in_warp";

/// On tai.parallel_for: the group that its accesses were put into.
constexpr llvm::StringLiteral kAccessGroupAttrName = "tai.access_group";

/// On tai.parallel_for: a partition counts only so many of the first
/// dimensions.
constexpr llvm::StringLiteral kOuterDimsAttrName = "tai.outer_dims";

/// On a write: its cell is known to be active.
constexpr llvm::StringLiteral kActiveAttrName = "tai.active";

/// On an op of floats: its order is part of the result in every mode.
constexpr llvm::StringLiteral kOrderedAttrName = "tai.ordered";

/// On tai.assert: the TaiFailure it reports (see tai/Runtime/Abi.h). Absent:
/// that of the user's own assertion, which only debug mode keeps.
constexpr llvm::StringLiteral kFailureAttrName = "tai.failure";

/// a (kind) b, for scalars or vectors of them.
Value emitCombination(OpBuilder &builder, Location loc, AtomicKind kind,
                      Value a, Value b);

/// Reads, combines and writes, for memory that no other thread touches. Yields
/// what was read.
Value emitPlainUpdate(OpBuilder &builder, Location loc, AtomicKind kind,
                      Value value, Value pointer, AliasScopes scopes);

/// The same in one indivisible step.
Value emitAtomicUpdate(OpBuilder &builder, Location loc, AtomicKind kind,
                       Value value, Value pointer, AliasScopes scopes);

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_UTILS_ACCUMULATE_H
