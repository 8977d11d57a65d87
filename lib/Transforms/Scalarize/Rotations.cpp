//===- Rotations.cpp - SVD, polar, symmetric eigenvalues ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// 2×2 in closed form; 3×3 by Jacobi rotations, which are accurate to the last
// bits for equal, zero and negative values alike, where formulas from the
// characteristic polynomial are not. A fixed number of sweeps reaches rounding
// error (convergence is quadratic), and keeps iterations alike.
//
//===----------------------------------------------------------------------===//

#include "Scalarizer.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include <cmath>

using namespace mlir;
using namespace mlir::tai;

namespace {
/// The cosine, sine and tangent of a Jacobi rotation.
struct Rotation {
  Value c, s, t;
};
} // namespace

/// Emits the rotation by the smaller angle that makes [[p, q], [q, r]]
/// diagonal, with values p - t q and r + t q.
static Rotation emitRotation(ScalarMath &math, Value p, Value q, Value r) {
  Type type = p.getType();
  Value zero = math.constant(type, 0), one = math.constant(type, 1);
  Value half = math.mul(math.constant(type, 0.5), math.sub(r, p));
  Value length = math.sqrt(math.add(math.mul(half, half), math.mul(q, q)));
  Value negative = math.less(half, zero);
  Value divisor =
      math.add(half, math.select(negative, math.neg(length), length));
  // For a diagonal matrix with equal values any rotation will do, so the
  // identity is taken.
  Value none = math.equal(divisor, zero);
  Value t =
      math.div(math.select(none, zero, q), math.select(none, one, divisor));
  Value c = math.div(one, math.sqrt(math.add(math.mul(t, t), one)));
  return {c, math.mul(t, c), t};
}

/// Emits the rotation of columns p and q of an n-column matrix, which become c
/// p - s q and s p + c q.
static void emitRotateColumns(ScalarMath &math, MutableArrayRef<Value> matrix,
                              unsigned n, unsigned p, unsigned q,
                              const Rotation &rotation) {
  for (unsigned i = 0; i != matrix.size() / n; ++i) {
    Value x = matrix[i * n + p], y = matrix[i * n + q];
    matrix[i * n + p] =
        math.sub(math.mul(rotation.c, x), math.mul(rotation.s, y));
    matrix[i * n + q] =
        math.add(math.mul(rotation.s, x), math.mul(rotation.c, y));
  }
}

/// Emits code that exchanges columns p and q of a matrix where `condition`
/// holds. One column changes its sign, so that a rotation matrix stays a
/// rotation.
static void emitSwapColumns(ScalarMath &math, MutableArrayRef<Value> matrix,
                            unsigned n, unsigned p, unsigned q,
                            Value condition) {
  for (unsigned i = 0; i != matrix.size() / n; ++i) {
    Value x = matrix[i * n + p], y = matrix[i * n + q];
    matrix[i * n + p] = math.select(condition, y, x);
    matrix[i * n + q] = math.select(condition, math.neg(x), y);
  }
}

static void emitSwap(ScalarMath &math, Value &x, Value &y, Value condition) {
  Value first = math.select(condition, y, x);
  y = math.select(condition, x, y);
  x = first;
}

static Components emitIdentity(ScalarMath &math, Type type, unsigned n) {
  Components result(n * n, math.constant(type, 0));
  Value one = math.constant(type, 1);
  for (unsigned i = 0; i != n; ++i)
    result[i * n + i] = one;
  return result;
}

/// The pairs of columns that one sweep of the Jacobi method rotates.
static constexpr unsigned kPairs[3][2] = {{0, 1}, {0, 2}, {1, 2}};

/// Emits a loop that runs `sweep` on the state often enough to converge. It is
/// a loop because code size matters more than the branch.
static Components
emitSweeps(ScalarMath &math, Components state,
           function_ref<void(ScalarMath &, MutableArrayRef<Value>)> sweep) {
  OpBuilder &builder = math.getBuilder();
  Location loc = math.getLoc();
  unsigned width = state[0].getType().getIntOrFloatBitWidth();
  Value zero = arith::ConstantIndexOp::create(builder, loc, 0);
  Value one = arith::ConstantIndexOp::create(builder, loc, 1);
  Value count =
      arith::ConstantIndexOp::create(builder, loc, width > 32 ? 7 : 5);
  auto loop = scf::ForOp::create(
      builder, loc, zero, count, one, state,
      [&](OpBuilder &inside, Location, Value, ValueRange args) {
        ScalarMath insideMath(inside, loc);
        SmallVector<Value> next(args);
        sweep(insideMath, next);
        scf::YieldOp::create(inside, loc, next);
      });
  return Components(loop.getResults());
}

//===----------------------------------------------------------------------===//
// Symmetric eigenvalues
//===----------------------------------------------------------------------===//

/// Emits a matrix divided by its largest entry, so that squares neither
/// overflow nor vanish. `scale` is the factor to multiply by afterwards;
/// `empty` is true if the factor is 0.
static Components emitScaled(ScalarMath &math, ArrayRef<Value> a, Value &scale,
                             Value &empty) {
  Type type = a[0].getType();
  scale = math.abs(a[0]);
  for (Value value : a.drop_front())
    scale = math.max(scale, math.abs(value));
  empty = math.equal(scale, math.constant(type, 0));
  Value divisor = math.select(empty, math.constant(type, 1), scale);
  Components result;
  for (Value value : a)
    result.push_back(math.div(value, divisor));
  return result;
}

SymEig tai::emitSymEig(ScalarMath &math, ArrayRef<Value> matrix, unsigned n) {
  Value scale, empty;
  Components a = emitScaled(math, matrix, scale, empty);
  SymEig result;
  if (n == 2) {
    Rotation rotation = emitRotation(math, a[0], a[2], a[3]);
    Value change = math.mul(rotation.t, a[2]);
    result.values = {math.sub(a[0], change), math.add(a[3], change)};
    result.vectors = {rotation.c, rotation.s, math.neg(rotation.s), rotation.c};
    Value ascending = math.less(result.values[0], result.values[1]);
    emitSwap(math, result.values[0], result.values[1], ascending);
    emitSwapColumns(math, result.vectors, 2, 0, 1, ascending);
    for (Value &value : result.values)
      value = math.mul(value, scale);
    return result;
  }

  // The state of the iteration: the diagonal, the elements 10, 20 and 21 of the
  // lower triangle, and the eigenvectors.
  Components state = {a[0], a[4], a[8], a[3], a[6], a[7]};
  llvm::append_range(state, emitIdentity(math, a[0].getType(), 3));
  state = emitSweeps(
      math, state, [](ScalarMath &inside, MutableArrayRef<Value> values) {
        auto at = [&](unsigned i, unsigned j) -> Value & {
          return values[i == j ? i : 2 + i + j];
        };
        for (auto [p, q] : kPairs) {
          unsigned k = 3 - p - q;
          Rotation rotation =
              emitRotation(inside, at(p, p), at(p, q), at(q, q));
          Value change = inside.mul(rotation.t, at(p, q));
          at(p, p) = inside.sub(at(p, p), change);
          at(q, q) = inside.add(at(q, q), change);
          Value x = at(k, p), y = at(k, q);
          at(k, p) =
              inside.sub(inside.mul(rotation.c, x), inside.mul(rotation.s, y));
          at(k, q) =
              inside.add(inside.mul(rotation.s, x), inside.mul(rotation.c, y));
          at(p, q) = inside.constant(x.getType(), 0);
          emitRotateColumns(inside, values.drop_front(6), 3, p, q, rotation);
        }
      });
  result.values.assign(state.begin(), state.begin() + 3);
  result.vectors.assign(state.begin() + 6, state.end());
  for (auto [p, q] : {std::pair(0, 1), std::pair(1, 2), std::pair(0, 1)}) {
    Value ascending = math.less(result.values[p], result.values[q]);
    emitSwap(math, result.values[p], result.values[q], ascending);
    emitSwapColumns(math, result.vectors, 3, p, q, ascending);
  }
  for (Value &value : result.values)
    value = math.mul(value, scale);
  return result;
}

//===----------------------------------------------------------------------===//
// Polar decomposition and SVD
//===----------------------------------------------------------------------===//

/// A point multiplied by a power of two where its squares would over- or
/// underflow, and its distance from the origin. Almost all points take the same
/// arm of the branch: selects before the root instead would cost a tenth of a
/// step of MLS-MPM.
static std::array<Value, 3> emitScaledPoint(ScalarMath &math, Value x,
                                            Value y) {
  Type type = x.getType();
  Value square = math.add(math.mul(x, x), math.mul(y, y));
  if (!type.isF32() && !type.isF64())
    return {x, y, math.sqrt(square)};
  bool isDouble = type.isF64();
  auto power = [&](ScalarMath &at, int exponent) {
    return at.constant(type, std::ldexp(1.0, exponent));
  };
  int limit = isDouble ? 960 : 100, factor = isDouble ? 600 : 100;
  OpBuilder &builder = math.getBuilder();
  // This condition is false if `square` is NaN.
  Value isInRange = arith::AndIOp::create(
      builder, math.getLoc(), math.lessOrEqual(power(math, -limit), square),
      math.lessOrEqual(square, power(math, limit)));
  auto branch = scf::IfOp::create(
      builder, math.getLoc(), isInRange,
      [&](OpBuilder &inside, Location loc) {
        Value length = ScalarMath(inside, loc).sqrt(square);
        scf::YieldOp::create(inside, loc, {x, y, length});
      },
      [&](OpBuilder &inside, Location loc) {
        ScalarMath rare(inside, loc);
        Value scale = rare.select(rare.less(square, power(rare, -limit)),
                                  power(rare, factor), power(rare, -factor));
        Value u = rare.mul(x, scale), v = rare.mul(y, scale);
        Value length = rare.sqrt(rare.add(rare.mul(u, u), rare.mul(v, v)));
        scf::YieldOp::create(inside, loc, {u, v, length});
      });
  return {branch.getResult(0), branch.getResult(1), branch.getResult(2)};
}

/// Emits the rotation nearest to a 2×2 matrix, in closed form.
static Components emitRotation2(ScalarMath &math, ArrayRef<Value> a) {
  Type type = a[0].getType();
  auto [x, y, length] =
      emitScaledPoint(math, math.add(a[0], a[3]), math.sub(a[2], a[1]));
  Value zero = math.constant(type, 0), one = math.constant(type, 1);
  // A reflection has no nearest rotation; the identity is as near as any other.
  Value none = math.equal(length, zero);
  Value inverse = math.div(one, math.select(none, one, length));
  Value c = math.mul(math.select(none, one, x), inverse);
  Value s = math.mul(math.select(none, zero, y), inverse);
  return {c, math.neg(s), s, c};
}

/// Emits a unit vector perpendicular to `u`, continuous in `u` almost
/// everywhere.
static Components emitPerpendicular(ScalarMath &math, ArrayRef<Value> u) {
  Type type = u[0].getType();
  Value zero = math.constant(type, 0);
  // The vector is perpendicular to u and to a coordinate axis that is far from
  // u.
  Value small = math.less(math.abs(u[0]), math.constant(type, 0.6));
  Components candidate = {math.select(small, zero, math.neg(u[2])),
                          math.select(small, u[2], zero),
                          math.select(small, math.neg(u[1]), u[0])};
  Value length = math.sqrt(math.dot(candidate, candidate));
  for (Value &x : candidate)
    x = math.div(x, length);
  return candidate;
}

static Components getColumn(ArrayRef<Value> matrix, unsigned column) {
  return {matrix[column], matrix[3 + column], matrix[6 + column]};
}

/// Emits the singular value decomposition of a 3×3 matrix by one-sided Jacobi:
/// rotations from the right make the columns of A orthogonal. The result is U
/// Σ, and the product of the rotations is V.
static Svd emitSvd3(ScalarMath &math, ArrayRef<Value> a) {
  Type type = a[0].getType();
  Value zero = math.constant(type, 0), one = math.constant(type, 1);
  Value scale, empty;
  Components state = emitScaled(math, a, scale, empty);
  llvm::append_range(state, emitIdentity(math, type, 3));
  state = emitSweeps(
      math, state, [](ScalarMath &inside, MutableArrayRef<Value> values) {
        for (auto [p, q] : kPairs) {
          Components x = getColumn(values, p), y = getColumn(values, q);
          Rotation rotation = emitRotation(inside, inside.dot(x, x),
                                           inside.dot(x, y), inside.dot(y, y));
          emitRotateColumns(inside, values.take_front(9), 3, p, q, rotation);
          emitRotateColumns(inside, values.drop_front(9), 3, p, q, rotation);
        }
      });
  Components b(state.begin(), state.begin() + 9);
  Svd result;
  result.v.assign(state.begin() + 9, state.end());
  Components squares;
  for (unsigned i = 0; i != 3; ++i)
    squares.push_back(math.dot(getColumn(b, i), getColumn(b, i)));
  for (auto [p, q] : {std::pair(0, 1), std::pair(1, 2), std::pair(0, 1)}) {
    Value ascending = math.less(squares[p], squares[q]);
    emitSwap(math, squares[p], squares[q], ascending);
    emitSwapColumns(math, b, 3, p, q, ascending);
    emitSwapColumns(math, result.v, 3, p, q, ascending);
  }

  // The columns give U, largest first. In place of a column too small to have a
  // direction, U gets one that completes the rotation.
  Components b0 = getColumn(b, 0), b1 = getColumn(b, 1), b2 = getColumn(b, 2);
  Value sigma0 = math.sqrt(squares[0]);
  Components u0 = {math.select(empty, one, math.div(b0[0], sigma0)),
                   math.select(empty, zero, math.div(b0[1], sigma0)),
                   math.select(empty, zero, math.div(b0[2], sigma0))};
  Value along = math.dot(u0, b1);
  Components across;
  for (unsigned i = 0; i != 3; ++i)
    across.push_back(math.sub(b1[i], math.mul(along, u0[i])));
  Value length = math.sqrt(math.dot(across, across));
  bool isDouble = type.getIntOrFloatBitWidth() > 32;
  Value tiny = math.less(
      length, math.mul(sigma0, math.constant(type, isDouble ? 1e-15 : 1e-6)));
  tiny = arith::OrIOp::create(math.getBuilder(), math.getLoc(), tiny, empty);
  Components other = emitPerpendicular(math, u0);
  Components u1;
  for (unsigned i = 0; i != 3; ++i)
    u1.push_back(math.select(
        tiny, other[i], math.div(across[i], math.select(tiny, one, length))));
  Components u2 = math.cross(u0, u1);

  for (unsigned i = 0; i != 3; ++i)
    llvm::append_range(result.u, Components{u0[i], u1[i], u2[i]});
  // The last singular value has the sign of the determinant. The second value
  // can be negative only by rounding.
  result.sigma = {math.mul(sigma0, scale), math.mul(math.dot(u1, b1), scale),
                  math.mul(math.dot(u2, b2), scale)};
  return result;
}

Svd tai::emitSvd(ScalarMath &math, ArrayRef<Value> a, unsigned n) {
  if (n == 3)
    return emitSvd3(math, a);
  // With A = R S, R a rotation and S = V Σ Vᵀ, the factor U is R V.
  Components rotation = emitRotation2(math, a);
  Components stretch = math.product(math.transpose(rotation, 2, 2), a, 2, 2, 2);
  SymEig eig = emitSymEig(math, stretch, 2);
  return {math.product(rotation, eig.vectors, 2, 2, 2), eig.values,
          eig.vectors};
}

Polar tai::emitPolar(ScalarMath &math, ArrayRef<Value> a, unsigned n) {
  if (n == 2) {
    Components rotation = emitRotation2(math, a);
    Components stretch =
        math.product(math.transpose(rotation, 2, 2), a, 2, 2, 2);
    // Symmetric but for rounding.
    stretch[1] = stretch[2] = math.mul(math.constant(a[0].getType(), 0.5),
                                       math.add(stretch[1], stretch[2]));
    return {rotation, stretch};
  }
  Svd svd = emitSvd3(math, a);
  Components scaled;
  for (unsigned i = 0; i != 9; ++i)
    scaled.push_back(math.mul(svd.v[i], svd.sigma[i % 3]));
  Components transposed = math.transpose(svd.v, 3, 3);
  return {math.product(svd.u, transposed, 3, 3, 3),
          math.product(scaled, transposed, 3, 3, 3)};
}
