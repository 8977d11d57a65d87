//===- Decompositions.cpp - Determinants, eigenvalues ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Decompositions.h"
#include "llvm/ADT/STLExtras.h"
#include "llvm/ADT/Sequence.h"
#include <cmath>

using namespace mlir;
using namespace mlir::tai::interpreter;

using Matrix = SmallVector<long double>;

long double mlir::tai::interpreter::cofactor(ArrayRef<long double> matrix,
                                             int64_t n, int64_t row,
                                             int64_t column) {
  Matrix minor;
  for (int64_t i = 0; i != n; ++i)
    for (int64_t j = 0; j != n; ++j)
      if (i != row && j != column)
        minor.push_back(matrix[i * n + j]);
  long double value = determinant(minor, n - 1);
  return (row + column) % 2 ? -value : value;
}

long double mlir::tai::interpreter::determinant(ArrayRef<long double> matrix,
                                                int64_t n) {
  if (n == 0)
    return 1;
  long double sum = 0;
  for (int64_t j = 0; j != n; ++j)
    sum += matrix[j] * cofactor(matrix, n, 0, j);
  return sum;
}

/// Turns columns p and q of a matrix by the angle of the given sine and cosine.
static void rotate(Matrix &matrix, int64_t n, int64_t p, int64_t q,
                   long double cosine, long double sine) {
  for (int64_t i = 0; i != n; ++i) {
    long double a = matrix[i * n + p], b = matrix[i * n + q];
    matrix[i * n + p] = cosine * a - sine * b;
    matrix[i * n + q] = sine * a + cosine * b;
  }
}

static void swapColumns(Matrix &matrix, int64_t n, int64_t p, int64_t q) {
  for (int64_t i = 0; i != n; ++i)
    std::swap(matrix[i * n + p], matrix[i * n + q]);
}

static void negateColumn(Matrix &matrix, int64_t n, int64_t p) {
  for (int64_t i = 0; i != n; ++i)
    matrix[i * n + p] = -matrix[i * n + p];
}

static Matrix identity(int64_t n) {
  Matrix result(n * n, 0);
  for (int64_t i = 0; i != n; ++i)
    result[i * n + i] = 1;
  return result;
}

/// Computes the rotation after which columns with squares a, c and product b
/// are orthogonal.
static std::pair<long double, long double>
findRotation(long double a, long double b, long double c) {
  if (b == 0)
    return {1, 0};
  long double tau = (c - a) / (2 * b);
  long double tangent =
      (tau >= 0 ? 1 : -1) / (std::abs(tau) + std::sqrt(1 + tau * tau));
  long double cosine = 1 / std::sqrt(1 + tangent * tangent);
  return {cosine, tangent * cosine};
}

/// Sorts the singular values into descending order, together with their
/// columns.
static void sortColumns(Decomposition &parts, int64_t n) {
  for (int64_t i = 0; i != n; ++i)
    for (int64_t j = i + 1; j != n; ++j)
      if (parts.values[j] > parts.values[i]) {
        std::swap(parts.values[i], parts.values[j]);
        swapColumns(parts.right, n, i, j);
        if (!parts.left.empty())
          swapColumns(parts.left, n, i, j);
      }
}

Decomposition
mlir::tai::interpreter::decomposeSymmetric(ArrayRef<long double> matrix,
                                           int64_t n) {
  Matrix a(matrix);
  Decomposition parts{{}, Matrix(n), identity(n)};
  auto transpose = [&] {
    for (int64_t i = 0; i != n; ++i)
      for (int64_t j = i + 1; j != n; ++j)
        std::swap(a[i * n + j], a[j * n + i]);
  };
  for (int sweep = 0; sweep != 64; ++sweep)
    for (int64_t p = 0; p != n; ++p)
      for (int64_t q = p + 1; q != n; ++q) {
        auto [cosine, sine] =
            findRotation(a[p * n + p], a[p * n + q], a[q * n + q]);
        // Jᵀ A J.
        rotate(a, n, p, q, cosine, sine);
        transpose();
        rotate(a, n, p, q, cosine, sine);
        transpose();
        rotate(parts.right, n, p, q, cosine, sine);
      }
  for (int64_t i = 0; i != n; ++i)
    parts.values[i] = a[i * n + i];
  sortColumns(parts, n);
  return parts;
}

Decomposition
mlir::tai::interpreter::decomposeSingular(ArrayRef<long double> matrix,
                                          int64_t n) {
  // Rotations from the right make the columns of A orthogonal: A V = U Σ.
  Decomposition parts{Matrix(matrix), Matrix(n), identity(n)};
  auto dot = [&](int64_t p, int64_t q) {
    long double sum = 0;
    for (int64_t i = 0; i != n; ++i)
      sum += parts.left[i * n + p] * parts.left[i * n + q];
    return sum;
  };
  for (int sweep = 0; sweep != 64; ++sweep)
    for (int64_t p = 0; p != n; ++p)
      for (int64_t q = p + 1; q != n; ++q) {
        auto [cosine, sine] = findRotation(dot(p, p), dot(p, q), dot(q, q));
        rotate(parts.left, n, p, q, cosine, sine);
        rotate(parts.right, n, p, q, cosine, sine);
      }
  for (int64_t i = 0; i != n; ++i)
    parts.values[i] = std::sqrt(dot(i, i));
  sortColumns(parts, n);
  for (int64_t j = 0; j != n; ++j) {
    if (parts.values[j] > 0) {
      for (int64_t i = 0; i != n; ++i)
        parts.left[i * n + j] /= parts.values[j];
      continue;
    }
    // Any direction orthogonal to the columns before will do, so the coordinate
    // axis is taken whose part orthogonal to these columns is longest.
    Matrix best(n, 0);
    long double longest = 0;
    for (int64_t axis = 0; axis != n; ++axis) {
      Matrix rest(n, 0);
      rest[axis] = 1;
      for (int64_t k = 0; k != j; ++k)
        for (int64_t i = 0; i != n; ++i)
          rest[i] -= parts.left[axis * n + k] * parts.left[i * n + k];
      long double length = 0;
      for (long double x : rest)
        length += x * x;
      if (length > longest) {
        longest = length;
        best = rest;
      }
    }
    for (int64_t i = 0; i != n; ++i)
      parts.left[i * n + j] = best[i] / std::sqrt(longest);
  }
  if (determinant(parts.right, n) < 0) {
    negateColumn(parts.right, n, n - 1);
    negateColumn(parts.left, n, n - 1);
  }
  if (determinant(parts.left, n) < 0) {
    negateColumn(parts.left, n, n - 1);
    parts.values[n - 1] = -parts.values[n - 1];
  }
  return parts;
}
