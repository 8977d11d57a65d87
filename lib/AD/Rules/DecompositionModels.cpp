//===- DecompositionModels.cpp - Derivatives of matrix decompositions -----===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Polar, singular value and symmetric eigenvalue decompositions. Where values
// coincide, the factors turn freely and have no derivative; a loss that does
// not depend on that freedom has one, and gets it: the terms are arranged so
// that what must cancel is divided alone, and the quotient is zero where the
// divisor is.
//
//===----------------------------------------------------------------------===//

#include "MatrixHelpers.h"
#include "Models.h"

using namespace mlir;
using namespace mlir::tai;

namespace {

/// A number in a formula.
struct S {
  DerivativeBuilder *b;
  Value v;
};
S operator+(S a, S c) { return {a.b, arith::AddFOp::create(*a.b, a.v, c.v)}; }
S operator-(S a, S c) { return {a.b, arith::SubFOp::create(*a.b, a.v, c.v)}; }
S operator*(S a, S c) { return {a.b, arith::MulFOp::create(*a.b, a.v, c.v)}; }
S operator-(S a) { return {a.b, arith::NegFOp::create(*a.b, a.v)}; }
S operator*(double a, S c) {
  return S{c.b, c.b->createConstant(c.v.getType(), a)} * c;
}
S abs(S a) { return {a.b, math::AbsFOp::create(*a.b, a.v)}; }

/// a / c, and 0 where |c| is not above `floor`.
S divideAbove(S a, S c, S floor) {
  DerivativeBuilder &b = *a.b;
  Value isLarge =
      arith::CmpFOp::create(b, arith::CmpFPredicate::OGT, abs(c).v, floor.v);
  return {&b, b.createMask(isLarge, arith::DivFOp::create(b, a.v, c.v))};
}

/// a, and 0 where |a| is not above `floor`. NaN stays.
S dropBelow(S a, S floor) {
  DerivativeBuilder &b = *a.b;
  Value isSmall =
      arith::CmpFOp::create(b, arith::CmpFPredicate::OLE, abs(a).v, floor.v);
  return {&b, arith::SelectOp::create(b, isSmall, b.createZero(a.v.getType()),
                                      a.v)};
}

/// A small matrix taken apart.
struct M {
  DerivativeBuilder *b;
  Value v;
  S operator()(int64_t i, int64_t j) const {
    return {b, b->createExtract(v, i * getRows(v) + j)};
  }
};

/// The greatest magnitude of an entry.
S getGreatest(M m, int64_t n) {
  S greatest = abs(m(0, 0));
  for (int64_t k = 1; k != n * n; ++k)
    greatest = {m.b, arith::MaximumFOp::create(*m.b, greatest.v,
                                               abs(m(k / n, k % n)).v)};
  return greatest;
}

/// What the relative distance of two values must exceed to be told apart.
double getTolerance(Type type) {
  return getElementTypeOrSelf(type).isF64() ? 8 * 2.220446e-16
                                            : 8 * 1.192093e-7;
}

/// The vector w with [w]ₓ = P - Pᵀ.
SmallVector<S> getAxial(M p) {
  return {p(2, 1) - p(1, 2), p(0, 2) - p(2, 0), p(1, 0) - p(0, 1)};
}

/// A = R S. With S = Rᵀ A the adjoint of S joins those of R and A; R turns by
/// dR = R [w]ₓ with (tr(S) I - S) w = axial(Rᵀ dA - dAᵀ R).
struct PolarModel
    : DifferentiableOpInterface::ExternalModel<PolarModel, PolarOp> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &b) const {
    auto polar = cast<PolarOp>(op);
    Value a = polar.getMatrix();
    Value r = b.getPrimal(polar.getRotation());
    Value gr = b.getAdjoint(polar.getRotation());
    if (Value gs = b.getAdjoint(polar.getStretch())) {
      b.addAdjoint(a, createMatmul(b, r, gs));
      Value turned = createMatmul(b, b.getPrimal(a), createTranspose(b, gs));
      gr = gr ? Value(arith::AddFOp::create(b, gr, turned)) : turned;
    }
    if (getRows(a) == 2)
      buildPlanar(b, a, r, gr);
    else
      buildSpatial(b, polar, r, gr);
    return success();
  }

  LogicalResult buildTangent(Operation *op, TangentBuilder &b) const {
    auto polar = cast<PolarOp>(op);
    Value r = polar.getRotation(), a = polar.getMatrix();
    Value tangent = b.getTangent(a);
    Value turned = createMatmul(b, createTranspose(b, r), tangent);
    Value turn = getRows(a) == 2 ? extendPlanar(b, a, r, tangent)
                                 : extendSpatial(b, polar, r, turned);
    b.setTangent(r, turn);
    // S = Rᵀ A
    Value stretched = createMatmul(b, createTranspose(b, turn), a);
    b.setTangent(polar.getStretch(),
                 arith::AddFOp::create(b, turned, stretched));
    return success();
  }

  static Value extendPlanar(TangentBuilder &b, Value matrix, Value r,
                            Value tangent) {
    M a{&b, matrix}, d{&b, tangent}, rotation{&b, r};
    S x = a(0, 0) + a(1, 1), y = a(1, 0) - a(0, 1);
    S dx = d(0, 0) + d(1, 1), dy = d(1, 0) - d(0, 1);
    S zero{&b, b.createZero(x.v.getType())};
    S angle = divideAbove(x * dy - y * dx, x * x + y * y, zero);
    S dc = -(rotation(1, 0) * angle), ds = rotation(0, 0) * angle;
    return b.createVector(cast<VectorType>(r.getType()),
                          {dc.v, (-ds).v, ds.v, dc.v});
  }

  static Value extendSpatial(TangentBuilder &b, PolarOp op, Value r,
                             Value turned) {
    Value axial = createAxis(b, op.getStretch(), M{&b, turned});
    return createMatmul(b, r, createSkew(b, axial));
  }

  /// R turns by the angle of (a₀₀ + a₁₁, a₁₀ - a₀₁).
  static void buildPlanar(AdjointBuilder &b, Value matrix, Value r, Value gr) {
    M a{&b, b.getPrimal(matrix)}, rotation{&b, r}, g{&b, gr};
    S c = rotation(0, 0), s = rotation(1, 0);
    S angle = c * (g(1, 0) - g(0, 1)) - s * (g(0, 0) + g(1, 1));
    S x = a(0, 0) + a(1, 1), y = a(1, 0) - a(0, 1);
    S zero{&b, b.createZero(x.v.getType())};
    S scale = divideAbove(angle, x * x + y * y, zero);
    S gx = -(y * scale), gy = x * scale;
    b.addAdjointComponent(matrix, 0, gx.v);
    b.addAdjointComponent(matrix, 3, gx.v);
    b.addAdjointComponent(matrix, 1, (-gy).v);
    b.addAdjointComponent(matrix, 2, gy.v);
  }

  static void buildSpatial(AdjointBuilder &b, PolarOp op, Value r, Value gr) {
    M p{&b, createMatmul(b, createTranspose(b, r), gr)};
    Value w = createAxis(b, b.getPrimal(op.getStretch()), p);
    b.addAdjoint(op.getMatrix(), createMatmul(b, r, createSkew(b, w)));
  }

  /// The solution w of (tr(S) I - S) w = axial(P - Pᵀ).
  static Value createAxis(DerivativeBuilder &b, Value stretchMatrix, M p) {
    auto type = cast<VectorType>(stretchMatrix.getType());
    Type element = type.getElementType();
    auto vectorType = VectorType::get({3}, element);
    SmallVector<Value> axial =
        llvm::map_to_vector(getAxial(p), [](S s) { return s.v; });
    M stretch{&b, stretchMatrix};
    S trace = stretch(0, 0) + stretch(1, 1) + stretch(2, 2);
    SmallVector<Value> k;
    for (int64_t i = 0; i != 3; ++i)
      for (int64_t j = 0; j != 3; ++j)
        k.push_back((i == j ? trace - stretch(i, j) : -stretch(i, j)).v);
    Value system = b.createVector(type, k);
    // Singular where two singular values cancel: R jumps there.
    Value determinant = DeterminantOp::create(b, element, system);
    Value isRegular = arith::CmpFOp::create(b, arith::CmpFPredicate::ONE,
                                            determinant, b.createZero(element));
    Value w = SolveOp::create(b, vectorType, system,
                              b.createVector(vectorType, axial));
    return b.createMask(isRegular, w);
  }

  /// [w]ₓ
  static Value createSkew(DerivativeBuilder &b, Value w) {
    auto type =
        VectorType::get({3, 3}, cast<VectorType>(w.getType()).getElementType());
    auto at = [&](int64_t i) { return S{&b, b.createExtract(w, i)}; };
    return b.createVector(type, {Value(), (-at(2)).v, at(1).v, at(2).v, Value(),
                                 (-at(0)).v, (-at(1)).v, at(0).v, Value()});
  }
};

/// Uᵀ G, or zeros.
M getTurned(DerivativeBuilder &b, Value u, Value g) {
  if (!g)
    return {&b, b.createZero(u.getType())};
  return {&b, createMatmul(b, createTranspose(b, u), g)};
}

/// A = U Σ Vᵀ. In the frame of the factors, dU = U Ω and dV = V Ψ with skew Ω,
/// Ψ; for i < j the sum and difference of their entries are
///   Ωᵢⱼ + Ψᵢⱼ = (Pᵢⱼ + Pⱼᵢ) / (σⱼ - σᵢ),  Ωᵢⱼ - Ψᵢⱼ = (Pᵢⱼ - Pⱼᵢ) / (σⱼ + σᵢ),
/// where P = Uᵀ dA V. Where σᵢ = σⱼ, the first quotient is 0 / 0 for a loss
/// that does not depend on how U and V turn together. What such a loss makes of
/// U Σ Vᵀ then stands in the adjoint of Σ off the diagonal, where Σ is zero: dΣ
/// gets the symmetric part of P there. Away from σᵢ = σⱼ this is taken out of
/// the quotient, which is the same but for rounding: of a difference that
/// cancels, nothing is left but noise, which is dropped before it is divided by
/// little.
struct SvdModel : DifferentiableOpInterface::ExternalModel<SvdModel, SvdOp> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &b) const {
    auto svd = cast<SvdOp>(op);
    int64_t n = getRows(svd.getMatrix());
    auto type = cast<VectorType>(svd.getMatrix().getType());
    Value u = b.getPrimal(svd.getU()), v = b.getPrimal(svd.getV());
    M sigma{&b, b.getPrimal(svd.getSigma())};
    M gu = getTurned(b, u, b.getAdjoint(svd.getU()));
    M gv = getTurned(b, v, b.getAdjoint(svd.getV()));
    M gs{&b, b.getAdjointOrZero(svd.getSigma())};
    S least{&b,
            b.createConstant(type.getElementType(),
                             type.getElementType().isF64() ? 1e-300 : 1e-37)};
    S floor = getTolerance(type) * abs(sigma(0, 0)) + least;
    S noise =
        2 * getTolerance(type) * (getGreatest(gu, n) + getGreatest(gv, n));
    SmallVector<Value> p(n * n);
    for (int64_t i = 0; i != n; ++i) {
      p[i * n + i] = gs(i, i).v;
      for (int64_t j = i + 1; j != n; ++j) {
        S omega = gu(i, j) - gu(j, i), psi = gv(i, j) - gv(j, i);
        S si = sigma(i, i), sj = sigma(j, j);
        S off = 0.5 * (gs(i, j) + gs(j, i));
        S rest = dropBelow(0.5 * (omega + psi) - off * (sj - si), noise);
        S even = off + divideAbove(rest, sj - si, floor);
        S odd = divideAbove(0.5 * (omega - psi), sj + si, floor);
        p[i * n + j] = (even + odd).v;
        p[j * n + i] = (even - odd).v;
      }
    }
    Value inner = b.createVector(type, p);
    b.addAdjoint(svd.getMatrix(), createMatmul(b, createMatmul(b, u, inner),
                                               createTranspose(b, v)));
    return success();
  }

  LogicalResult buildTangent(Operation *op, TangentBuilder &b) const {
    auto svd = cast<SvdOp>(op);
    int64_t n = getRows(svd.getMatrix());
    auto type = cast<VectorType>(svd.getMatrix().getType());
    Value u = svd.getU(), v = svd.getV();
    M sigma{&b, svd.getSigma()};
    M p{&b, createMatmul(b,
                         createMatmul(b, createTranspose(b, u),
                                      b.getTangent(svd.getMatrix())),
                         v)};
    S least{&b,
            b.createConstant(type.getElementType(),
                             type.getElementType().isF64() ? 1e-300 : 1e-37)};
    S floor = getTolerance(type) * abs(sigma(0, 0)) + least;
    SmallVector<Value> omega(n * n), psi(n * n), values(n * n);
    for (int64_t i = 0; i != n; ++i) {
      values[i * n + i] = p(i, i).v;
      for (int64_t j = i + 1; j != n; ++j) {
        S si = sigma(i, i), sj = sigma(j, j);
        S symmetric = 0.5 * (p(i, j) + p(j, i));
        S even = divideAbove(symmetric, sj - si, floor);
        S odd = divideAbove(0.5 * (p(i, j) - p(j, i)), sj + si, floor);
        omega[i * n + j] = (even + odd).v;
        omega[j * n + i] = (-(even + odd)).v;
        psi[i * n + j] = (even - odd).v;
        psi[j * n + i] = (odd - even).v;
        // Where σᵢ = σⱼ, U and V are not told to turn, and Σ takes the rest.
        values[i * n + j] = values[j * n + i] =
            (symmetric - even * (sj - si)).v;
      }
    }
    b.setTangent(svd.getSigma(), b.createVector(type, values));
    b.setTangent(u, createMatmul(b, u, b.createVector(type, omega)));
    b.setTangent(v, createMatmul(b, v, b.createVector(type, psi)));
    return success();
  }
};

/// A = Q Λ Qᵀ with A read below the diagonal: dQ = Q Ω, Ωᵢⱼ = Pᵢⱼ / (λⱼ - λᵢ),
/// where P = Qᵀ dA Q.
struct SymEigModel
    : DifferentiableOpInterface::ExternalModel<SymEigModel, SymEigOp> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &b) const {
    auto eig = cast<SymEigOp>(op);
    int64_t n = getRows(eig.getMatrix());
    auto type = cast<VectorType>(eig.getMatrix().getType());
    Value q = b.getPrimal(eig.getVectors());
    Value values = b.getPrimal(eig.getValues());
    auto lambda = [&](int64_t i) { return S{&b, b.createExtract(values, i)}; };
    M gq = getTurned(b, q, b.getAdjoint(eig.getVectors()));
    SmallVector<Value> gl = b.getAdjointComponents(eig.getValues());
    S floor = getTolerance(type) * (abs(lambda(0)) + abs(lambda(n - 1)));
    SmallVector<Value> p(n * n);
    for (int64_t i = 0; i != n; ++i) {
      p[i * n + i] = gl[i];
      for (int64_t j = i + 1; j != n; ++j) {
        S half = divideAbove(0.5 * (gq(i, j) - gq(j, i)), lambda(j) - lambda(i),
                             floor);
        p[i * n + j] = p[j * n + i] = half.v;
      }
    }
    Value inner = b.createVector(type, p);
    M full{&b,
           createMatmul(b, createMatmul(b, q, inner), createTranspose(b, q))};
    for (int64_t i = 0; i != n; ++i)
      for (int64_t j = 0; j <= i; ++j)
        b.addAdjointComponent(
            eig.getMatrix(), i * n + j,
            (i == j ? full(i, j) : full(i, j) + full(j, i)).v);
    return success();
  }

  LogicalResult buildTangent(Operation *op, TangentBuilder &b) const {
    auto eig = cast<SymEigOp>(op);
    int64_t n = getRows(eig.getMatrix());
    auto type = cast<VectorType>(eig.getMatrix().getType());
    Value q = eig.getVectors(), values = eig.getValues();
    auto lambda = [&](int64_t i) { return S{&b, b.createExtract(values, i)}; };
    M tangent{&b, b.getTangent(eig.getMatrix())};
    SmallVector<Value> lower(n * n);
    for (int64_t i = 0; i != n; ++i)
      for (int64_t j = 0; j <= i; ++j)
        lower[i * n + j] = lower[j * n + i] = tangent(i, j).v;
    Value symmetric = b.createVector(type, lower);
    M p{&b,
        createMatmul(b, createMatmul(b, createTranspose(b, q), symmetric), q)};
    S floor = getTolerance(type) * (abs(lambda(0)) + abs(lambda(n - 1)));
    SmallVector<Value> diagonal, omega(n * n);
    for (int64_t i = 0; i != n; ++i) {
      diagonal.push_back(p(i, i).v);
      for (int64_t j = i + 1; j != n; ++j) {
        S turn = divideAbove(p(i, j), lambda(j) - lambda(i), floor);
        omega[i * n + j] = turn.v;
        omega[j * n + i] = (-turn).v;
      }
    }
    b.setTangent(values,
                 b.createVector(cast<VectorType>(values.getType()), diagonal));
    b.setTangent(q, createMatmul(b, q, b.createVector(type, omega)));
    return success();
  }
};
} // namespace

void mlir::tai::registerDecompositionModels(DialectRegistry &registry) {
  registry.addExtension(+[](MLIRContext *context, TaiDialect *) {
    PolarOp::attachInterface<PolarModel>(*context);
    SvdOp::attachInterface<SvdModel>(*context);
    SymEigOp::attachInterface<SymEigModel>(*context);
  });
}
