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
#include "tai/Transforms/Utils/Accumulate.h"
#include "tai/Transforms/Utils/FieldAddress.h"

namespace mlir::tai {

/// Access groups of loops with independent iterations. Each is a distinct
/// attribute, which a context never frees (with 4 KiB for the first of each
/// thread); so the groups of one module are reused for the next.
class AccessGroups {
public:
  /// Makes all groups available again.
  void reuse() { used = 0; }
  void forget() {
    groups.clear();
    used = 0;
  }

  /// The group of the independent loop around an access, if there is one.
  /// Arrays may alias each other, but iterations do not communicate through
  /// them either.
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
                 AccessGroups &groups, bool boundsCheck, bool onDevice)
      : function(function), fields(fields), groups(groups),
        boundsCheck(boundsCheck), onDevice(onDevice) {}

  /// The field that an op names.
  FailureOr<const FieldInfo *> getField(Operation *op) {
    return fields.lookup(op, getNamedField(op));
  }
  AliasScopes getFieldScopes(Operation *op, const FieldInfo &field) {
    AliasScopes scopes = fields.getScopes(field);
    scopes.groups = groups.get(op);
    return scopes;
  }
  AliasScopes getArrayScopes(Operation *op) {
    AliasScopes scopes = fields.getArrayScopes();
    scopes.groups = groups.get(op);
    return scopes;
  }
  /// Whether accesses are in device code.
  bool isOnDevice() const { return onDevice && isa<KernelOp>(function); }

  /// The address of the first component of the field, and of its tree, built
  /// once at the top of the function.
  Value getFieldBase(const FieldInfo &field);
  Value getTreeBase(const FieldInfo &field);

  /// Activates the cell of an element, or, in a kernel that must not change
  /// activity, only tests it. Returns an i1: whether the cell is active
  /// afterwards.
  Value emitActivation(OpBuilder &builder, Location loc, const FieldInfo &field,
                       ValueRange zeroBased);

  /// Replaces `op` by the ops that `access` emits, under `inRange` (always, if
  /// null); its results become their value, or zero.
  void replaceGuarded(PatternRewriter &rewriter, Operation *op, Value inRange,
                      function_ref<Value(OpBuilder &)> access);

  /// Emits before `op` an assertion that each index is in its range, and
  /// returns the condition; null if unchecked.
  Value checkRange(Operation *op, ValueRange zeroBased,
                   ArrayRef<OpFoldResult> extents, const Twine &what,
                   ValueRange shown);
  /// The same for the element of a field, and the components in it.
  Value checkElement(FieldAccessOpInterface op, const FieldInfo &field,
                     ValueRange zeroBased);

private:
  Value checkCasts(OpBuilder &builder, Location loc, ValueRange indices,
                   const Twine &what, ValueRange whatShows);

  FunctionOpInterface function;
  FieldTable &fields;
  AccessGroups &groups;
  bool boundsCheck, onDevice;
  llvm::DenseMap<const FieldInfo *, Value> bases;
  llvm::DenseMap<Operation *, Value> trees;
};

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_LAYOUTTORT_ACCESSLOWERING_H
