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

/// On an update of memory that is no tai.atomic, whose strategy it would be:
/// its sum is one in a register. Without, the update is an atomic one.
constexpr llvm::StringLiteral kAccumulateAttrName = "tai.accumulate";
constexpr llvm::StringLiteral kRegister = "register";

/// True for an update of any kind whose sum is kept in a register.
bool isKeptInRegister(Operation *update);
/// True for an update that the lowering of the loop does, not that of memory.
bool isDoneByLoop(Operation *update);

/// On tai.parallel_for: no iteration touches memory that another writes, so
/// that LLVM may vectorise over them whatever the addresses.
constexpr llvm::StringLiteral kIndependentAttrName = "tai.independent";

/// On tai.parallel_for: the group that its accesses were put into.
constexpr llvm::StringLiteral kAccessGroupAttrName = "tai.access_group";

/// On a write: its cell is known to be active.
constexpr llvm::StringLiteral kActiveAttrName = "tai.active";

/// Fails, in deterministic mode, at a float addition to memory that several
/// iterations may reach in any order: `tai-relax-atomics` leaves none.
LogicalResult checkOrderIsFixed(ParallelForOp loop);

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

#endif // TAI_TRANSFORMS_UTILS_ACCUMULATE_H
