//===- MatrixModels.cpp - Derivatives of small matrix algebra -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Each rule states its formula: G is the adjoint of the result, R the result.
// A product with a primal value that may be infinite or NaN is guarded, so that
// a zero adjoint contributes zero there too.
//
//===----------------------------------------------------------------------===//

#include "Models.h"
#include "tai/AD/Rules/MatrixFormulas.h"

using namespace mlir;
using namespace mlir::tai;

Value mlir::tai::createBilinearTangent(
    TangentBuilder &b, Value lhs, Value rhs,
    function_ref<Value(Value, Value)> multiply,
    function_ref<Value(function_ref<Value(int64_t, int64_t)>)> expand) {
  Value sum;
  auto add = [&](Value of, Value other, bool isLeft) {
    Value tangent = b.getTangent(of);
    if (!tangent)
      return;
    bool mayBeNonFinite = b.getFacts().mayBeNonFinite(other);
    if (!mayBeNonFinite && !b.mayBeNonFinite(of)) {
      sum = addTerms(b, sum,
                     isLeft ? multiply(tangent, rhs) : multiply(lhs, tangent));
      return;
    }
    auto term = [&](int64_t i, int64_t j) {
      Value t = b.createExtract(tangent, isLeft ? i : j);
      Value p = b.createExtract(other, isLeft ? j : i);
      Value product = arith::MulFOp::create(b, t, p);
      if (mayBeNonFinite)
        product = b.createGuard(t, product);
      return b.mayBeNonFinite(of) ? b.createGuard(p, product) : product;
    };
    sum = addTerms(b, sum, expand(term));
  };
  add(lhs, rhs, /*isLeft=*/true);
  add(rhs, lhs, /*isLeft=*/false);
  return sum;
}

namespace {

/// Base of the models of ops with one result; Model::build gets the adjoint of
/// that result.
template <typename Model, typename OpTy>
struct MatrixModel : DifferentiableOpInterface::ExternalModel<Model, OpTy> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &b) const {
    static_cast<const Model *>(this)->build(cast<OpTy>(op), b,
                                            b.getAdjoint(op->getResult(0)));
    return success();
  }
  LogicalResult buildTangent(Operation *op, TangentBuilder &b) const {
    b.setTangent(op->getResult(0),
                 static_cast<const Model *>(this)->extend(cast<OpTy>(op), b));
    return success();
  }
};

/// Adjoint of the matrix product.
/// R = A B:  A* += G Bᵀ,  B* += Aᵀ G.
struct MatmulModel : MatrixModel<MatmulModel, MatmulOp> {
  void build(MatmulOp op, AdjointBuilder &b, Value g) const {
    Value lhs = op.getLhs(), rhs = op.getRhs();
    if (b.isActive(lhs)) {
      Value factor = b.getPrimal(rhs);
      Value product = cast<VectorType>(rhs.getType()).getRank() == 1
                          ? createOuter(b, g, factor)
                          : createMatmul(b, g, createTranspose(b, factor));
      b.addAdjoint(lhs, guardFor(b, rhs, g, product));
    }
    if (b.isActive(rhs)) {
      Value product = createMatmul(b, createTranspose(b, b.getPrimal(lhs)), g);
      b.addAdjoint(rhs, guardFor(b, lhs, g, product));
    }
  }
  /// Tangent of the matrix product R = A B:  Ṙ = Ȧ B + A Ḃ.
  Value extend(MatmulOp op, TangentBuilder &b) const {
    if (Value tangent = createFactorProductTangent(b, op))
      return tangent;
    Value lhs = op.getLhs(), rhs = op.getRhs();
    auto left = cast<VectorType>(lhs.getType());
    auto type = cast<VectorType>(op.getType());
    int64_t rows = left.getDimSize(0), inner = left.getDimSize(1);
    int64_t columns = type.getRank() == 1 ? 1 : type.getDimSize(1);
    return createBilinearTangent(
        b, lhs, rhs, [&](Value x, Value y) { return createMatmul(b, x, y); },
        [&](auto term) {
          SmallVector<Value> components;
          for (int64_t i = 0; i != rows; ++i)
            for (int64_t j = 0; j != columns; ++j) {
              Value sum;
              for (int64_t k = 0; k != inner; ++k)
                sum = addTerms(b, sum, term(i * inner + k, k * columns + j));
              components.push_back(sum);
            }
          return b.createVector(type, components);
        });
  }
};

/// Adjoint of the transpose.
/// R = Aᵀ:  A* += Gᵀ.
struct TransposeModel : MatrixModel<TransposeModel, TransposeOp> {
  void build(TransposeOp op, AdjointBuilder &b, Value g) const {
    b.addAdjoint(op.getMatrix(), createTranspose(b, g));
  }
  Value extend(TransposeOp op, TangentBuilder &b) const {
    return createTranspose(b, b.getTangent(op.getMatrix()));
  }
};

/// Adjoint of the dot product.
/// r = Σ aᵢ bᵢ:  a* += g b,  b* += g a.
struct DotModel : MatrixModel<DotModel, DotOp> {
  void build(DotOp op, AdjointBuilder &b, Value g) const {
    Value lhs = op.getLhs(), rhs = op.getRhs();
    for (auto [to, other] : {std::pair(lhs, rhs), std::pair(rhs, lhs)})
      if (b.isActive(to))
        b.addAdjoint(
            to, guardFor(b, other, g, createScaled(b, b.getPrimal(other), g)));
  }
  /// Tangent of the dot product:  ṙ = Σ ȧᵢ bᵢ + aᵢ ḃᵢ.
  Value extend(DotOp op, TangentBuilder &b) const {
    int64_t n = cast<VectorType>(op.getLhs().getType()).getNumElements();
    return createBilinearTangent(
        b, op.getLhs(), op.getRhs(),
        [&](Value x, Value y) -> Value {
          return DotOp::create(b, op.getType(), x, y);
        },
        [&](auto term) {
          Value sum;
          for (int64_t i = 0; i != n; ++i)
            sum = addTerms(b, sum, term(i, i));
          return sum;
        });
  }
};

/// Adjoint of the sum.
/// r = Σ aᵢ:  a* += g everywhere.
struct SumModel : MatrixModel<SumModel, SumOp> {
  void build(SumOp op, AdjointBuilder &b, Value g) const {
    b.addAdjoint(op.getVector(),
                 vector::BroadcastOp::create(b, op.getVector().getType(), g));
  }
  Value extend(SumOp op, TangentBuilder &b) const {
    return SumOp::create(b, op.getType(), b.getTangent(op.getVector()));
  }
};

/// Adjoint of the cross product.
/// R = a × b:  a* += b × G,  b* += G × a.
struct CrossModel : MatrixModel<CrossModel, CrossOp> {
  void build(CrossOp op, AdjointBuilder &b, Value g) const {
    Value lhs = op.getLhs(), rhs = op.getRhs();
    if (b.isActive(lhs))
      b.addAdjoint(
          lhs, guardFor(b, rhs, g,
                        CrossOp::create(b, g.getType(), b.getPrimal(rhs), g)));
    if (b.isActive(rhs))
      b.addAdjoint(
          rhs, guardFor(b, lhs, g,
                        CrossOp::create(b, g.getType(), g, b.getPrimal(lhs))));
  }
  /// Tangent of the cross product R = a × b:  Ṙ = ȧ × b + a × ḃ.
  Value extend(CrossOp op, TangentBuilder &b) const {
    auto type = cast<VectorType>(op.getType());
    return createBilinearTangent(
        b, op.getLhs(), op.getRhs(),
        [&](Value x, Value y) -> Value {
          return CrossOp::create(b, type, x, y);
        },
        [&](auto term) {
          SmallVector<Value> components;
          for (int64_t i = 0; i != 3; ++i) {
            int64_t j = (i + 1) % 3, k = (i + 2) % 3;
            components.push_back(
                arith::SubFOp::create(b, term(j, k), term(k, j)));
          }
          return b.createVector(type, components);
        });
  }
};

/// Adjoint of the outer product.
/// R = a bᵀ:  a* += G b,  b* += Gᵀ a.
struct OuterModel : MatrixModel<OuterModel, OuterOp> {
  void build(OuterOp op, AdjointBuilder &b, Value g) const {
    Value lhs = op.getLhs(), rhs = op.getRhs();
    if (b.isActive(lhs))
      b.addAdjoint(lhs, createMatmul(b, g, b.getPrimal(rhs)));
    if (b.isActive(rhs))
      b.addAdjoint(rhs,
                   createMatmul(b, createTranspose(b, g), b.getPrimal(lhs)));
  }
  /// Tangent of the outer product R = a bᵀ:  Ṙ = ȧ bᵀ + a ḃᵀ.
  Value extend(OuterOp op, TangentBuilder &b) const {
    auto type = cast<VectorType>(op.getType());
    return createBilinearTangent(
        b, op.getLhs(), op.getRhs(),
        [&](Value x, Value y) { return createOuter(b, x, y); },
        [&](auto term) {
          SmallVector<Value> components;
          for (int64_t i = 0; i != type.getDimSize(0); ++i)
            for (int64_t j = 0; j != type.getDimSize(1); ++j)
              components.push_back(term(i, j));
          return b.createVector(type, components);
        });
  }
};

/// Adjoint of the norm.
/// r = ‖a‖:  a* += g (a / r), and nothing where r = 0.
struct NormModel : MatrixModel<NormModel, NormOp> {
  void build(NormOp op, AdjointBuilder &b, Value g) const {
    Value vector = op.getVector(), a = b.getPrimal(vector);
    Value r = b.getPrimal(op.getResult());
    Value zero = b.createZero(r.getType());
    Value isZero = arith::CmpFOp::create(b, arith::CmpFPredicate::OEQ, r, zero);
    Value product;
    if (op.getFast()) {
      Value ratio = arith::SelectOp::create(b, isZero, zero,
                                            arith::DivFOp::create(b, g, r));
      product = createScaled(b, a, ratio);
    } else {
      // The components of a / r are at most 1, while g / r may overflow where g
      // (a / r) is finite. Where r = 0, a = 0 is divided by 1.
      Value one = b.createConstant(r.getType(), 1);
      Value divisor = arith::SelectOp::create(b, isZero, one, r);
      Value length = vector::BroadcastOp::create(b, a.getType(), divisor);
      product = createScaled(b, arith::DivFOp::create(b, a, length), g);
    }
    b.addAdjoint(vector, guardFor(b, vector, g, product));
  }

  /// Tangent of the norm r = ‖a‖:  ṙ = (a / r) · ȧ, and 0 where r = 0.
  Value extend(NormOp op, TangentBuilder &b) const {
    Value vector = op.getVector(), r = op.getResult();
    Value length = vector::BroadcastOp::create(b, vector.getType(), r);
    Value unit = arith::DivFOp::create(b, vector, length);
    Value isZero = arith::CmpFOp::create(b, arith::CmpFPredicate::OEQ, r,
                                         b.createZero(r.getType()));
    unit = arith::SelectOp::create(b, isZero, b.createZero(vector.getType()),
                                   unit);
    Value tangent = b.getTangent(vector);
    Value product = b.createProduct(
        vector, arith::MulFOp::create(b, unit, tangent),
        b.getFacts().mayBeNonFinite(vector), [&] { return unit; });
    return SumOp::create(b, r.getType(), product);
  }
};

/// No derivative passes.
struct StopGradientModel
    : DifferentiableOpInterface::ExternalModel<StopGradientModel,
                                               StopGradientOp> {
  LogicalResult buildAdjoint(Operation *, AdjointBuilder &) const {
    return success();
  }
  LogicalResult buildTangent(Operation *, TangentBuilder &) const {
    return success();
  }
  bool carriesDerivative(Operation *, OpOperand &) const { return false; }
};

/// Adjoint of an op whose result has the value of one operand.
/// R = A, and has the derivative of B:  B* += G.
struct DeriveAsModel
    : DifferentiableOpInterface::ExternalModel<DeriveAsModel, DeriveAsOp> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &b) const {
    auto derived = cast<DeriveAsOp>(op);
    b.addAdjoint(derived.getForm(), b.getAdjoint(derived.getResult()));
    return success();
  }
  LogicalResult buildTangent(Operation *op, TangentBuilder &b) const {
    auto derived = cast<DeriveAsOp>(op);
    b.setTangent(derived.getResult(), b.getTangent(derived.getForm()));
    return success();
  }
  bool carriesDerivative(Operation *, OpOperand &operand) const {
    return operand.getOperandNumber() == 1;
  }
};

/// Adjoint of the trace.
/// r = tr A:  the diagonal of A* += g.
struct TraceModel : MatrixModel<TraceModel, TraceOp> {
  void build(TraceOp op, AdjointBuilder &b, Value g) const {
    int64_t n = getRows(op.getMatrix());
    for (int64_t i = 0; i != n; ++i)
      b.addAdjointComponent(op.getMatrix(), i * n + i, g);
  }
  Value extend(TraceOp op, TangentBuilder &b) const {
    return TraceOp::create(b, op.getType(), b.getTangent(op.getMatrix()));
  }
};

/// Emits the determinant of the submatrix with these rows and columns, by
/// cofactors of its first row.
Value createMinor(DerivativeBuilder &b, Value matrix, ArrayRef<int64_t> rows,
                  ArrayRef<int64_t> columns) {
  int64_t n = getRows(matrix);
  if (rows.empty())
    return b.createConstant(getElementTypeOrSelf(matrix.getType()), 1);
  if (rows.size() == 1)
    return b.createExtract(matrix, rows[0] * n + columns[0]);
  Value sum;
  for (auto [k, column] : llvm::enumerate(columns)) {
    SmallVector<int64_t> rest(columns);
    rest.erase(rest.begin() + k);
    Value term =
        arith::MulFOp::create(b, b.createExtract(matrix, rows[0] * n + column),
                              createMinor(b, matrix, rows.drop_front(), rest));
    if (!sum)
      sum = term;
    else if (k % 2)
      sum = arith::SubFOp::create(b, sum, term);
    else
      sum = arith::AddFOp::create(b, sum, term);
  }
  return sum;
}

/// Emits the cofactors of a square matrix, in row-major order.
SmallVector<Value> createCofactors(DerivativeBuilder &b, Value matrix) {
  int64_t n = getRows(matrix);
  SmallVector<Value> cofactors;
  for (int64_t i = 0; i != n; ++i)
    for (int64_t j = 0; j != n; ++j) {
      SmallVector<int64_t> rows, columns;
      for (int64_t k = 0; k != n; ++k) {
        if (k != i)
          rows.push_back(k);
        if (k != j)
          columns.push_back(k);
      }
      Value minor = createMinor(b, matrix, rows, columns);
      if ((i + j) % 2)
        minor = arith::NegFOp::create(b, minor);
      cofactors.push_back(minor);
    }
  return cofactors;
}

/// Adjoint of the determinant.
/// r = det A:  A* += g cof A.
struct DeterminantModel : MatrixModel<DeterminantModel, DeterminantOp> {
  void build(DeterminantOp op, AdjointBuilder &b, Value g) const {
    Value matrix = op.getMatrix();
    SmallVector<Value> components = createCofactors(b, b.getPrimal(matrix));
    for (Value &component : components)
      component = arith::MulFOp::create(b, g, component);
    Value sum = b.createVector(cast<VectorType>(matrix.getType()), components);
    b.addAdjoint(matrix, guardFor(b, matrix, g, sum));
  }
  /// Tangent of the determinant r = det A:  ṙ = Σ cof(A)ᵢⱼ Ȧᵢⱼ.
  Value extend(DeterminantOp op, TangentBuilder &b) const {
    Value matrix = op.getMatrix(), tangent = b.getTangent(matrix);
    Value cofactors = b.createVector(cast<VectorType>(matrix.getType()),
                                     createCofactors(b, matrix));
    Value product = b.createProduct(
        matrix, arith::MulFOp::create(b, cofactors, tangent),
        b.getFacts().mayBeNonFinite(matrix), [&] { return cofactors; });
    return SumOp::create(b, op.getType(), product);
  }
};

/// Adjoint of the inverse.
/// R = A⁻¹:  A* -= Rᵀ G Rᵀ.
struct InverseModel : MatrixModel<InverseModel, InverseOp> {
  void build(InverseOp op, AdjointBuilder &b, Value g) const {
    Value t = createTranspose(b, b.getPrimal(op.getResult()));
    Value product = createMatmul(b, createMatmul(b, t, g), t);
    b.addAdjoint(op.getMatrix(),
                 createMatrixGuard(b, g, arith::NegFOp::create(b, product)));
  }
  /// Tangent of the inverse R = A⁻¹:  Ṙ = -R Ȧ R.
  Value extend(InverseOp op, TangentBuilder &b) const {
    Value r = op.getResult(), tangent = b.getTangent(op.getMatrix());
    Value product = createMatmul(b, createMatmul(b, r, tangent), r);
    return createMatrixGuard(b, tangent, arith::NegFOp::create(b, product));
  }
};

/// Adjoint of a linear solve.
/// A x = b:  b* += A⁻ᵀ G,  A* -= (A⁻ᵀ G) xᵀ.
struct SolveModel : MatrixModel<SolveModel, SolveOp> {
  void build(SolveOp op, AdjointBuilder &b, Value g) const {
    Value transposed = createTranspose(b, b.getPrimal(op.getMatrix()));
    Value solved =
        createMatrixGuard(b, g, SolveOp::create(b, g.getType(), transposed, g));
    b.addAdjoint(op.getRhs(), solved);
    if (!b.isActive(op.getMatrix()))
      return;
    Value product = createOuter(b, solved, b.getPrimal(op.getResult()));
    b.addAdjoint(op.getMatrix(),
                 createMatrixGuard(b, g, arith::NegFOp::create(b, product)));
  }
  /// Tangent of the solution x of A x = b:  ẋ = A⁻¹ (ḃ - Ȧ x).
  Value extend(SolveOp op, TangentBuilder &b) const {
    Value rest = b.getTangent(op.getRhs());
    if (Value tangent = b.getTangent(op.getMatrix())) {
      Value product = createMatmul(b, tangent, op.getResult());
      product = createMatrixGuard(b, tangent, product);
      rest = rest ? Value(arith::SubFOp::create(b, rest, product))
                  : Value(arith::NegFOp::create(b, product));
    }
    return createMatrixGuard(
        b, rest, SolveOp::create(b, op.getType(), op.getMatrix(), rest));
  }
};
} // namespace

void mlir::tai::registerMatrixModels(DialectRegistry &registry) {
  registry.addExtension(+[](MLIRContext *context, TaiDialect *) {
    MatmulOp::attachInterface<MatmulModel>(*context);
    TransposeOp::attachInterface<TransposeModel>(*context);
    DotOp::attachInterface<DotModel>(*context);
    SumOp::attachInterface<SumModel>(*context);
    CrossOp::attachInterface<CrossModel>(*context);
    OuterOp::attachInterface<OuterModel>(*context);
    NormOp::attachInterface<NormModel>(*context);
    StopGradientOp::attachInterface<StopGradientModel>(*context);
    DeriveAsOp::attachInterface<DeriveAsModel>(*context);
    TraceOp::attachInterface<TraceModel>(*context);
    DeterminantOp::attachInterface<DeterminantModel>(*context);
    InverseOp::attachInterface<InverseModel>(*context);
    SolveOp::attachInterface<SolveModel>(*context);
  });
}
