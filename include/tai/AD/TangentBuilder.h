//===- TangentBuilder.h - Emits forward mode of a kernel --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The state of forward-mode differentiation, and what rules call to use it.
//
// A copy of the kernel is extended in place and in program order: behind each
// op stands what computes the tangents of its results. So every primal value is
// at hand, whatever is overwritten later, and nothing is recorded. A storage
// with tangents (a field with a dual, an array of the kernel's own) is accessed
// together with the storage that holds them.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_TANGENTBUILDER_H
#define TAI_AD_TANGENTBUILDER_H

#include "mlir/IR/IRMapping.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/AD/DerivativeBuilder.h"
#include "tai/Interfaces/Differentiable.h"
#include "llvm/ADT/DenseSet.h"

namespace mlir::tai {

/// Which values and local storages of a function may have a tangent other than
/// zero, and which of these tangents may be infinite or NaN though everything
/// that is read is finite.
struct TangentFlow {
  llvm::DenseSet<Value> varied, nonFinite;

  TangentFlow(FunctionOpInterface function, FloatFacts &facts,
              llvm::function_ref<bool(Storage)> hasTangent);
};

class TangentBuilder : public DerivativeBuilder {
public:
  /// Extends `function`. `tangentOf` gives the storage of tangents of a field
  /// or of an argument, or none.
  TangentBuilder(FunctionOpInterface function,
                 std::function<Storage(Storage)> tangentOf);

  /// Extends the function. Fails after an error at the op that cannot be
  /// differentiated.
  LogicalResult build();

  //===--------------------------------------------------------------------===//
  // For rules
  //===--------------------------------------------------------------------===//

  /// True if the value may have a tangent other than zero.
  bool isVaried(Value value) const { return flow.varied.contains(value); }
  /// True if the tangent may be infinite or NaN though what is read is finite.
  bool mayBeNonFinite(Value value) const {
    return flow.nonFinite.contains(value);
  }
  /// The value itself: the kernel computes it anyway.
  Value getPrimal(Value value) override { return value; }
  /// The tangent, or null where it is zero.
  Value getTangent(Value value);
  /// The tangent, as a constant zero where it is zero.
  Value getTangentOrZero(Value value);
  /// Sets the tangent; null is zero.
  void setTangent(Value value, Value tangent);
  /// `product`, of the tangent of `operand` and a partial derivative, without
  /// the infinity or NaN of the one where the other is zero. The partial is
  /// built if it is needed.
  Value createProduct(Value operand, Value product, bool partialMayBeNonFinite,
                      llvm::function_ref<Value()> createPartial);
  /// For an op that is linear in its float operands: the same op on their
  /// tangents. Others, such as indices, stay.
  void applyToTangents(Operation *op);

  //===--------------------------------------------------------------------===//
  // For loops and accesses
  //===--------------------------------------------------------------------===//

  /// The storage of tangents of a field, an argument or a local array; null if
  /// it has none.
  Storage getTangentStorage(Storage storage);
  /// Extends the ops of a block, the terminator left out.
  LogicalResult extendBlock(Block *block);
  /// Puts `made`, whose first results are those of `op`, in its place. What is
  /// known of the values of `op` holds for those of `made`.
  void replace(Operation *op, Operation *made);
  /// Says that the element that the access reaches may be reached by other
  /// iterations at the same time, and that a tangent cannot be kept in step
  /// with it then. Runs the tai loops around it in order; reports an error if
  /// the loops cannot be.
  LogicalResult runInOrder(Operation *access);
  /// True if no other iteration of the loop around the access reaches its
  /// element.
  bool isExclusive(Operation *access);

  /// Reports that `op` cannot be differentiated; building then fails.
  InFlightDiagnostic emitError(Operation *op, const Twine &message);

private:
  LogicalResult extendOp(Operation *op);
  LogicalResult extendAccess(Operation *op);
  /// Extends the making, reading, writing and freeing of local storages;
  /// nothing if `op` does none of these.
  std::optional<LogicalResult> extendLocal(Operation *op);
  LogicalResult checkUsers(Value array);

  FunctionOpInterface function;
  std::function<Storage(Storage)> tangentOf;
  TangentFlow flow;
  llvm::DenseMap<Value, Value> tangents;
  /// Local arrays and variables by those of their tangents.
  llvm::DenseMap<Value, Value> shadows;
  /// Loops that are made again leave an empty op behind; facts about its values
  /// are known by their addresses, so it is erased last.
  SmallVector<Operation *> replaced;
  bool hasErrors = false;
};

} // namespace mlir::tai

#endif // TAI_AD_TANGENTBUILDER_H
