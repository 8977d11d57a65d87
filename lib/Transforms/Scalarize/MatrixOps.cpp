//===- MatrixOps.cpp - Expansion of small matrix ops ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Scalarizer.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

static int64_t getRows(Value matrix) {
  return cast<VectorType>(matrix.getType()).getDimSize(0);
}
static int64_t getColumns(Value matrix) {
  auto type = cast<VectorType>(matrix.getType());
  return type.getRank() == 2 ? type.getDimSize(1) : 1;
}

/// Returns a matrix without one row and one column.
static Components getMinor(ArrayRef<Value> a, unsigned n, unsigned row,
                           unsigned column) {
  Components minor;
  for (unsigned i = 0; i != n; ++i)
    for (unsigned j = 0; j != n; ++j)
      if (i != row && j != column)
        minor.push_back(a[i * n + j]);
  return minor;
}

static Value emitDeterminant(ScalarMath &math, ArrayRef<Value> a, unsigned n) {
  if (n == 1)
    return a[0];
  if (n == 2)
    return math.sub(math.mul(a[0], a[3]), math.mul(a[1], a[2]));
  Value sum;
  for (unsigned j = 0; j != n; ++j) {
    Value term =
        math.mul(a[j], emitDeterminant(math, getMinor(a, n, 0, j), n - 1));
    sum = !sum ? term : j % 2 ? math.sub(sum, term) : math.add(sum, term);
  }
  return sum;
}

/// Emits the cofactors of a matrix, row by row.
static Components emitCofactors(ScalarMath &math, ArrayRef<Value> a,
                                unsigned n) {
  Components cofactors;
  for (unsigned i = 0; i != n; ++i)
    for (unsigned j = 0; j != n; ++j) {
      Value minor = emitDeterminant(math, getMinor(a, n, i, j), n - 1);
      cofactors.push_back((i + j) % 2 ? math.neg(minor) : minor);
    }
  return cofactors;
}

/// Emits the inverse: the adjugate times the reciprocal of the determinant.
static Components emitAdjugateOver(ScalarMath &math, ArrayRef<Value> cofactors,
                                   Value determinant, unsigned n) {
  Value one = math.constant(determinant.getType(), 1);
  Value scale = math.div(one, determinant);
  Components result;
  for (unsigned i = 0; i != n; ++i)
    for (unsigned j = 0; j != n; ++j)
      result.push_back(math.mul(cofactors[j * n + i], scale));
  return result;
}

/// Emits the inverse: adjugate over determinant. The determinant is a product
/// of n entries, and can leave the range of floats where the entries of the
/// inverse do not: for 3×3 matrices in f32 already at entries of 1e-13. Only
/// then is the matrix divided by its largest entry first. Almost all matrices
/// take the same arm of this branch; LLVM is told so, or it would compute both
/// arms for vectors of matrices.
static Components emitInverse(ScalarMath &math, ArrayRef<Value> a, unsigned n) {
  Type type = a[0].getType();
  if (n == 1)
    return {math.div(math.constant(type, 1), a[0])};
  Components cofactors = emitCofactors(math, a, n);
  auto getDeterminant = [n](ScalarMath &at, ArrayRef<Value> matrix,
                            ArrayRef<Value> minors) {
    return at.dot(matrix.take_front(n), minors.take_front(n));
  };
  Value determinant = getDeterminant(math, a, cofactors);
  Components usual = emitAdjugateOver(math, cofactors, determinant, n);
  if (!type.isF32() && !type.isF64())
    return usual;

  OpBuilder &builder = math.getBuilder();
  Value size = math.abs(determinant);
  double bound = type.isF64() ? 0x1p+900 : 0x1p+90;
  Value inRange = arith::AndIOp::create(
      builder, math.getLoc(),
      math.lessOrEqual(math.constant(type, 1 / bound), size),
      math.lessOrEqual(size, math.constant(type, bound)));
  Value likely = arith::ConstantOp::create(builder, math.getLoc(),
                                           builder.getBoolAttr(true));
  inRange = LLVM::ExpectOp::create(builder, math.getLoc(), inRange, likely);
  auto branch = scf::IfOp::create(
      builder, math.getLoc(), inRange,
      [&](OpBuilder &inside, Location loc) {
        scf::YieldOp::create(inside, loc, usual);
      },
      [&](OpBuilder &inside, Location loc) {
        ScalarMath rare(inside, loc);
        Value largest = rare.abs(a[0]);
        for (Value value : a.drop_front())
          largest = rare.max(largest, rare.abs(value));
        // A matrix of zeros has no inverse, however it is scaled.
        Value divisor = rare.select(rare.equal(largest, rare.constant(type, 0)),
                                    rare.constant(type, 1), largest);
        Components scaled;
        for (Value value : a)
          scaled.push_back(rare.div(value, divisor));
        Components minors = emitCofactors(rare, scaled, n);
        Components result = emitAdjugateOver(
            rare, minors, getDeterminant(rare, scaled, minors), n);
        for (Value &value : result)
          value = rare.div(value, divisor);
        scf::YieldOp::create(inside, loc, result);
      });
  return Components(branch.getResults());
}

/// Emits the solution of a linear system by Gaussian elimination with the
/// largest pivot of each column, which keeps the error small where the
/// determinant would cancel. Rows are swapped by selects.
static Components emitSolve(ScalarMath &math, ArrayRef<Value> matrix,
                            ArrayRef<Value> rhs, unsigned n) {
  Components a(matrix), b(rhs);
  for (unsigned k = 0; k != n; ++k) {
    for (unsigned i = k + 1; i != n; ++i) {
      Value larger = math.less(math.abs(a[k * n + k]), math.abs(a[i * n + k]));
      auto swap = [&](Value &x, Value &y) {
        Value first = math.select(larger, y, x);
        y = math.select(larger, x, y);
        x = first;
      };
      for (unsigned j = k; j != n; ++j)
        swap(a[k * n + j], a[i * n + j]);
      swap(b[k], b[i]);
    }
    for (unsigned i = k + 1; i != n; ++i) {
      Value factor = math.div(a[i * n + k], a[k * n + k]);
      for (unsigned j = k + 1; j != n; ++j)
        a[i * n + j] = math.sub(a[i * n + j], math.mul(factor, a[k * n + j]));
      b[i] = math.sub(b[i], math.mul(factor, b[k]));
    }
  }
  for (unsigned k = n; k-- > 0;) {
    for (unsigned j = k + 1; j != n; ++j)
      b[k] = math.sub(b[k], math.mul(a[k * n + j], b[j]));
    b[k] = math.div(b[k], a[k * n + k]);
  }
  return b;
}

/// Emits the norm of a vector. Squares under- and overflow at half the
/// exponents of the type; only then components are scaled by a power of two,
/// which is exact. Almost all vectors take the same arm of this branch, so that
/// it costs little more than its condition.
static Value emitNorm(ScalarMath &math, ArrayRef<Value> values, bool fast) {
  Type type = values[0].getType();
  if (values.size() == 1)
    return math.abs(values[0]);
  Value square = math.dot(values, values);
  if (fast || !(type.isF32() || type.isF64()))
    return math.sqrt(square);
  bool isDouble = type.isF64();
  const llvm::fltSemantics &semantics =
      cast<FloatType>(type).getFloatSemantics();
  Value least = math.constant(type, isDouble ? 0x1p-960 : 0x1p-100);
  Value greatest =
      math.constant(type, APFloat::getLargest(semantics).convertToDouble());
  OpBuilder &builder = math.getBuilder();
  Value inRange = arith::AndIOp::create(builder, math.getLoc(),
                                        math.lessOrEqual(least, square),
                                        math.lessOrEqual(square, greatest));
  auto branch = scf::IfOp::create(
      builder, math.getLoc(), inRange,
      [&](OpBuilder &inside, Location loc) {
        scf::YieldOp::create(inside, loc, ScalarMath(inside, loc).sqrt(square));
      },
      [&](OpBuilder &inside, Location loc) {
        ScalarMath rare(inside, loc);
        Value isSmall = rare.less(square, least);
        auto choose = [&](double small, double large) {
          return rare.select(isSmall, rare.constant(type, small),
                             rare.constant(type, large));
        };
        Value scale =
            isDouble ? choose(0x1p+600, 0x1p-600) : choose(0x1p+100, 0x1p-100);
        Value inverse =
            isDouble ? choose(0x1p-600, 0x1p+600) : choose(0x1p-100, 0x1p+100);
        Components scaled;
        for (Value value : values)
          scaled.push_back(rare.mul(value, scale));
        Value length = rare.sqrt(rare.dot(scaled, scaled));
        scf::YieldOp::create(inside, loc, rare.mul(length, inverse));
      });
  return branch.getResult(0);
}

/// The diagonal matrix of the given values.
static Components emitDiagonal(ScalarMath &math, ArrayRef<Value> values) {
  unsigned n = values.size();
  Value zero = math.constant(values[0].getType(), 0);
  Components result(n * n, zero);
  for (unsigned i = 0; i != n; ++i)
    result[i * n + i] = values[i];
  return result;
}

bool tai::expandMatrixOp(Operation *op, Scalarizer &scalarizer) {
  OpBuilder builder(op);
  ScalarMath math(builder, op->getLoc());
  auto get = [&](Value value) { return scalarizer.get(value); };

  return llvm::TypeSwitch<Operation *, bool>(op)
      .Case([&](MatmulOp matmul) {
        scalarizer.set(matmul.getResult(),
                       math.product(get(matmul.getLhs()), get(matmul.getRhs()),
                                    getRows(matmul.getLhs()),
                                    getColumns(matmul.getLhs()),
                                    getColumns(matmul.getRhs())));
        return true;
      })
      .Case([&](TransposeOp transpose) {
        Value matrix = transpose.getMatrix();
        scalarizer.set(
            transpose.getResult(),
            math.transpose(get(matrix), getRows(matrix), getColumns(matrix)));
        return true;
      })
      .Case([&](DotOp dot) {
        scalarizer.set(dot.getResult(),
                       {math.dot(get(dot.getLhs()), get(dot.getRhs()))});
        return true;
      })
      .Case([&](SumOp sum) {
        Components values = get(sum.getVector());
        Value total = values[0];
        for (Value value : ArrayRef(values).drop_front())
          total = math.add(total, value);
        scalarizer.set(sum.getResult(), {total});
        return true;
      })
      .Case([&](CrossOp cross) {
        scalarizer.set(cross.getResult(),
                       math.cross(get(cross.getLhs()), get(cross.getRhs())));
        return true;
      })
      .Case([&](OuterOp outer) {
        Components a = get(outer.getLhs()), b = get(outer.getRhs()), result;
        for (Value x : a)
          for (Value y : b)
            result.push_back(math.mul(x, y));
        scalarizer.set(outer.getResult(), std::move(result));
        return true;
      })
      .Case([&](NormOp norm) {
        scalarizer.set(norm.getResult(),
                       {emitNorm(math, get(norm.getVector()), norm.getFast())});
        return true;
      })
      .Case([&](TraceOp trace) {
        Components values = get(trace.getMatrix());
        unsigned n = getRows(trace.getMatrix());
        Value total = values[0];
        for (unsigned i = 1; i != n; ++i)
          total = math.add(total, values[i * n + i]);
        scalarizer.set(trace.getResult(), {total});
        return true;
      })
      .Case([&](DeterminantOp determinant) {
        scalarizer.set(determinant.getResult(),
                       {emitDeterminant(math, get(determinant.getMatrix()),
                                        getRows(determinant.getMatrix()))});
        return true;
      })
      .Case([&](InverseOp inverse) {
        scalarizer.set(inverse.getResult(),
                       emitInverse(math, get(inverse.getMatrix()),
                                   getRows(inverse.getMatrix())));
        return true;
      })
      .Case([&](SolveOp solve) {
        scalarizer.set(solve.getResult(),
                       emitSolve(math, get(solve.getMatrix()),
                                 get(solve.getRhs()),
                                 getRows(solve.getMatrix())));
        return true;
      })
      .Case([&](PolarOp polar) {
        Polar result =
            emitPolar(math, get(polar.getMatrix()), getRows(polar.getMatrix()));
        scalarizer.set(polar.getRotation(), std::move(result.rotation));
        scalarizer.set(polar.getStretch(), std::move(result.stretch));
        return true;
      })
      .Case([&](SvdOp svd) {
        Svd result =
            emitSvd(math, get(svd.getMatrix()), getRows(svd.getMatrix()));
        scalarizer.set(svd.getU(), std::move(result.u));
        scalarizer.set(svd.getSigma(), emitDiagonal(math, result.sigma));
        scalarizer.set(svd.getV(), std::move(result.v));
        return true;
      })
      .Case([&](SymEigOp eig) {
        SymEig result =
            emitSymEig(math, get(eig.getMatrix()), getRows(eig.getMatrix()));
        scalarizer.set(eig.getValues(), std::move(result.values));
        scalarizer.set(eig.getVectors(), std::move(result.vectors));
        return true;
      })
      .Default([](Operation *) { return false; });
}
