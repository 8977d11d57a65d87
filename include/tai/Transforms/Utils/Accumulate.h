//===- Accumulate.h - Read-modify-write of memory ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_UTILS_ACCUMULATE_H
#define TAI_TRANSFORMS_UTILS_ACCUMULATE_H

#include "tai/Transforms/Utils/FieldAddress.h"

namespace mlir::tai {

/// On an update of memory other than tai.atomic (which has the attribute
/// `strategy` for this): the sum is kept in a register. Without it, the update
/// is atomic.
constexpr llvm::StringLiteral kAccumulateAttrName = "tai.accumulate";
constexpr llvm::StringLiteral kRegister = "register";

/// True for an update whose sum is kept in a register.
bool isKeptInRegister(Operation *update);
/// True for an update that the lowering of the loop handles, not the lowering
/// of memory accesses.
bool isDoneByLoop(Operation *update);

/// On tai.parallel_for: no iteration accesses memory that another writes, so
/// that LLVM may vectorise without a dependence check.
constexpr llvm::StringLiteral kIndependentAttrName = "tai.independent";

/// On tai.parallel_for: the LLVM access group of its accesses.
constexpr llvm::StringLiteral kAccessGroupAttrName = "tai.access_group";

/// On a write: its cell is known to be active.
constexpr llvm::StringLiteral kActiveAttrName = "tai.active";

/// For deterministic mode: fails at a float addition to memory that several
/// iterations may reach in any order; `tai-relax-atomics` must have removed
/// them.
LogicalResult checkOrderIsFixed(ParallelForOp loop);

/// a (kind) b, for scalars or vectors of them.
Value emitCombination(OpBuilder &builder, Location loc, AtomicKind kind,
                      Value a, Value b);

/// A read-modify-write of memory that no other thread accesses. Returns the old
/// value.
Value emitPlainUpdate(OpBuilder &builder, Location loc, AtomicKind kind,
                      Value value, Value pointer, AliasScopes scopes);

/// The same as an atomic operation.
Value emitAtomicUpdate(OpBuilder &builder, Location loc, AtomicKind kind,
                       Value value, Value pointer, AliasScopes scopes);

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_ACCUMULATE_H
