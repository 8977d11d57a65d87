//===- Scalarizer.h - Splits vectors into scalars ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_SCALARIZE_SCALARIZER_H
#define TAI_LIB_TRANSFORMS_SCALARIZE_SCALARIZER_H

#include "ScalarMath.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// Replaces all vectors of one function by their components, in one forward
/// walk: when an op is reached, its operands already have components. Replaced
/// ops are erased together at the end.
class Scalarizer {
public:
  explicit Scalarizer(FunctionOpInterface function) : function(function) {}

  LogicalResult run();

  /// Returns the components of a vector, or the scalar itself.
  Components get(Value value);
  /// Sets the components that stand for a vector result.
  void set(Value result, Components components);

  /// Returns an index constant at the top of the function.
  Value index(int64_t value);

private:
  LogicalResult processBlock(Block &block);
  LogicalResult process(Operation *op);
  LogicalResult processStructure(Operation *op);
  LogicalResult processBoundary(Operation *op);
  LogicalResult processAccess(Operation *op);
  void processLocal(Operation *op);
  void processMessage(Operation *op);
  void processElementwise(Operation *op);
  LogicalResult processArrayAccess(Operation *op);

  /// Returns the component indices of a row-major position in an element of the
  /// given type.
  Components indicesOf(VectorType type, int64_t position);
  void expandArguments(Block &block);
  LogicalResult verify();

  FunctionOpInterface function;
  llvm::DenseMap<Value, Components> parts;
  llvm::DenseMap<int64_t, Value> indexConstants;
  SmallVector<Operation *> dead;
  SmallVector<BlockArgument> deadArguments;
};

/// Replaces comparisons of norms and roots with constants by comparisons of
/// their squares, if this has the same results.
void compareSquares(FunctionOpInterface function);

/// Expands an op of the vector dialect; nullopt if it is not supported.
std::optional<LogicalResult> expandVectorOp(Operation *op,
                                            Scalarizer &scalarizer);

/// Expands an op of the tai dialect on small matrices; false for other ops.
bool expandMatrixOp(Operation *op, Scalarizer &scalarizer);

/// Emit the decompositions of an n×n matrix (n is 2 or 3), given by its
/// components.
struct Svd {
  Components u, sigma, v; // sigma: the n values
};
Svd emitSvd(ScalarMath &math, ArrayRef<Value> matrix, unsigned n);
struct Polar {
  Components rotation, stretch;
};
Polar emitPolar(ScalarMath &math, ArrayRef<Value> matrix, unsigned n);
struct SymEig {
  Components values, vectors;
};
SymEig emitSymEig(ScalarMath &math, ArrayRef<Value> matrix, unsigned n);

/// Splits each append in a function into the activation of a cell and a store
/// to it.
LogicalResult expandAppends(FunctionOpInterface function);

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_SCALARIZE_SCALARIZER_H
