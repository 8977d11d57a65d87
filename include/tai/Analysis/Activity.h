//===- Activity.h - Activity analysis ---------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A value is active if it depends, through ops that carry derivatives, on a
// value read from a storage with an adjoint (varied), and a value written to
// such a storage depends on it (useful). No other value gets adjoint code.
// Arguments may count as reads, and results as writes.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_ACTIVITY_H
#define TAI_ANALYSIS_ACTIVITY_H

#include "mlir/Interfaces/ControlFlowInterfaces.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Interfaces/Differentiable.h"
#include "llvm/ADT/DenseSet.h"

namespace mlir::tai {

/// For each branch or loop edge of `op`, calls `pass` with the forwarded
/// operands and the values that receive them: on entry, and at the end of each
/// of the op's blocks.
void forEachForwarding(RegionBranchOpInterface op,
                       llvm::function_ref<void(OperandRange, ValueRange)> pass);

class Activity {
public:
  /// Analyses a function. `hasAdjoint` tells which storages have an adjoint;
  /// `inputs` are the arguments with an adjoint, and `outputs` the operands of
  /// the terminator with an adjoint. With `assumeVaried`, every value that can
  /// carry a derivative is assumed to be varied.
  Activity(FunctionOpInterface function,
           llvm::function_ref<bool(Storage)> hasAdjoint,
           ArrayRef<Value> inputs = {}, ArrayRef<Value> outputs = {},
           bool assumeVaried = false);

  /// True if a value is varied (or assumed to be) and useful, so that it needs
  /// an adjoint.
  bool isActive(Value value) const {
    return (varied.contains(value) || assumed.contains(value)) &&
           useful.contains(value);
  }
  /// True if the value depends on an input with a derivative.
  bool isVaried(Value value) const { return varied.contains(value); }
  /// True if derivatives pass through the access: a read of, or a write of an
  /// active value to, a storage with an adjoint.
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
