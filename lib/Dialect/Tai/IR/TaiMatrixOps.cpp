//===- TaiMatrixOps.cpp - Small vectors and matrices ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Shape rules of the matrix ops.
//
//===----------------------------------------------------------------------===//

#include "mlir/IR/Builders.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

/// Checks that the matrix type `type` is square and has between `low` and
/// `high` rows.
static LogicalResult verifySquare(Operation *op, Type type, int64_t low,
                                  int64_t high) {
  auto matrix = cast<VectorType>(type);
  int64_t size = matrix.getDimSize(0);
  if (matrix.getDimSize(1) == size && size >= low && size <= high)
    return success();
  InFlightDiagnostic diag = op->emitOpError("expects a square matrix of size ");
  diag << low;
  if (high != low)
    diag << " to " << high;
  return diag << ", but got " << type;
}

/// Checks that the result of `op` has the given shape, and the element type of
/// `operand`.
static LogicalResult verifyResult(Operation *op, ArrayRef<int64_t> shape,
                                  VectorType operand) {
  auto expected = VectorType::get(shape, operand.getElementType());
  Type actual = op->getResult(0).getType();
  if (actual == expected)
    return success();
  return op->emitOpError("expects a result of type ")
         << expected << ", but got " << actual;
}

LogicalResult MatmulOp::verify() {
  auto lhs = cast<VectorType>(getLhs().getType());
  auto rhs = cast<VectorType>(getRhs().getType());
  if (lhs.getDimSize(1) != rhs.getDimSize(0))
    return emitOpError("expects as many rows in the right operand as columns "
                       "in the left, but got ")
           << lhs << " and " << rhs;
  if (lhs.getElementType() != rhs.getElementType())
    return emitOpError("expects operands of one element type, but got ")
           << lhs.getElementType() << " and " << rhs.getElementType();
  SmallVector<int64_t> shape{lhs.getDimSize(0)};
  if (rhs.getRank() == 2)
    shape.push_back(rhs.getDimSize(1));
  return verifyResult(*this, shape, lhs);
}

LogicalResult TransposeOp::verify() {
  auto type = cast<VectorType>(getMatrix().getType());
  return verifyResult(*this, {type.getDimSize(1), type.getDimSize(0)}, type);
}

OpFoldResult TransposeOp::fold(FoldAdaptor) {
  // (Aᵀ)ᵀ = A.
  if (auto inner = getMatrix().getDefiningOp<TransposeOp>())
    return inner.getMatrix();
  return {};
}

LogicalResult CrossOp::verify() {
  auto type = cast<VectorType>(getLhs().getType());
  if (type.getDimSize(0) == 3)
    return success();
  return emitOpError("expects vectors of 3 components, but got ") << type;
}

LogicalResult OuterOp::verify() {
  auto lhs = cast<VectorType>(getLhs().getType());
  auto rhs = cast<VectorType>(getRhs().getType());
  if (lhs.getElementType() != rhs.getElementType())
    return emitOpError("expects operands of one element type, but got ")
           << lhs.getElementType() << " and " << rhs.getElementType();
  return verifyResult(*this, {lhs.getDimSize(0), rhs.getDimSize(0)}, lhs);
}

LogicalResult TraceOp::verify() {
  auto type = cast<VectorType>(getMatrix().getType());
  if (type.getDimSize(0) == type.getDimSize(1))
    return success();
  return emitOpError("expects a square matrix, but got ") << type;
}

LogicalResult DeterminantOp::verify() {
  return verifySquare(*this, getMatrix().getType(), 1, 4);
}
LogicalResult InverseOp::verify() {
  return verifySquare(*this, getMatrix().getType(), 1, 4);
}
LogicalResult PolarOp::verify() {
  return verifySquare(*this, getMatrix().getType(), 2, 3);
}
LogicalResult SvdOp::verify() {
  return verifySquare(*this, getMatrix().getType(), 2, 3);
}

LogicalResult SolveOp::verify() {
  auto matrix = cast<VectorType>(getMatrix().getType());
  if (failed(verifySquare(*this, matrix, 1, 4)))
    return failure();
  auto rhs = cast<VectorType>(getRhs().getType());
  if (rhs == VectorType::get(matrix.getDimSize(0), matrix.getElementType()))
    return success();
  return emitOpError("expects a right side of ")
         << matrix.getDimSize(0) << " components of type "
         << matrix.getElementType() << ", but got " << rhs;
}

LogicalResult SymEigOp::verify() {
  auto matrix = cast<VectorType>(getMatrix().getType());
  if (failed(verifySquare(*this, matrix, 2, 3)))
    return failure();
  return verifyResult(*this, {matrix.getDimSize(0)}, matrix);
}
