//===- AccessLowering.h - State of access lowerings -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The shared state of the patterns of `tai-lower-layout`: base addresses,
// checks of indices, and alias scopes.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_LAYOUTTORT_ACCESSLOWERING_H
#define TAI_LIB_CONVERSION_LAYOUTTORT_ACCESSLOWERING_H

#include "StridedOrder.h"
#include "mlir/IR/PatternMatch.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"
#include "tai/Transforms/Utils/FieldAddress.h"

namespace mlir::tai {

/// Access groups of loops with independent iterations. Each group is a distinct
/// attribute, which the MLIR context never frees (and each thread's first takes
/// 4 KiB); so the groups of one module are reused for the next.
class AccessGroups {
public:
  /// Makes all access groups available again, for the next module.
  void reuse() { used = 0; }
  void forget() {
    groups.clear();
    used = 0;
  }

  /// Returns the access group of the independent loop around an access, if
  /// there is one. Accesses to arrays, which may alias each other, belong to it
  /// too: iterations do not communicate through arrays either.
  ArrayAttr get(Operation *op) {
    auto loop = op->getParentOfType<ParallelForOp>();
    if (!loop || !loop->hasAttr(kIndependentAttrName) ||
        loop->hasAttr(kKeepsOrderAttrName))
      return {};
    MLIRContext *context = op->getContext();
    auto group =
        loop->getAttrOfType<LLVM::AccessGroupAttr>(kAccessGroupAttrName);
    if (!group) {
      if (used == groups.size())
        groups.push_back(LLVM::AccessGroupAttr::get(context));
      group = groups[used++];
      loop->setAttr(kAccessGroupAttrName, group);
    }
    return ArrayAttr::get(context, {group});
  }

private:
  SmallVector<LLVM::AccessGroupAttr> groups;
  size_t used = 0;
};

/// Emits `access` in place of `op`, under `condition`. Returns its value, or
/// zero where the condition is false; null if the result of `op` is unused.
Value emitWhere(OpBuilder &builder, Operation *op, Value condition,
                llvm::function_ref<Value(OpBuilder &)> access);

/// The shared state of the lowerings of one kernel's or function's accesses.
class AccessLowering {
public:
  AccessLowering(FunctionOpInterface function, FieldTable &fields,
                 AccessGroups &groups,
                 const llvm::DenseSet<Attribute> &adjoints, bool boundsCheck,
                 bool onDevice)
      : function(function), fields(fields), groups(groups), adjoints(adjoints),
        boundsCheck(boundsCheck), onDevice(onDevice) {}

  /// Looks up the field that a field access names.
  FailureOr<const FieldInfo *> getField(Operation *op) {
    return fields.lookup(op, getNamedField(op));
  }
  AliasScopes getFieldScopes(Operation *op, const FieldInfo &field) {
    AliasScopes scopes = fields.getScopes(field);
    scopes.groups = groups.get(op);
    return scopes;
  }
  /// True if later passes are to know that the op accesses the adjoint of a
  /// field.
  bool marksAdjoint(Operation *op) const {
    return !onDevice && adjoints.contains(getNamedField(op).getAttr());
  }
  AliasScopes getArrayScopes(Operation *op) {
    AliasScopes scopes = fields.getArrayScopes();
    scopes.groups = groups.get(op);
    return scopes;
  }
  /// True if the accesses being lowered are in device code.
  bool isOnDevice() const { return onDevice && isa<KernelOp>(function); }

  /// Returns the address of the first component of a field, or of the field's
  /// tree, built once at the top of the function.
  Value getFieldBase(const FieldInfo &field);
  Value getTreeBase(const FieldInfo &field);

  /// Activates the cell of an element or, in a kernel that must not change
  /// activity, only tests whether the cell is active. Returns an i1: whether
  /// the cell is active afterwards.
  Value emitActivation(OpBuilder &builder, Location loc, const FieldInfo &field,
                       ValueRange zeroBased);

  /// Replaces `op` by the ops that `access` emits, under the condition
  /// `inRange` (unconditionally, if null). The results of `op` become the value
  /// that `access` returns, or zero where `inRange` is false.
  void replaceGuarded(PatternRewriter &rewriter, Operation *op, Value inRange,
                      function_ref<Value(OpBuilder &)> access);

  /// Emits before `op` an assertion that each index is in its range, and
  /// returns the condition; null if the access is not to be checked.
  Value checkRange(Operation *op, ValueRange zeroBased,
                   ArrayRef<OpFoldResult> extents, const Twine &what,
                   ValueRange shown);
  /// Emits the assertions of checkRange for the indices of an element of a
  /// field and the indices of its components.
  Value checkElement(FieldAccessOpInterface op, const FieldInfo &field,
                     ValueRange zeroBased);

private:
  Value checkCasts(OpBuilder &builder, Location loc, ValueRange indices,
                   const Twine &what, ValueRange whatShows);

  FunctionOpInterface function;
  FieldTable &fields;
  AccessGroups &groups;
  /// The names of the fields that are adjoints of others.
  const llvm::DenseSet<Attribute> &adjoints;
  bool boundsCheck, onDevice;
  llvm::DenseMap<const FieldInfo *, Value> bases;
  llvm::DenseMap<Operation *, Value> trees;
};

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_LAYOUTTORT_ACCESSLOWERING_H
