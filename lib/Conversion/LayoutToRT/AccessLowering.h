//===- AccessLowering.h - What lowerings of accesses share ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The patterns of `tai-lower-layout` see one of these: the addresses that they
// have in common, the checks of indices, and what aliases what.
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

/// Groups of accesses that do not depend on those of other iterations. Each is
/// an attribute of its own that a context keeps for ever, with 4 KiB for the
/// first that a thread makes; so those of one module serve the next.
class AccessGroups {
public:
  /// Hands all groups out again.
  void reuse() { used = 0; }
  void forget() {
    groups.clear();
    used = 0;
  }

  /// The group of the independent loop around an access, if there is one.
  /// Arrays may be one another, but iterations do not communicate through them
  /// either.
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

/// Emits what `access` does in the place of `op`, where the condition holds.
/// Yields its value, or zero where not; null if nobody uses that of `op`.
Value emitWhere(OpBuilder &builder, Operation *op, Value condition,
                llvm::function_ref<Value(OpBuilder &)> access);

/// What the lowerings of the accesses of one kernel or function share.
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
  /// Whether accesses lie in the code of a kernel on a device.
  bool isOnDevice() const { return onDevice && isa<KernelOp>(function); }

  /// The address of the first component of the field, and of its tree, built
  /// once at the top of the function.
  Value getFieldBase(const FieldInfo &field);
  Value getTreeBase(const FieldInfo &field);

  /// Makes the cell of an element active, or only asks whether it is where the
  /// kernel keeps activity as it is. Yields whether it is then.
  Value emitActivation(OpBuilder &builder, Location loc, const FieldInfo &field,
                       ValueRange zeroBased);

  /// Puts what `access` emits, if `inRange` holds (always, if null), in the
  /// place of `op`: its results become what that yields, or zero.
  void replaceGuarded(PatternRewriter &rewriter, Operation *op, Value inRange,
                      function_ref<Value(OpBuilder &)> access);

  /// Emits an assertion before `op` that each index is in its range; null if
  /// unchecked.
  Value checkRange(Operation *op, ValueRange zeroBased,
                   ArrayRef<OpFoldResult> extents, const Twine &what,
                   ValueRange shown);
  /// The same for the element of a field, and the components in it.
  Value checkElement(FieldAccessOpInterface op, const FieldInfo &field,
                     ValueRange zeroBased);

private:
  Value checkCasts(OpBuilder &builder, Location loc, ValueRange indices,
                   const Twine &what);

  FunctionOpInterface function;
  FieldTable &fields;
  AccessGroups &groups;
  bool boundsCheck, onDevice;
  llvm::DenseMap<const FieldInfo *, Value> bases;
  llvm::DenseMap<Operation *, Value> trees;
};

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_LAYOUTTORT_ACCESSLOWERING_H
