//===- FieldAccessInterface.td - Accesses to fields --------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
// The interface of ops that access a field. Passes treat all ops that implement
// it, of any dialect, as accesses of a kernel.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_INTERFACES_FIELDACCESSINTERFACE_TD
#define TAI_INTERFACES_FIELDACCESSINTERFACE_TD

include "mlir/IR/OpBase.td"

def Tai_FieldAccessOpInterface : OpInterface<"FieldAccessOpInterface"> {
  let cppNamespace = "::mlir::tai";
  let description = [{
    An op that accesses one element of a field, or the cells above it.

    1. (field_access_c1) `getFieldAttr` names a `tai.field`.
    2. (field_access_c2) `getIndices` has an index for each dimension of the field; of
       an op on a list, all but that of the list.
    3. (field_access_c3) The effects of the op are on the symbol of the field, as
       `addFieldEffects` gives them: accesses to distinct fields commute.
  }];
  let methods = [
    InterfaceMethod<"The field that is accessed.",
      "::mlir::FlatSymbolRefAttr", "getFieldAttr">,
    InterfaceMethod<"The indices of the element.",
      "::mlir::OperandRange", "getIndices">,
    InterfaceMethod<[{
        The indices of the component of the element, where only one is
        accessed.
      }],
      "::mlir::OperandRange", "getComponents", (ins), "",
      "return $_op->getOperands().take_front(0);">,
    InterfaceMethod<"The kind of the access.",
      "::mlir::tai::FieldAccess", "getFieldAccess">,
    InterfaceMethod<[{
        The value that is read, written, or combined into the element; null for
        accesses to cells.
      }],
      "::mlir::Value", "getAccessedValue", (ins), "",
      "return ::mlir::Value();">,
  ];
  let extraSharedClassDeclaration = [{
    /// True if the op reads or writes an element, not only cells.
    bool isElementAccess() {
      return ::mlir::tai::isElementAccess($_op.getFieldAccess());
    }
    /// True if the op's result depends on the field.
    bool readsField() {
      return ::mlir::tai::readsField($_op.getFieldAccess());
    }
    /// True if the op changes the field, or which of its cells are active.
    bool writesField() {
      return ::mlir::tai::writesField($_op.getFieldAccess());
    }
  }];
}

#endif // TAI_INTERFACES_FIELDACCESSINTERFACE_TD
