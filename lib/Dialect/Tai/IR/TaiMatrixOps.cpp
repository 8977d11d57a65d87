//===- TaiMatrixOps.cpp - Small vectors and matrices ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Shape rules of the matrix ops, their result types, and folds. A fold replaces
// an op only where the result has the same bits.
//
//===----------------------------------------------------------------------===//

#include "mlir/IR/Builders.h"
#include "mlir/IR/PatternMatch.h"
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

/// Returns the type of the product of a matrix and a matrix or vector, or null
/// if there is none. Operands of other kinds are possible while an op is made.
static VectorType inferProduct(Type left, Type right) {
  auto lhs = dyn_cast<VectorType>(left), rhs = dyn_cast<VectorType>(right);
  if (!lhs || !rhs || lhs.getRank() != 2 || rhs.getRank() < 1 ||
      rhs.getRank() > 2)
    return {};
  SmallVector<int64_t> shape{lhs.getDimSize(0)};
  llvm::append_range(shape, rhs.getShape().drop_front());
  return VectorType::get(shape, lhs.getElementType());
}

static VectorType inferTranspose(Type type) {
  auto matrix = dyn_cast<VectorType>(type);
  if (!matrix || matrix.getRank() != 2)
    return {};
  return VectorType::get({matrix.getDimSize(1), matrix.getDimSize(0)},
                         matrix.getElementType());
}

static VectorType inferOuter(Type left, Type right) {
  auto lhs = dyn_cast<VectorType>(left), rhs = dyn_cast<VectorType>(right);
  if (!lhs || !rhs || lhs.getRank() != 1 || rhs.getRank() != 1)
    return {};
  return VectorType::get({lhs.getDimSize(0), rhs.getDimSize(0)},
                         lhs.getElementType());
}

/// Returns the type of the first column of a matrix, or null.
static VectorType inferColumn(Type type) {
  auto matrix = dyn_cast<VectorType>(type);
  if (!matrix || matrix.getRank() != 2)
    return {};
  return VectorType::get(matrix.getDimSize(0), matrix.getElementType());
}

/// Adds `type` to the inferred types of results; fails if it is null.
static LogicalResult addInferred(Type type, SmallVectorImpl<Type> &types) {
  if (!type)
    return failure();
  types.push_back(type);
  return success();
}

/// Checks that the first result of `op` has the type `expected`.
static LogicalResult verifyResult(Operation *op, VectorType expected) {
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
  return verifyResult(*this, inferProduct(lhs, rhs));
}

LogicalResult MatmulOp::inferReturnTypes(MLIRContext *, std::optional<Location>,
                                         ValueRange operands, DictionaryAttr,
                                         OpaqueProperties, RegionRange,
                                         SmallVectorImpl<Type> &types) {
  return addInferred(inferProduct(operands[0].getType(), operands[1].getType()),
                     types);
}

LogicalResult TransposeOp::verify() {
  return verifyResult(*this, inferTranspose(getMatrix().getType()));
}

LogicalResult TransposeOp::inferReturnTypes(MLIRContext *,
                                            std::optional<Location>,
                                            ValueRange operands, DictionaryAttr,
                                            OpaqueProperties, RegionRange,
                                            SmallVectorImpl<Type> &types) {
  return addInferred(inferTranspose(operands[0].getType()), types);
}

OpFoldResult TransposeOp::fold(FoldAdaptor adaptor) {
  // (Aᵀ)ᵀ = A.
  if (auto inner = getMatrix().getDefiningOp<TransposeOp>())
    return inner.getMatrix();
  auto matrix = dyn_cast_if_present<DenseElementsAttr>(adaptor.getMatrix());
  if (!matrix)
    return {};
  auto type = cast<VectorType>(getType());
  if (matrix.isSplat())
    return matrix.resizeSplat(type);
  SmallVector<Attribute> elements(matrix.getValues<Attribute>());
  SmallVector<Attribute> moved;
  int64_t rows = type.getDimSize(0), columns = type.getDimSize(1);
  for (int64_t row = 0; row < rows; ++row)
    for (int64_t column = 0; column < columns; ++column)
      moved.push_back(elements[column * rows + row]);
  return DenseElementsAttr::get(type, moved);
}

LogicalResult TransposeOp::canonicalize(TransposeOp op,
                                        PatternRewriter &rewriter) {
  // (a bᵀ)ᵀ = b aᵀ: the same products.
  auto outer = op.getMatrix().getDefiningOp<OuterOp>();
  if (!outer || !outer->hasOneUse())
    return failure();
  rewriter.replaceOpWithNewOp<OuterOp>(op, outer.getRhs(), outer.getLhs());
  return success();
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
  return verifyResult(*this, inferOuter(lhs, rhs));
}

LogicalResult OuterOp::inferReturnTypes(MLIRContext *, std::optional<Location>,
                                        ValueRange operands, DictionaryAttr,
                                        OpaqueProperties, RegionRange,
                                        SmallVectorImpl<Type> &types) {
  return addInferred(inferOuter(operands[0].getType(), operands[1].getType()),
                     types);
}

LogicalResult TraceOp::verify() {
  auto type = cast<VectorType>(getMatrix().getType());
  if (type.getDimSize(0) == type.getDimSize(1))
    return success();
  return emitOpError("expects a square matrix, but got ") << type;
}

OpFoldResult TraceOp::fold(FoldAdaptor) {
  // A matrix and its transpose have one diagonal.
  if (auto inner = getMatrix().getDefiningOp<TransposeOp>()) {
    getMatrixMutable().assign(inner.getMatrix());
    return getResult();
  }
  return {};
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
  return verifyResult(*this, inferColumn(matrix));
}

LogicalResult SymEigOp::inferReturnTypes(MLIRContext *, std::optional<Location>,
                                         ValueRange operands, DictionaryAttr,
                                         OpaqueProperties, RegionRange,
                                         SmallVectorImpl<Type> &types) {
  Type matrix = operands[0].getType();
  if (failed(addInferred(inferColumn(matrix), types)))
    return failure();
  types.push_back(matrix);
  return success();
}
