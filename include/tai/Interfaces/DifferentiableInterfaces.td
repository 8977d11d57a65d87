//===- DifferentiableInterfaces.td - What can be differentiated -*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
// The interfaces through which an op takes part in differentiation. A dialect
// makes its ops differentiable by implementing one of them, or by attaching an
// external model; no pass holds a list of ops.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_INTERFACES_DIFFERENTIABLEINTERFACES_TD
#define TAI_INTERFACES_DIFFERENTIABLEINTERFACES_TD

include "mlir/IR/OpBase.td"

def Tai_DifferentiableOpInterface : OpInterface<"DifferentiableOpInterface"> {
  let cppNamespace = "::mlir::tai";
  let description = [{
    An op that computes values from values and has a derivative. Its effects,
    if any, do not concern the derivative.
  }];
  let methods = [
    InterfaceMethod<[{
        Adds to the adjoint of each active operand what the adjoints of the
        results contribute. Called once, when the adjoints of all results are
        complete and at least one of them is not zero.
      }],
      "::llvm::LogicalResult", "buildAdjoint",
      (ins "::mlir::tai::AdjointBuilder &":$adjoint)>,
    InterfaceMethod<[{
        Sets the tangents of the results to what the tangents of the operands
        make them; see `TangentBuilder`. Called where at least one operand may
        have a tangent. The default says that there is no rule.
      }],
      "::llvm::LogicalResult", "buildTangent",
      (ins "::mlir::tai::TangentBuilder &":$tangent), "", [{
        return ::mlir::tai::refuseTangent($_op, tangent);
      }]>,
    InterfaceMethod<[{
        True if a small change of the operand changes a result. The default
        says so of floats: conversions to integers and comparisons say no.
      }],
      "bool", "carriesDerivative", (ins "::mlir::OpOperand &":$operand), "", [{
        return ::mlir::tai::isFloatOrVector(operand.get().getType());
      }]>,
  ];
}

def Tai_AdjointLoopInterface : OpInterface<"AdjointLoopInterface"> {
  let cppNamespace = "::mlir::tai";
  let description = [{
    A loop or a branch: an op that runs its regions and may pass values through
    them.
  }];
  let methods = [
    InterfaceMethod<[{
        Builds the op that runs the reverse of the regions, in reverse order
        where one iteration can depend on another. Called where the regions
        hold an active access, or a result has an adjoint.
      }],
      "::llvm::LogicalResult", "buildReverse",
      (ins "::mlir::tai::AdjointBuilder &":$adjoint)>,
    InterfaceMethod<[{
        Gives the op, which stands in the kernel that is being extended by
        tangents, the tangents of what it passes on, and extends its regions.
        The default does so where nothing that is passed on has a tangent.
      }],
      "::llvm::LogicalResult", "buildTangent",
      (ins "::mlir::tai::TangentBuilder &":$tangent), "", [{
        return ::mlir::tai::extendRegions($_op, tangent);
      }]>,
    InterfaceMethod<"True if iterations may run at the same time.",
      "bool", "runsInParallel", (ins), "", "return false;">,
  ];
}

def Tai_DifferentiableAccessInterface
    : OpInterface<"DifferentiableAccessInterface"> {
  let cppNamespace = "::mlir::tai";
  let description = [{
    An op that reads or writes one element of a field or of a memref.
  }];
  let methods = [
    InterfaceMethod<"What the op does to the element.",
      "::mlir::tai::AccessKind", "getAccessKind">,
    InterfaceMethod<"Where the element is.",
      "::mlir::tai::Storage", "getAccessedStorage">,
    InterfaceMethod<"The indices of the element.",
      "::mlir::OperandRange", "getAccessIndices">,
    InterfaceMethod<[{
        The indices of the component of the element, where only one is
        accessed.
      }],
      "::mlir::ValueRange", "getAccessComponents", (ins), "",
      "return ::mlir::ValueRange();">,
    InterfaceMethod<"The value read or written.",
      "::mlir::Value", "getAccessedValue">,
    InterfaceMethod<"True if the value is subtracted (accumulations only).",
      "bool", "isNegated", (ins), "", "return false;">,
    InterfaceMethod<[{
        Reads the same element of `storage`, which holds adjoints, at the given
        indices.
      }],
      "::mlir::Value", "createAdjointRead",
      (ins "::mlir::OpBuilder &":$builder, "::mlir::tai::Storage":$storage,
           "::mlir::ValueRange":$indices, "::mlir::ValueRange":$components)>,
    InterfaceMethod<[{
        Adds `value` to the same element of `storage`, which holds adjoints.
      }],
      "void", "createAdjointAccumulate",
      (ins "::mlir::OpBuilder &":$builder, "::mlir::Value":$value,
           "::mlir::tai::Storage":$storage, "::mlir::ValueRange":$indices,
           "::mlir::ValueRange":$components)>,
    InterfaceMethod<[{
        Stores `value` to the same element of `storage`, which may be that of
        the access itself.
      }],
      "void", "createAdjointStore",
      (ins "::mlir::OpBuilder &":$builder, "::mlir::Value":$value,
           "::mlir::tai::Storage":$storage, "::mlir::ValueRange":$indices,
           "::mlir::ValueRange":$components)>,
    InterfaceMethod<[{
        Does to `storage`, which holds tangents, what makes it hold the tangent
        of the element after the access, and sets the tangent of what the
        access yields. The default says that there is no rule.
      }],
      "::llvm::LogicalResult", "buildTangent",
      (ins "::mlir::tai::TangentBuilder &":$tangent,
           "::mlir::tai::Storage":$storage), "", [{
        return ::mlir::tai::refuseTangent($_op, tangent);
      }]>,
  ];
}

#endif // TAI_INTERFACES_DIFFERENTIABLEINTERFACES_TD
