//===- ValueShadows.cpp - Adjoints of arguments and results ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The sweep begins with the adjoints of the function's results and ends with
// those of its arguments. Both are in memory of the caller, component by
// component.
//
//===----------------------------------------------------------------------===//

#include "ValueShadows.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/Utils/IndexingUtils.h"

using namespace mlir;
using namespace mlir::tai;

/// Emits the indices, in the memref `shadow`, of the component with row-major
/// number `component`.
static SmallVector<Value> createIndices(AdjointBuilder &b, Value shadow,
                                        int64_t component) {
  ArrayRef<int64_t> shape = cast<MemRefType>(shadow.getType()).getShape();
  return llvm::map_to_vector(
      delinearize(component, computeSuffixProduct(shape)),
      [&](int64_t index) -> Value {
        return arith::ConstantIndexOp::create(b, index);
      });
}

void mlir::tai::seedOutputs(AdjointBuilder &b) {
  const ValueShadows &shadows = b.getPlan().shadows;
  for (auto [output, shadow] :
       llvm::zip(shadows.outputs, shadows.outputShadows)) {
    if (!b.isActive(output))
      continue;
    auto vector = dyn_cast<VectorType>(output.getType());
    SmallVector<Value> parts;
    for (int64_t i = 0, e = vector ? vector.getNumElements() : 1; i != e; ++i)
      parts.push_back(
          memref::LoadOp::create(b, shadow, createIndices(b, shadow, i)));
    b.addAdjoint(output,
                 vector ? b.createVector(vector, parts) : parts.front());
  }
}

void mlir::tai::accumulateInputs(AdjointBuilder &b) {
  const ValueShadows &shadows = b.getPlan().shadows;
  for (auto [input, shadow] : llvm::zip(shadows.inputs, shadows.inputShadows)) {
    Value adjoint = b.getAdjoint(input);
    if (!adjoint)
      continue;
    auto vector = dyn_cast<VectorType>(input.getType());
    for (int64_t i = 0, e = vector ? vector.getNumElements() : 1; i != e; ++i) {
      SmallVector<Value> indices = createIndices(b, shadow, i);
      Value old = memref::LoadOp::create(b, shadow, indices);
      Value part = vector ? b.createExtract(adjoint, i) : adjoint;
      Value sum = arith::AddFOp::create(b, old, part);
      memref::StoreOp::create(b, sum, shadow, indices);
    }
  }
}
