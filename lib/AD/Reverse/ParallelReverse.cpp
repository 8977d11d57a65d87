//===- ParallelReverse.cpp - The reverse of a parallel body ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/AD/Reverse/ParallelReverse.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/IR/Matchers.h"

using namespace mlir;
using namespace mlir::tai;

LogicalResult
mlir::tai::reverseParallelBody(AdjointBuilder &b, Operation *loop,
                               Block &primal, Block &mirror,
                               llvm::function_ref<void(Frame &)> begin,
                               llvm::function_ref<void()> terminate) {
  // For each value that the loop body captures from outside: a buffer that sums
  // the adjoints of all iterations, with an element for each component. The
  // lowering of loops keeps such sums in registers; see tai-relax-atomics.
  SmallVector<std::pair<Value, Value>> sums;
  auto end = [&](Frame &frame) {
    // Most captured values come from a few reads. The contributions of each
    // iteration are added to the adjoint fields at once, which the lowering of
    // accumulations does fast and in a fixed order.
    b.sweepCaptured();
    for (auto [value, adjoint] : b.takeCaptured(frame)) {
      Type type = value.getType();
      auto vector = dyn_cast<VectorType>(type);
      int64_t count = vector ? vector.getNumElements() : 1;
      Value buffer;
      {
        OpBuilder::InsertionGuard guard(b);
        b.setInsertionPoint(loop);
        Type element = getElementTypeOrSelf(type);
        buffer = memref::AllocaOp::create(b, MemRefType::get({count}, element));
        Value zero = b.createZero(element);
        for (int64_t i = 0; i != count; ++i)
          memref::StoreOp::create(
              b, zero, buffer,
              ValueRange{arith::ConstantIndexOp::create(b, i)});
      }
      for (int64_t i = 0; i != count; ++i) {
        Value part = vector ? b.createExtract(adjoint, i) : adjoint;
        if (!matchPattern(part, m_AnyZeroFloat()))
          memref::AtomicRMWOp::create(
              b, arith::AtomicRMWKind::addf, part, buffer,
              ValueRange{arith::ConstantIndexOp::create(b, i)});
      }
      sums.emplace_back(value, buffer);
    }
    terminate();
  };
  LogicalResult result = b.reverseBlock(&primal, &mirror, begin, end);
  b.setInsertionPointAfter(loop);
  for (auto [value, buffer] : sums) {
    auto type = cast<MemRefType>(buffer.getType());
    SmallVector<Value> components;
    for (int64_t i = 0; i != type.getDimSize(0); ++i)
      components.push_back(memref::LoadOp::create(
          b, buffer, ValueRange{arith::ConstantIndexOp::create(b, i)}));
    auto vector = dyn_cast<VectorType>(value.getType());
    b.addAdjoint(value, vector ? b.createVector(vector, components)
                               : components.front());
  }
  return result;
}
