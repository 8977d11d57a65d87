//===- Ownership.h - Which functions belong to tai --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Passes of tai run on modules of other compilers too, and change no function
// that has nothing to do with tai.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_OWNERSHIP_H
#define TAI_DIALECT_TAI_IR_OWNERSHIP_H

#include "mlir/IR/BuiltinOps.h"
#include "mlir/IR/SymbolTable.h"
#include "llvm/ADT/SetVector.h"

namespace mlir::tai {

/// True for ops of the dialects of tai.
bool isTaiOp(Operation *op);

/// The op of tai that `op` is or holds, or null. Modules inside are not
/// searched.
Operation *findTaiOp(Operation *op);

/// Whether `op`, which stands in the body of a module, is code of tai: an op of
/// tai, a function that holds one or was made of such a function, or a module
/// of a device with such a function.
bool isTaiCode(Operation *op);

/// Whether `op` is code of tai, or a function with an attribute `tai.*`, such
/// as one that asks for a gradient.
bool belongsToTai(Operation *op);

/// The ops of a module that are lowered: code of tai, and the functions that
/// call, directly or indirectly, a function that is. A caller is lowered too,
/// because its callee has another signature afterwards.
llvm::SetVector<Operation *> collectLowered(ModuleOp module);

/// Adds the functions that these ops name, directly or indirectly.
void addCallees(ModuleOp module, llvm::SetVector<Operation *> &ops);

/// Calls `action` with each op of a module that `op` names, and with the op
/// inside that names it.
void forEachNamed(Operation *op, SymbolTable &symbols,
                  llvm::function_ref<void(Operation *, Operation *)> action);

/// Notes on a function of another dialect that it is code of tai. An entry of
/// `passthrough`, because a pass may drop discardable attributes.
void markLowered(Operation *function);

/// Takes this mark off.
void unmarkLowered(Operation *function);

/// Calls `action` with the functions in `root` that belong to tai. Where `root`
/// is in a function, with `root` if the function belongs to tai.
void walkOwned(Operation *root, llvm::function_ref<void(Operation *)> action);

} // namespace mlir::tai

#endif // TAI_DIALECT_TAI_IR_OWNERSHIP_H
