//===- TypeInference.cpp - Types of results -------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Upstream's builders in other languages, and its rewrites by patterns in IR,
// make an op from its operands if the op infers the types of its results. Ops
// whose results have the type of an operand, or of its elements, do so by their
// definition; here are those with results of another shape, and reads of locals
// and stacks.
//
//===----------------------------------------------------------------------===//

#include "OpModels.h"
#include "mlir/IR/Builders.h"
#include "mlir/Interfaces/InferTypeOpInterface.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

/// Returns `type` if it is a vector of `rank` dimensions, otherwise null.
static VectorType getVector(Type type, int64_t rank) {
  auto vector = dyn_cast<VectorType>(type);
  return vector && vector.getRank() == rank ? vector : VectorType();
}

namespace {
/// Each model below has `infer`, which adds the types of the results and leaves
/// `types` empty if the operands have none.
template <typename Model, typename Op>
struct InferModel : InferTypeOpInterface::ExternalModel<Model, Op> {
  static LogicalResult inferReturnTypes(MLIRContext *,
                                        std::optional<Location> location,
                                        ValueRange operands, DictionaryAttr,
                                        OpaqueProperties, RegionRange,
                                        SmallVectorImpl<Type> &types) {
    types.clear();
    Model::infer(operands.getTypes(), types);
    if (!types.empty())
      return success();
    return emitOptionalError(location, "'", Op::getOperationName(),
                             "' has no result for operands of types ",
                             operands.getTypes());
  }
  /// The verifier of the op names the type that it expects.
  static LogicalResult refineReturnTypes(MLIRContext *, std::optional<Location>,
                                         ValueRange, DictionaryAttr,
                                         OpaqueProperties, RegionRange,
                                         SmallVectorImpl<Type> &) {
    return success();
  }
  static bool isCompatibleReturnTypes(TypeRange one, TypeRange other) {
    return one == other;
  }
};

struct MatmulModel : InferModel<MatmulModel, MatmulOp> {
  static void infer(TypeRange operands, SmallVectorImpl<Type> &types) {
    VectorType matrix = getVector(operands[0], 2);
    auto other = dyn_cast<VectorType>(operands[1]);
    if (!matrix || !other || other.getRank() < 1 || other.getRank() > 2)
      return;
    SmallVector<int64_t> shape{matrix.getDimSize(0)};
    llvm::append_range(shape, other.getShape().drop_front());
    types.push_back(VectorType::get(shape, matrix.getElementType()));
  }
};

struct TransposeModel : InferModel<TransposeModel, TransposeOp> {
  static void infer(TypeRange operands, SmallVectorImpl<Type> &types) {
    if (VectorType matrix = getVector(operands[0], 2))
      types.push_back(
          VectorType::get({matrix.getDimSize(1), matrix.getDimSize(0)},
                          matrix.getElementType()));
  }
};

struct OuterModel : InferModel<OuterModel, OuterOp> {
  static void infer(TypeRange operands, SmallVectorImpl<Type> &types) {
    VectorType lhs = getVector(operands[0], 1), rhs = getVector(operands[1], 1);
    if (lhs && rhs)
      types.push_back(VectorType::get({lhs.getDimSize(0), rhs.getDimSize(0)},
                                      lhs.getElementType()));
  }
};

struct SymEigModel : InferModel<SymEigModel, SymEigOp> {
  static void infer(TypeRange operands, SmallVectorImpl<Type> &types) {
    if (VectorType matrix = getVector(operands[0], 2))
      types.append(
          {VectorType::get(matrix.getDimSize(0), matrix.getElementType()),
           matrix});
  }
};

struct LocalLoadModel : InferModel<LocalLoadModel, LocalLoadOp> {
  static void infer(TypeRange operands, SmallVectorImpl<Type> &types) {
    if (auto local = dyn_cast<LocalType>(operands[0]))
      types.push_back(local.getElementType());
  }
};

struct StackPopModel : InferModel<StackPopModel, StackPopOp> {
  static void infer(TypeRange operands, SmallVectorImpl<Type> &types) {
    if (auto stack = dyn_cast<StackType>(operands[0]))
      types.push_back(stack.getElementType());
  }
};
} // namespace

void tai::attachTypeInference(MLIRContext &context) {
  MatmulOp::attachInterface<MatmulModel>(context);
  TransposeOp::attachInterface<TransposeModel>(context);
  OuterOp::attachInterface<OuterModel>(context);
  SymEigOp::attachInterface<SymEigModel>(context);
  LocalLoadOp::attachInterface<LocalLoadModel>(context);
  StackPopOp::attachInterface<StackPopModel>(context);
}
