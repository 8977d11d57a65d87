//===- DecompositionModels.cpp - Derivatives of matrix decompositions -----===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Polar, singular value and symmetric eigenvalue decompositions. Where values
// coincide, the factors are not unique and have no derivative; a loss that does
// not depend on their choice has one, and gets it: terms that cancel are
// divided separately, with a quotient of zero where the divisor is zero. Where
// the sum of two singular values is zero, the polar rotation jumps and is not
// differentiable: that component of the derivative is set to zero.
//
//===----------------------------------------------------------------------===//

#include "Models.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/AD/Rules/MatrixFormulas.h"

using namespace mlir;
using namespace mlir::tai;

namespace {

/// Returns the vector w with [w]ₓ = P - Pᵀ, where [w]ₓ is the matrix of the
/// cross product with w.
SmallVector<S> getAxial(M p) {
  return {p(2, 1) - p(1, 2), p(0, 2) - p(2, 0), p(1, 0) - p(0, 1)};
}

/// The derivative of the polar decomposition A = R S. As S = Rᵀ A, the adjoint
/// of S contributes to the adjoints of R and A. The differential of R is R
/// [w]ₓ, where w is the solution of (tr(S) I - S) w = axial(Rᵀ dA - dAᵀ R).
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

  /// R is the rotation by the angle of (x, y) = (a₀₀ + a₁₁, a₁₀ - a₀₁), with
  /// cosine c and sine s. The length of (x, y), c x + s y, is the sum of the
  /// singular values. Returns (x, y) divided by the square of that length, or
  /// zero where R jumps.
  static std::pair<S, S> getPlanarSlopes(DerivativeBuilder &b, Value matrix,
                                         S c, S s) {
    M a{&b, matrix};
    Type type = matrix.getType();
    S length = c * (a(0, 0) + a(1, 1)) + s * (a(1, 0) - a(0, 1));
    S least{&b, b.createConstant(c.v.getType(), getLeast(type))};
    S floor = getJumpTolerance(type) * getGreatest(a) + least;
    S one{&b, b.createConstant(c.v.getType(), 1)};
    S inverse = divideAbove(one, length, floor);
    return {c * inverse, s * inverse};
  }

  static Value extendPlanar(TangentBuilder &b, Value matrix, Value r,
                            Value tangent) {
    M d{&b, tangent}, rotation{&b, r};
    S c = rotation(0, 0), s = rotation(1, 0);
    auto [x, y] = getPlanarSlopes(b, matrix, c, s);
    S dx = d(0, 0) + d(1, 1), dy = d(1, 0) - d(0, 1);
    S angle = x * dy - y * dx;
    S dc = -(s * angle), ds = c * angle;
    return b.createVector(cast<VectorType>(r.getType()),
                          {dc.v, (-ds).v, ds.v, dc.v});
  }

  static Value extendSpatial(TangentBuilder &b, PolarOp op, Value r,
                             Value turned) {
    Value axial = createAxis(b, op.getStretch(), M{&b, turned});
    return createMatmul(b, r, createSkew(b, axial));
  }

  static void buildPlanar(AdjointBuilder &b, Value matrix, Value r, Value gr) {
    M rotation{&b, r}, g{&b, gr};
    S c = rotation(0, 0), s = rotation(1, 0);
    S angle = c * (g(1, 0) - g(0, 1)) - s * (g(0, 0) + g(1, 1));
    auto [x, y] = getPlanarSlopes(b, b.getPrimal(matrix), c, s);
    S gx = -(y * angle), gy = x * angle;
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

  /// Emits the solution w of (tr(S) I - S) w = axial(P - Pᵀ). The system is
  /// singular where the sum of two singular values is zero.
  static Value createAxis(DerivativeBuilder &b, Value stretchMatrix, M p) {
    auto type = cast<VectorType>(stretchMatrix.getType());
    Type element = type.getElementType();
    auto vectorType = VectorType::get({3}, element);
    Value axial = b.createVector(
        vectorType, llvm::map_to_vector(getAxial(p), [](S s) { return s.v; }));
    M stretch{&b, stretchMatrix};
    S trace = stretch(0, 0) + stretch(1, 1) + stretch(2, 2);
    SmallVector<Value> k;
    for (int64_t i = 0; i != 3; ++i)
      for (int64_t j = 0; j != 3; ++j)
        k.push_back((i == j ? trace - stretch(i, j) : -stretch(i, j)).v);
    Value system = b.createVector(type, k);
    // Elimination is accurate where the system is far from singular. The
    // eigenvalues of the system are the sums of two singular values.
    S determinant{&b, DeterminantOp::create(b, element, system)};
    S size = 2 * abs(trace);
    Value isRegular =
        arith::CmpFOp::create(b, arith::CmpFPredicate::OGT, determinant.v,
                              (1e-3 * (size * size * size)).v);
    auto branch = scf::IfOp::create(b, vectorType, isRegular,
                                    /*withElseRegion=*/true);
    OpBuilder::InsertionGuard guard(b);
    b.setInsertionPointToStart(branch.thenBlock());
    Value solved = SolveOp::create(b, vectorType, system, axial);
    scf::YieldOp::create(b, solved);
    b.setInsertionPointToStart(branch.elseBlock());
    S noise = 2 * getTolerance(type) * getGreatest(p);
    scf::YieldOp::create(b, createNearAxis(b, stretchMatrix, axial, noise));
    return branch.getResult(0);
  }

  /// Solves the system of createAxis by the eigenvectors of S, with zero for
  /// the components of w along which R jumps.
  static Value createNearAxis(DerivativeBuilder &b, Value stretch, Value axial,
                              S noise) {
    auto type = cast<VectorType>(stretch.getType());
    auto vectorType = cast<VectorType>(axial.getType());
    auto eig = SymEigOp::create(b, vectorType, type, stretch);
    Value turned = createMatmul(b, createTranspose(b, eig.getVectors()), axial);
    auto lambda = [&](int64_t i) {
      return S{&b, b.createExtract(eig.getValues(), i)};
    };
    S least{&b, b.createConstant(type.getElementType(), getLeast(type))};
    S floor =
        getJumpTolerance(type) * max(abs(lambda(0)), abs(lambda(2))) + least;
    SmallVector<Value> components;
    for (int64_t i = 0; i != 3; ++i) {
      S known = dropBelow(S{&b, b.createExtract(turned, i)}, noise);
      S sum = lambda((i + 1) % 3) + lambda((i + 2) % 3);
      components.push_back(divideAbove(known, sum, floor).v);
    }
    return createMatmul(b, eig.getVectors(),
                        b.createVector(vectorType, components));
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

/// Emits the product Uᵀ G; zeros if `g` is null.
M getTurned(DerivativeBuilder &b, Value u, Value g) {
  if (!g)
    return {&b, b.createZero(u.getType())};
  return {&b, createMatmul(b, createTranspose(b, u), g)};
}

/// A = U Σ Vᵀ. In the frame of the factors, dU = U Ω and dV = V Ψ with skew Ω,
/// Ψ; for i < j the sum and difference of their entries are
///   Ωᵢⱼ + Ψᵢⱼ = (Pᵢⱼ + Pⱼᵢ) / (σⱼ - σᵢ),  Ωᵢⱼ - Ψᵢⱼ = (Pᵢⱼ - Pⱼᵢ) / (σⱼ + σᵢ),
/// where P = Uᵀ dA V. Where σᵢ = σⱼ, the first quotient is 0 / 0 for a loss
/// that does not depend on how U and V turn together; where σᵢ = -σⱼ, so is the
/// second quotient for a loss that does not depend on how U and V turn against
/// each other. The effect of such a loss is in the adjoint of Σ off the
/// diagonal, where Σ is zero: its symmetric and skew parts are the adjoints of
/// these parts of P. Where the divisor is not zero, the part is added to the
/// quotient and, times the divisor, subtracted from the numerator. This changes
/// rounding alone: a numerator that should cancel is noise, and is dropped
/// before it is divided by a small number.
struct SvdModel : DifferentiableOpInterface::ExternalModel<SvdModel, SvdOp> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &b) const {
    auto svd = cast<SvdOp>(op);
    int64_t n = getRows(svd.getMatrix());
    auto type = cast<VectorType>(svd.getMatrix().getType());
    Value u = b.getPrimal(svd.getU()), v = b.getPrimal(svd.getV());
    if (!b.getAdjoint(svd.getU()) && !b.getAdjoint(svd.getV())) {
      buildByValues(svd, b, u, v);
      return success();
    }
    M sigma{&b, b.getPrimal(svd.getSigma())};
    M gu = getTurned(b, u, b.getAdjoint(svd.getU()));
    M gv = getTurned(b, v, b.getAdjoint(svd.getV()));
    M gs{&b, b.getAdjointOrZero(svd.getSigma())};
    Floors floors = getFloors(sigma);
    S noise = 2 * getTolerance(type) * (getGreatest(gu) + getGreatest(gv));
    SmallVector<Value> p(n * n);
    for (int64_t i = 0; i != n; ++i) {
      p[i * n + i] = gs(i, i).v;
      for (int64_t j = i + 1; j != n; ++j) {
        S omega = gu(i, j) - gu(j, i), psi = gv(i, j) - gv(j, i);
        S difference = sigma(j, j) - sigma(i, i);
        S sum = sigma(j, j) + sigma(i, i);
        auto pass = [&](S turn, S off, S divisor, S floor) {
          S rest = dropBelow(0.5 * turn - off * divisor, noise);
          return off + divideAbove(rest, divisor, floor);
        };
        S even = pass(omega + psi, 0.5 * (gs(i, j) + gs(j, i)), difference,
                      floors.difference);
        S odd = pass(omega - psi, 0.5 * (gs(i, j) - gs(j, i)), sum, floors.sum);
        p[i * n + j] = (even + odd).v;
        p[j * n + i] = (even - odd).v;
      }
    }
    Value inner = b.createVector(type, p);
    b.addAdjoint(svd.getMatrix(), createMatmul(b, createMatmul(b, u, inner),
                                               createTranspose(b, v)));
    return success();
  }

  /// Adds the adjoint for the singular values alone: dσᵢ = Pᵢᵢ.
  static void buildByValues(SvdOp svd, AdjointBuilder &b, Value u, Value v) {
    M gs{&b, b.getAdjoint(svd.getSigma())};
    int64_t n = getRows(gs.v);
    SmallVector<Value> p(n * n);
    for (int64_t i = 0; i != n; ++i)
      p[i * n + i] = gs(i, i).v;
    Value inner = b.createVector(cast<VectorType>(gs.v.getType()), p);
    b.addAdjoint(svd.getMatrix(), createMatmul(b, createMatmul(b, u, inner),
                                               createTranspose(b, v)));
  }

  LogicalResult buildTangent(Operation *op, TangentBuilder &b) const {
    auto svd = cast<SvdOp>(op);
    FactorRotations rotations = createFactorRotations(b, svd);
    Value u = svd.getU(), v = svd.getV();
    b.setTangent(svd.getSigma(), rotations.rest);
    b.setTangent(
        u, createMatmul(
               b, u, arith::AddFOp::create(b, rotations.even, rotations.odd)));
    b.setTangent(
        v, createMatmul(
               b, v, arith::SubFOp::create(b, rotations.even, rotations.odd)));
    return success();
  }
};

/// The derivative of the eigendecomposition A = Q Λ Qᵀ with A read below the
/// diagonal: dQ = Q Ω, Ωᵢⱼ = Pᵢⱼ / (λⱼ - λᵢ), where P = Qᵀ dA Q.
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

FactorRotations mlir::tai::createFactorRotations(TangentBuilder &b, SvdOp svd) {
  int64_t n = getRows(svd.getMatrix());
  auto type = cast<VectorType>(svd.getMatrix().getType());
  M sigma{&b, svd.getSigma()};
  M p{&b, createMatmul(b,
                       createMatmul(b, createTranspose(b, svd.getU()),
                                    b.getTangent(svd.getMatrix())),
                       svd.getV())};
  Floors floors = getFloors(sigma);
  SmallVector<Value> evens(n * n), odds(n * n), rests(n * n);
  for (int64_t i = 0; i != n; ++i) {
    rests[i * n + i] = p(i, i).v;
    for (int64_t j = i + 1; j != n; ++j) {
      S difference = sigma(j, j) - sigma(i, i);
      S sum = sigma(j, j) + sigma(i, i);
      S symmetric = 0.5 * (p(i, j) + p(j, i));
      S skew = 0.5 * (p(i, j) - p(j, i));
      S even = divideAbove(symmetric, difference, floors.difference);
      S odd = divideAbove(skew, sum, floors.sum);
      evens[i * n + j] = even.v;
      evens[j * n + i] = (-even).v;
      odds[i * n + j] = odd.v;
      odds[j * n + i] = (-odd).v;
      // `rests` gets, for each entry of P off the diagonal, the part that
      // turning U and V does not account for. It can be non-zero only where a
      // quotient was set to zero.
      S first = symmetric - even * difference, second = skew - odd * sum;
      rests[i * n + j] = (first + second).v;
      rests[j * n + i] = (first - second).v;
    }
  }
  return {b.createVector(type, evens), b.createVector(type, odds),
          b.createVector(type, rests)};
}

void mlir::tai::registerDecompositionModels(DialectRegistry &registry) {
  registry.addExtension(+[](MLIRContext *context, TaiDialect *) {
    PolarOp::attachInterface<PolarModel>(*context);
    SvdOp::attachInterface<SvdModel>(*context);
    SymEigOp::attachInterface<SymEigModel>(*context);
  });
}
