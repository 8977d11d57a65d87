//===- TangentBuilder.h - Emits forward mode of a kernel --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The state of forward-mode differentiation, and the operations that rules
// call.
//
// A copy of the kernel is extended in place and in program order: each op is
// followed by the ops that compute the tangents of its results. So every primal
// value is available, whatever is overwritten later, and nothing is recorded. A
// storage with tangents (a field with a dual, a local array) is accessed
// together with the storage that holds them.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_FORWARD_TANGENTBUILDER_H
#define TAI_AD_FORWARD_TANGENTBUILDER_H

#include "mlir/IR/IRMapping.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/AD/DerivativeBuilder.h"
#include "tai/Interfaces/Differentiable.h"
#include "llvm/ADT/DenseSet.h"

namespace mlir::tai {

/// The values and local storages of a function that may have a non-zero tangent
/// (`varied`), and the ones whose tangent may be infinite or NaN though all
/// inputs are finite (`nonFinite`).
struct TangentFlow {
  llvm::DenseSet<Value> varied, nonFinite;

  TangentFlow(FunctionOpInterface function, FloatFacts &facts,
              llvm::function_ref<bool(Storage)> hasTangent);
};

class TangentBuilder : public DerivativeBuilder {
public:
  /// Builds tangents for `function`. `tangentOf` maps a field or an argument to
  /// the storage of its tangents, or to none.
  TangentBuilder(FunctionOpInterface function,
                 std::function<Storage(Storage)> tangentOf);

  /// Extends the function by tangents. Fails after an error at the op that
  /// cannot be differentiated.
  LogicalResult build();

  //===--------------------------------------------------------------------===//
  // For rules
  //===--------------------------------------------------------------------===//

  /// True if a value of the function may have a tangent other than zero.
  bool isVaried(Value value) const { return flow.varied.contains(value); }
  /// True if the tangent of a value may be infinite or NaN even where all
  /// inputs are finite.
  bool mayBeNonFinite(Value value) const {
    return flow.nonFinite.contains(value);
  }
  /// In forward mode, a primal value is the value itself, because the extended
  /// kernel computes it.
  Value getPrimal(Value value) override { return value; }
  /// The tangent of a value, or null where the tangent is zero.
  Value getTangent(Value value);
  /// The tangent of a value, as a constant zero where it is zero.
  Value getTangentOrZero(Value value);
  /// Sets the tangent of a value; a null tangent is zero.
  void setTangent(Value value, Value tangent);
  /// Returns `product`, which is the tangent of `operand` times a partial
  /// derivative, but zero where one of these factors is zero and the other
  /// infinite or NaN. `createPartial` is called only if the test for this case
  /// is needed.
  Value createProduct(Value operand, Value product, bool partialMayBeNonFinite,
                      llvm::function_ref<Value()> createPartial);
  /// For an op that is linear in its float operands: the same op on their
  /// tangents. Other operands, such as indices, are kept.
  void applyToTangents(Operation *op);

  //===--------------------------------------------------------------------===//
  // For loops and accesses
  //===--------------------------------------------------------------------===//

  /// The storage of tangents of a field, an argument or a local array; null if
  /// it has none.
  Storage getTangentStorage(Storage storage);
  /// Extends the ops of a block, except the terminator, by their tangents.
  LogicalResult extendBlock(Block *block);
  /// Replaces `op` by `made`, whose first results correspond to the results of
  /// `op`. Known facts about the values of `op`, such as their tangents, carry
  /// over.
  void replace(Operation *op, Operation *made);
  /// Serialises the tai loops around an access whose element other iterations
  /// may update at the same time, since element and tangent cannot be updated
  /// together atomically. Reports an error if a loop around it cannot be
  /// serialised.
  LogicalResult runInOrder(Operation *access);
  /// True if no other iteration of the loop around an access reaches the
  /// element of the access.
  bool isExclusive(Operation *access);

  /// Reports that `op` cannot be differentiated; building the tangents then
  /// fails.
  InFlightDiagnostic emitError(Operation *op, const Twine &message);

private:
  LogicalResult extendOp(Operation *op);
  LogicalResult extendAccess(Operation *op);
  /// Extends an op on a local array or variable (allocation, read, write,
  /// deallocation) by the same op on its tangents; returns none if `op` is
  /// another kind of op.
  std::optional<LogicalResult> extendLocal(Operation *op);
  LogicalResult checkUsers(Value array);

  FunctionOpInterface function;
  std::function<Storage(Storage)> tangentOf;
  TangentFlow flow;
  llvm::DenseMap<Value, Value> tangents;
  /// Maps local arrays and variables to the arrays and variables of their
  /// tangents.
  llvm::DenseMap<Value, Value> shadows;
  /// Loops that were rebuilt, left in the function as empty ops. Facts are
  /// keyed by the addresses of values of these ops, so the ops are erased last.
  SmallVector<Operation *> replaced;
  bool hasErrors = false;
};

} // namespace mlir::tai

#endif // TAI_AD_FORWARD_TANGENTBUILDER_H
