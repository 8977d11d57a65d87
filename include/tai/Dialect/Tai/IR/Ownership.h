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

/// True for ops of the project's own dialects (tai, tai_rt and others).
bool isTaiOp(Operation *op);

/// Returns `op` or an op nested in it that belongs to a dialect of tai, or null
/// if there is none. Nested modules are not searched.
Operation *findTaiOp(Operation *op);

/// True if `op`, which stands in the body of a module, is code of the dialects
/// of tai: one of their ops, a function that holds such an op or was made from
/// such a function, or a device module with such a function.
bool isTaiCode(Operation *op);

/// True if `op` is code of the dialects of tai, or a function with an attribute
/// `tai.*`, such as a function that asks for a gradient.
bool belongsToTai(Operation *op);

/// The ops of a module that are lowered: code of the dialects of tai, and the
/// functions that call such code directly or indirectly. A caller is lowered
/// too, because lowering changes the signature of the callee.
llvm::SetVector<Operation *> collectLowered(ModuleOp module);

/// Adds to `ops` the functions that the ops in `ops` refer to by name, directly
/// or indirectly.
void addCallees(ModuleOp module, llvm::SetVector<Operation *> &ops);

/// For each op nested in `op` that refers to a symbol of the module, calls
/// `action` with the op of that symbol and with the referring op.
void forEachNamed(Operation *op, SymbolTable &symbols,
                  llvm::function_ref<void(Operation *, Operation *)> action);

/// Marks a function of another dialect as lowered from code of tai. The mark is
/// an entry of `passthrough`, because passes are free to drop discardable
/// attributes.
void markLowered(Operation *function);

/// Removes the mark that markLowered sets.
void unmarkLowered(Operation *function);

/// Calls `action` with the functions in `root` that belong to tai (see
/// belongsToTai). If `root` is inside a function that belongs to tai, calls
/// `action` with `root` instead.
void walkOwned(Operation *root, llvm::function_ref<void(Operation *)> action);

} // namespace mlir::tai

#endif // TAI_DIALECT_TAI_IR_OWNERSHIP_H
