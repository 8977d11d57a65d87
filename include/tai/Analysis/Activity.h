//===- Activity.h - Activity analysis ---------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A value is active if it depends on what is read from a storage with an
// adjoint, and is used by what is written to a storage with an adjoint, through
// ops that carry derivatives. No other value gets adjoint code. Arguments may
// be read, and results written, in the same sense.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_ACTIVITY_H
#define TAI_ANALYSIS_ACTIVITY_H

#include "mlir/Interfaces/ControlFlowInterfaces.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Interfaces/Differentiable.h"
#include "llvm/ADT/DenseSet.h"

namespace mlir::tai {

/// Calls `pass` with the operands that a branch or loop hands on, and the
/// values that they become: on entry, and at the end of each of its blocks.
void forEachHandover(RegionBranchOpInterface op,
                     llvm::function_ref<void(OperandRange, ValueRange)> pass);

class Activity {
public:
  /// Analyses a function, given which storages have an adjoint, and which of
  /// its values have: arguments, and operands of its terminator. With
  /// `assumeVaried`, whatever can carry a derivative is taken to depend on a
  /// wanted input.
  Activity(FunctionOpInterface function,
           llvm::function_ref<bool(Storage)> hasAdjoint,
           ArrayRef<Value> inputs = {}, ArrayRef<Value> outputs = {},
           bool assumeVaried = false);

  /// True if the value depends on a wanted input and reaches a wanted output.
  bool isActive(Value value) const {
    return (varied.contains(value) || assumed.contains(value)) &&
           useful.contains(value);
  }
  /// True if the value depends on a wanted input.
  bool isVaried(Value value) const { return varied.contains(value); }
  /// True if the access moves derivatives: a read of, or a write of an active
  /// value to, a storage with an adjoint.
  bool isActiveAccess(Operation *op) const {
    return activeAccesses.contains(op);
  }
  /// True if a region of `op` holds an active access.
  bool holdsActiveAccess(Operation *op) const { return holders.contains(op); }

private:
  llvm::DenseSet<Value> varied, useful, assumed;
  llvm::DenseSet<Operation *> activeAccesses, holders;
};

} // namespace mlir::tai

#endif // TAI_ANALYSIS_ACTIVITY_H
