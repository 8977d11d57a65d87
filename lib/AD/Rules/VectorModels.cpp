//===- VectorModels.cpp - Derivatives of the vector dialect ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Ops that move components around. Their adjoints move components back, one by
// one where positions are static: the adjoint of an unused component then stays
// a zero that is never added to anything.
//
//===----------------------------------------------------------------------===//

#include "Models.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "tai/AD/Reverse/AdjointBuilder.h"

using namespace mlir;
using namespace mlir::tai;

namespace {

/// A static position selects a slice of the vector. Returns the row-major
/// number of the first component of the slice, and its number of components.
std::pair<int64_t, int64_t> getComponents(VectorType type,
                                          ArrayRef<int64_t> position) {
  int64_t first = 0, count = 1;
  for (auto [dim, extent] : llvm::enumerate(type.getShape())) {
    bool isGiven = dim < position.size();
    first = first * extent + (isGiven ? position[dim] : 0);
    count *= isGiven ? 1 : extent;
  }
  return {first, count};
}

/// True if a position is poison (`vector.extract %v[-1]`): the result does not
/// depend on the operands.
bool isPoison(ArrayRef<int64_t> position) {
  return llvm::is_contained(position, vector::ExtractOp::kPoisonIndex);
}

/// Adds `components` to the adjoint of `to`, from component `toFirst` on.
void addComponents(AdjointBuilder &b, Value to, int64_t toFirst,
                   ArrayRef<Value> components) {
  if (!isa<VectorType>(to.getType())) {
    b.addAdjoint(to, components.front());
    return;
  }
  for (auto [i, component] : llvm::enumerate(components))
    b.addAdjointComponent(to, toFirst + i, component);
}

/// The model of a linear op: applied to the tangents of its operands, the op
/// yields the tangent of its result.
template <typename Model, typename Op>
struct LinearModel : DifferentiableOpInterface::ExternalModel<Model, Op> {
  LogicalResult buildTangent(Operation *op, TangentBuilder &b) const {
    b.applyToTangents(op);
    return success();
  }
};

struct BroadcastModel : LinearModel<BroadcastModel, vector::BroadcastOp> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &b) const {
    auto broadcast = cast<vector::BroadcastOp>(op);
    Value source = broadcast.getSource();
    auto type = cast<VectorType>(broadcast.getType());
    SmallVector<Value> seeds = b.getAdjointComponents(broadcast);
    auto from = dyn_cast<VectorType>(source.getType());
    if (!from) {
      for (Value seed : seeds)
        b.addAdjoint(source, seed);
      return success();
    }
    // A broadcast adds leading dimensions and repeats dimensions of extent 1.
    for (int64_t i = 0, e = type.getNumElements(); i != e; ++i) {
      int64_t rest = i, component = 0, stride = 1;
      for (int64_t dim = type.getRank() - 1,
                   lead = type.getRank() - from.getRank();
           dim >= lead; --dim) {
        int64_t digit = rest % type.getDimSize(dim);
        rest /= type.getDimSize(dim);
        int64_t extent = from.getDimSize(dim - lead);
        component += (extent == 1 ? 0 : digit) * stride;
        stride *= extent;
      }
      b.addAdjointComponent(source, component, seeds[i]);
    }
    return success();
  }
};

struct ExtractModel : LinearModel<ExtractModel, vector::ExtractOp> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &b) const {
    auto extract = cast<vector::ExtractOp>(op);
    Value source = extract.getSource();
    VectorType type = extract.getSourceVectorType();
    if (isPoison(extract.getStaticPosition()))
      return success();
    if (extract.hasDynamicPosition()) {
      SmallVector<OpFoldResult> position;
      for (OpFoldResult index : extract.getMixedPosition()) {
        if (auto value = dyn_cast<Value>(index))
          index = b.getPrimal(value);
        position.push_back(index);
      }
      b.addAdjoint(source,
                   vector::InsertOp::create(b, b.getAdjoint(extract),
                                            b.createZero(type), position));
      return success();
    }
    auto [first, count] = getComponents(type, extract.getStaticPosition());
    if (isa<VectorType>(extract.getType()))
      addComponents(b, source, first, b.getAdjointComponents(extract));
    else
      addComponents(b, source, first, b.getAdjoint(extract));
    return success();
  }
};

struct InsertModel : LinearModel<InsertModel, vector::InsertOp> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &b) const {
    auto insert = cast<vector::InsertOp>(op);
    Value value = insert.getValueToStore();
    if (isPoison(insert.getStaticPosition()))
      return success();
    if (insert.hasDynamicPosition()) {
      SmallVector<OpFoldResult> position;
      for (OpFoldResult index : insert.getMixedPosition()) {
        if (auto dynamic = dyn_cast<Value>(index))
          index = b.getPrimal(dynamic);
        position.push_back(index);
      }
      Value seed = b.getAdjoint(insert);
      b.addAdjoint(value, vector::ExtractOp::create(b, seed, position));
      Value zero = b.createZero(value.getType());
      b.addAdjoint(insert.getDest(),
                   vector::InsertOp::create(b, zero, seed, position));
      return success();
    }
    SmallVector<Value> seeds = b.getAdjointComponents(insert);
    auto [first, count] =
        getComponents(insert.getDestVectorType(), insert.getStaticPosition());
    addComponents(b, value, 0, ArrayRef(seeds).slice(first, count));
    std::fill_n(seeds.begin() + first, count, Value());
    addComponents(b, insert.getDest(), 0, seeds);
    return success();
  }
};

struct FromElementsModel
    : LinearModel<FromElementsModel, vector::FromElementsOp> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &b) const {
    SmallVector<Value> seeds = b.getAdjointComponents(op->getResult(0));
    for (auto [element, seed] : llvm::zip(op->getOperands(), seeds))
      b.addAdjoint(element, seed);
    return success();
  }
};

struct ToElementsModel : LinearModel<ToElementsModel, vector::ToElementsOp> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &b) const {
    for (OpResult element : op->getResults())
      b.addAdjointComponent(op->getOperand(0), element.getResultNumber(),
                            b.getAdjoint(element));
    return success();
  }
};

struct ShapeCastModel : LinearModel<ShapeCastModel, vector::ShapeCastOp> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &b) const {
    addComponents(b, op->getOperand(0), 0,
                  b.getAdjointComponents(op->getResult(0)));
    return success();
  }
};

struct ShuffleModel : LinearModel<ShuffleModel, vector::ShuffleOp> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &b) const {
    auto shuffle = cast<vector::ShuffleOp>(op);
    // The mask of a shuffle selects along the leading dimension; each entry
    // moves a slice.
    VectorType first = shuffle.getV1VectorType();
    int64_t extent = first.getRank() ? first.getDimSize(0) : 1;
    int64_t slice = first.getNumElements() / extent;
    SmallVector<Value> seeds = b.getAdjointComponents(shuffle);
    for (auto [i, from] : llvm::enumerate(shuffle.getMask())) {
      if (from < 0)
        continue; // poison
      Value source = from < extent ? shuffle.getV1() : shuffle.getV2();
      int64_t row = from < extent ? from : from - extent;
      addComponents(b, source, row * slice,
                    ArrayRef(seeds).slice(i * slice, slice));
    }
    return success();
  }
};

struct TransposeModel : LinearModel<TransposeModel, vector::TransposeOp> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &b) const {
    auto transpose = cast<vector::TransposeOp>(op);
    VectorType from = transpose.getSourceVectorType();
    VectorType to = transpose.getResultVectorType();
    ArrayRef<int64_t> permutation = transpose.getPermutation();
    SmallVector<int64_t> strides(from.getRank(), 1);
    for (int64_t dim = from.getRank() - 2; dim >= 0; --dim)
      strides[dim] = strides[dim + 1] * from.getDimSize(dim + 1);
    SmallVector<Value> seeds = b.getAdjointComponents(transpose);
    for (auto [i, seed] : llvm::enumerate(seeds)) {
      int64_t rest = i, component = 0;
      for (int64_t dim = to.getRank() - 1; dim >= 0; --dim) {
        component += rest % to.getDimSize(dim) * strides[permutation[dim]];
        rest /= to.getDimSize(dim);
      }
      b.addAdjointComponent(transpose.getVector(), component, seed);
    }
    return success();
  }
};

/// Rules of vector.reduction: the sum, product, least or greatest of the
/// components. In a tie the derivative goes to the last component, as
/// `arith.maximumf` gives it to the second operand, or is shared.
struct ReductionModel
    : DifferentiableOpInterface::ExternalModel<ReductionModel,
                                               vector::ReductionOp> {
  using Kind = vector::CombiningKind;

  /// For minimum and maximum: a comparison of an operand with the result that
  /// holds only if the operand is the extreme value.
  static arith::CmpFPredicate getPredicate(Kind kind) {
    bool isMax = kind == Kind::MAXIMUMF || kind == Kind::MAXNUMF;
    return isMax ? arith::CmpFPredicate::OGE : arith::CmpFPredicate::OLE;
  }
  /// For each operand of a minimum or maximum, emits a test whether it equals
  /// `result`; also emits the number of operands that do.
  static std::pair<SmallVector<Value>, Value>
  findWinners(DerivativeBuilder &b, Kind kind, ArrayRef<Value> operands,
              Value result) {
    SmallVector<Value> all;
    Value one = b.createConstant(result.getType(), 1), count;
    for (Value operand : operands) {
      all.push_back(
          arith::CmpFOp::create(b, getPredicate(kind), operand, result));
      Value own = b.createMask(all.back(), one);
      count = count ? Value(arith::AddFOp::create(b, count, own)) : own;
    }
    return {all, count};
  }

  LogicalResult buildTangent(Operation *op, TangentBuilder &b) const {
    auto reduction = cast<vector::ReductionOp>(op);
    Kind kind = reduction.getKind();
    if (kind == Kind::ADD) {
      b.applyToTangents(op);
      return success();
    }
    Value vector = reduction.getVector(), acc = reduction.getAcc();
    SmallVector<Value> operands, tangents;
    Value all = b.getTangentOrZero(vector);
    auto type = cast<VectorType>(vector.getType());
    for (int64_t i = 0, e = type.getNumElements(); i != e; ++i) {
      operands.push_back(b.createExtract(vector, i));
      tangents.push_back(b.createExtract(all, i));
    }
    if (acc) {
      operands.push_back(acc);
      tangents.push_back(b.getTangentOrZero(acc));
    }
    Value result = reduction.getDest(), sum, product;
    if (kind == Kind::MUL) {
      bool isGuarded = mayBeNonFinite(reduction, b);
      auto guard = [&](Value tangent, Value term) {
        return isGuarded ? b.createGuard(tangent, term) : term;
      };
      for (auto [operand, tangent] : llvm::zip(operands, tangents)) {
        if (!sum) {
          sum = tangent;
          product = operand;
          continue;
        }
        Value kept = guard(sum, arith::MulFOp::create(b, sum, operand));
        Value added =
            guard(tangent, arith::MulFOp::create(b, product, tangent));
        sum = arith::AddFOp::create(b, kept, added);
        product = arith::MulFOp::create(b, product, operand);
      }
    } else if (b.getConventions().splitTies) {
      auto [wins, count] = findWinners(b, kind, operands, result);
      for (auto [isOne, tangent] : llvm::zip(wins, tangents)) {
        Value own = b.createMask(isOne, tangent);
        sum = sum ? Value(arith::AddFOp::create(b, sum, own)) : own;
      }
      sum = arith::DivFOp::create(b, sum, count);
    } else {
      sum = tangents.front();
      for (auto [operand, tangent] :
           llvm::drop_begin(llvm::zip(operands, tangents))) {
        Value wins =
            arith::CmpFOp::create(b, getPredicate(kind), operand, result);
        sum = arith::SelectOp::create(b, wins, tangent, sum);
      }
    }
    b.setTangent(result, sum);
    return success();
  }
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &b) const {
    auto reduction = cast<vector::ReductionOp>(op);
    Kind kind = reduction.getKind();
    Value seed = b.getAdjoint(reduction.getDest());
    Value vector = reduction.getVector(), acc = reduction.getAcc();
    auto type = cast<VectorType>(vector.getType());
    if (kind == Kind::ADD) {
      b.addAdjoint(vector, vector::BroadcastOp::create(b, type, seed));
      if (acc)
        b.addAdjoint(acc, seed);
      return success();
    }
    Value primal = b.getPrimal(vector);
    SmallVector<Value> operands, seeds;
    for (int64_t i = 0, e = type.getNumElements(); i != e; ++i)
      operands.push_back(b.createExtract(primal, i));
    if (acc)
      operands.push_back(b.getPrimal(acc));
    if (kind == Kind::MUL) {
      // The seed of a factor of a product is the product of all other factors:
      // those before it times those after it.
      Value before = seed;
      for (Value operand : operands) {
        seeds.push_back(before);
        before = arith::MulFOp::create(b, before, operand);
      }
      Value after;
      for (size_t i = operands.size(); i-- != 0;) {
        if (after)
          seeds[i] = arith::MulFOp::create(b, seeds[i], after);
        after = after ? Value(arith::MulFOp::create(b, after, operands[i]))
                      : operands[i];
      }
      if (mayBeNonFinite(reduction, b))
        for (Value &contribution : seeds)
          contribution = b.createGuard(seed, contribution);
    } else if (b.getConventions().splitTies) {
      auto [wins, count] =
          findWinners(b, kind, operands, b.getPrimal(reduction.getDest()));
      Value share = arith::DivFOp::create(b, seed, count);
      for (Value isOne : wins)
        seeds.push_back(b.createMask(isOne, share));
    } else {
      Value result = b.getPrimal(reduction.getDest());
      Value rest = seed;
      for (Value operand : llvm::reverse(operands)) {
        Value wins =
            arith::CmpFOp::create(b, getPredicate(kind), operand, result);
        seeds.push_back(b.createMask(wins, rest));
        rest = arith::SelectOp::create(b, wins, b.createZero(rest.getType()),
                                       rest);
      }
      std::reverse(seeds.begin(), seeds.end());
    }
    for (int64_t i = 0, e = type.getNumElements(); i != e; ++i)
      b.addAdjointComponent(vector, i, seeds[i]);
    if (acc)
      b.addAdjoint(acc, seeds.back());
    return success();
  }

private:
  /// True if a factor of the product may be infinite, so that a zero seed times
  /// this factor would be NaN.
  static bool mayBeNonFinite(vector::ReductionOp op, DerivativeBuilder &b) {
    Value acc = op.getAcc();
    return b.getFacts().mayBeNonFinite(op.getVector()) ||
           (acc && b.getFacts().mayBeNonFinite(acc));
  }
};
} // namespace

void mlir::tai::registerVectorModels(DialectRegistry &registry) {
  registry.addExtension(+[](MLIRContext *context, vector::VectorDialect *) {
    vector::BroadcastOp::attachInterface<BroadcastModel>(*context);
    vector::ExtractOp::attachInterface<ExtractModel>(*context);
    vector::InsertOp::attachInterface<InsertModel>(*context);
    vector::FromElementsOp::attachInterface<FromElementsModel>(*context);
    vector::ToElementsOp::attachInterface<ToElementsModel>(*context);
    vector::ShapeCastOp::attachInterface<ShapeCastModel>(*context);
    vector::ShuffleOp::attachInterface<ShuffleModel>(*context);
    vector::TransposeOp::attachInterface<TransposeModel>(*context);
    vector::ReductionOp::attachInterface<ReductionModel>(*context);
  });
}
