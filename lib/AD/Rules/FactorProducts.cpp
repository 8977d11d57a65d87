//===- FactorProducts.cpp - Tangents of products of U and V ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Near equal singular values, U and V have a common rotation proportional to 1
// / gap, on which products such as U Vᵀ and U Σ Vᵀ do not depend. By the
// product rule two large tangents would cancel after rounding. Here products of
// both factors are recognised, and their tangent is computed in the frame of
// the factors:
//   d(U M Vᵀ) = U ((E + O) M - M (E - O) + dM) Vᵀ,
// where [E, M] = E M - M E has the entries Eᵢⱼ (Mⱼⱼ - Mᵢᵢ) for a diagonal M,
// which are as accurate as the difference. For rounded squares the difference
// is not accurate, so products use [E, A B] = [E, A] B + A [E, B].
//
//===----------------------------------------------------------------------===//

#include "tai/AD/Rules/MatrixFormulas.h"

using namespace mlir;
using namespace mlir::tai;

/// Appends the factors of a chain of matrix products to `factors`, from left to
/// right. No product is taken apart once there are 64 factors: a power computed
/// by repeated squaring would have too many.
static void flatten(Value value, SmallVectorImpl<Value> &factors) {
  constexpr size_t most = 64;
  auto product = value.getDefiningOp<MatmulOp>();
  if (!product || factors.size() >= most)
    return factors.push_back(value);
  flatten(product.getLhs(), factors);
  flatten(product.getRhs(), factors);
}

/// Returns the decomposition op of which `value` is the factor U or V, or null.
static SvdOp getDecomposition(Value value) {
  auto svd = value.getDefiningOp<SvdOp>();
  return svd && value != svd.getSigma() ? svd : SvdOp();
}

namespace {
/// A pair of factors (U or V) of one singular value decomposition in a chain of
/// matrix products, by their positions in the chain.
struct FactorFrame {
  SvdOp svd;
  size_t first, last;
};

/// A matrix and its tangent, which is null for zero.
struct FactorPair {
  Value value, tangent;
};
} // namespace

static std::optional<FactorFrame> findFrame(ArrayRef<Value> factors) {
  for (size_t first = 0; first != factors.size(); ++first) {
    SvdOp svd = getDecomposition(factors[first]);
    if (!svd)
      continue;
    for (size_t last = factors.size() - 1; last != first; --last) {
      auto transpose = factors[last].getDefiningOp<TransposeOp>();
      if (transpose && getDecomposition(transpose.getMatrix()) == svd)
        return FactorFrame{svd, first, last};
    }
  }
  return std::nullopt;
}

static FactorPair multiply(TangentBuilder &b, const FactorPair &lhs,
                           const FactorPair &rhs) {
  if (!lhs.value)
    return rhs;
  Value left, right;
  if (lhs.tangent)
    left = createMatmul(b, lhs.tangent, rhs.value);
  if (rhs.tangent)
    right = createMatmul(b, lhs.value, rhs.tangent);
  return {createMatmul(b, lhs.value, rhs.value), addTerms(b, left, right)};
}

static FactorPair multiply(TangentBuilder &b, ArrayRef<Value> factors) {
  FactorPair product;
  for (Value factor : factors)
    product = multiply(b, product, {factor, b.getTangent(factor)});
  return product;
}

/// Emits E M - M E. Terms that cancel for a diagonal M are subtracted first.
static Value createCommutator(TangentBuilder &b, Value turn, Value matrix) {
  M e{&b, turn}, m{&b, matrix};
  int64_t n = getRows(turn);
  SmallVector<Value> entries;
  for (int64_t i = 0; i != n; ++i)
    for (int64_t j = 0; j != n; ++j) {
      Value sum;
      auto add = [&](S term) { sum = addTerms(b, sum, term.v); };
      // Entries (i, j) and (j, i) use the same difference, in the order in
      // which the divisor of E has it: of two orders, a target may fuse the
      // product of one with an addition and round the product of the other.
      if (int64_t low = std::min(i, j), high = std::max(i, j); low != high)
        add(e(low, high) * (m(high, high) - m(low, low)));
      for (int64_t k = 0; k != n; ++k) {
        if (k != i && k != j)
          add(e(i, k) * m(k, j) - m(i, k) * e(k, j));
        else if (i == j && k != i)
          add(e(i, k) * (m(k, i) + m(i, k)));
      }
      entries.push_back(sum);
    }
  return b.createVector(cast<VectorType>(turn.getType()), entries);
}

/// Emits the commutator E M - M E of the matrix E, which is `turn`, and the
/// product M of the matrices `factors`; null if there are no factors.
static Value createCommutator(TangentBuilder &b, Value turn,
                              ArrayRef<Value> factors) {
  Value sum, before;
  for (auto [number, factor] : llvm::enumerate(factors)) {
    Value term = createCommutator(b, turn, factor);
    if (before)
      term = createMatmul(b, before, term);
    for (Value after : factors.drop_front(number + 1))
      term = createMatmul(b, term, after);
    sum = addTerms(b, sum, term);
    before = before ? createMatmul(b, before, factor) : factor;
  }
  return sum;
}

/// Emits F M Hᵀ and its tangent, where F and H are factors of one
/// decomposition.
static FactorPair createCore(TangentBuilder &b, FactorFrame frame,
                             ArrayRef<Value> factors) {
  Value left = factors.front(), right = factors.back();
  bool leftIsU = left == frame.svd.getU();
  bool rightIsU =
      right.getDefiningOp<TransposeOp>().getMatrix() == frame.svd.getU();
  FactorRotations rotations = createFactorRotations(b, frame.svd);
  auto turnOf = [&](bool isU) -> Value {
    return isU ? rotations.odd : Value(arith::NegFOp::create(b, rotations.odd));
  };
  ArrayRef<Value> between = factors.drop_front().drop_back();
  FactorPair middle = multiply(b, between);
  Value inner;
  if (!middle.value) {
    // Uᵀ U and Vᵀ V are constant, so their tangents vanish.
    if (leftIsU != rightIsU)
      inner = arith::SubFOp::create(b, turnOf(leftIsU), turnOf(rightIsU));
  } else {
    Value even = createCommutator(b, rotations.even, between);
    Value odd =
        arith::SubFOp::create(b, createMatmul(b, turnOf(leftIsU), middle.value),
                              createMatmul(b, middle.value, turnOf(rightIsU)));
    inner = addTerms(b, addTerms(b, even, odd), middle.tangent);
  }
  Value start = middle.value ? createMatmul(b, left, middle.value) : left;
  FactorPair core = {createMatmul(b, start, right), Value()};
  if (inner)
    core.tangent = createMatmul(b, createMatmul(b, left, inner), right);
  return core;
}

Value mlir::tai::createFactorProductTangent(TangentBuilder &b,
                                            MatmulOp product) {
  SmallVector<Value> factors;
  flatten(product.getResult(), factors);
  std::optional<FactorFrame> frame = findFrame(factors);
  if (!frame || !b.getTangent(frame->svd.getMatrix()))
    return {};
  // Factors that may be infinite or NaN need the guards of the product rule.
  for (Value factor : factors) {
    auto svd = factor.getDefiningOp<SvdOp>();
    if (auto transpose = factor.getDefiningOp<TransposeOp>())
      svd = transpose.getMatrix().getDefiningOp<SvdOp>();
    if (svd != frame->svd && b.mayBeNonFinite(factor))
      return {};
  }
  ArrayRef<Value> all = factors;
  FactorPair result = multiply(b, all.take_front(frame->first));
  result = multiply(
      b, result,
      createCore(b, *frame,
                 all.slice(frame->first, frame->last - frame->first + 1)));
  for (Value factor : all.drop_front(frame->last + 1))
    result = multiply(b, result, {factor, b.getTangent(factor)});
  return result.tangent ? result.tangent : b.createZero(product.getType());
}
