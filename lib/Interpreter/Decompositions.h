//===- Decompositions.h - Determinants, eigenvalues -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Linear algebra of small matrices, row-major, by textbook methods.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_INTERPRETER_DECOMPOSITIONS_H
#define TAI_LIB_INTERPRETER_DECOMPOSITIONS_H

#include "mlir/Support/LLVM.h"

namespace mlir::tai::interpreter {

long double determinant(ArrayRef<long double> matrix, int64_t n);
long double cofactor(ArrayRef<long double> matrix, int64_t n, int64_t row,
                     int64_t column);

/// The result of a decomposition: values in descending order, and the
/// corresponding columns of `left` and `right`, whose signs are arbitrary.
struct Decomposition {
  SmallVector<long double> left, values, right;
};

/// Computes the eigenvalues and eigenvectors (in `right`) of a symmetric
/// matrix, by Jacobi's rotations.
Decomposition decomposeSymmetric(ArrayRef<long double> matrix, int64_t n);

/// Computes the singular values of a matrix. The last value is negative if the
/// determinant is, so that `left` and `right` are rotations.
Decomposition decomposeSingular(ArrayRef<long double> matrix, int64_t n);

} // namespace mlir::tai::interpreter

#endif // TAI_LIB_INTERPRETER_DECOMPOSITIONS_H
