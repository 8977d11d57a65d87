//===- DifferentiableInterfaces.td - Derivatives of ops ----*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
// The interfaces of differentiable ops. A dialect makes an op differentiable by
// implementing one of these interfaces, or by attaching an external model; no
// pass has a list of ops.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_INTERFACES_DIFFERENTIABLEINTERFACES_TD
#define TAI_INTERFACES_DIFFERENTIABLEINTERFACES_TD

include "mlir/IR/OpBase.td"

def Tai_DifferentiableOpInterface : OpInterface<"DifferentiableOpInterface"> {
  let cppNamespace = "::mlir::tai";
  let description = [{
    An op that computes values from values and has a derivative. Its side
    effects, if any, are irrelevant to the derivative.
  }];
  let methods = [
    InterfaceMethod<[{
        Adds to the adjoint of each active operand the contributions of the
        results' adjoints. Called once, when the adjoints of all results are
        complete and at least one of them is not zero.
      }],
      "::llvm::LogicalResult", "buildAdjoint",
      (ins "::mlir::tai::AdjointBuilder &":$adjoint)>,
    InterfaceMethod<[{
        Sets the tangents of the results, from the tangents of the operands; see
        `TangentBuilder`. Called if at least one operand may have a tangent. The
        default reports that there is no rule.
      }],
      "::llvm::LogicalResult", "buildTangent",
      (ins "::mlir::tai::TangentBuilder &":$tangent), "", [{
        return ::mlir::tai::refuseTangent($_op, tangent);
      }]>,
    InterfaceMethod<[{
        True if the derivative of a result with respect to the operand may be
        non-zero. The default is true for floats: conversions to integers and
        comparisons override it.
      }],
      "bool", "carriesDerivative", (ins "::mlir::OpOperand &":$operand), "", [{
        return ::mlir::tai::isFloatOrVector(operand.get().getType());
      }]>,
  ];
}

def Tai_AdjointLoopInterface : OpInterface<"AdjointLoopInterface"> {
  let cppNamespace = "::mlir::tai";
  let description = [{
    A loop or a branch: an op that runs its regions and may forward values to
    and from them.
  }];
  let methods = [
    InterfaceMethod<[{
        Builds the op that runs the reverse of the regions, in reverse order if
        iterations can depend on each other. Called if the regions hold an
        active access, or a result has an adjoint.
      }],
      "::llvm::LogicalResult", "buildReverse",
      (ins "::mlir::tai::AdjointBuilder &":$adjoint)>,
    InterfaceMethod<[{
        Extends the op, in the kernel that is being extended by tangents, to
        forward tangents with the values that it forwards, and extends its
        regions. The default is for ops whose forwarded values have no tangents.
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
    InterfaceMethod<"The kind of the access.",
      "::mlir::tai::AccessKind", "getAccessKind">,
    InterfaceMethod<"The field or memref of the element.",
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
        Updates `storage`, which holds tangents, to the tangent of the element
        after the access, and sets the tangents of the op's results. The default
        reports that there is no rule.
      }],
      "::llvm::LogicalResult", "buildTangent",
      (ins "::mlir::tai::TangentBuilder &":$tangent,
           "::mlir::tai::Storage":$storage), "", [{
        return ::mlir::tai::refuseTangent($_op, tangent);
      }]>,
  ];
}

#endif // TAI_INTERFACES_DIFFERENTIABLEINTERFACES_TD
