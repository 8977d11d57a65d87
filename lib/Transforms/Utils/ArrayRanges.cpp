//===- ArrayRanges.cpp - Arrays that overlap ------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Transforms/Utils/ArrayRanges.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/IterationOrder.h"
#include "tai/Interfaces/Differentiable.h"

using namespace mlir;
using namespace mlir::tai;

/// The most arrays that are tested for overlap.
constexpr unsigned kMaxArrays = 12;

std::optional<LoopArrays> LoopArrays::collect(ParallelForOp loop) {
  LoopArrays arrays;
  Region &kernel =
      loop->getParentOfType<FunctionOpInterface>().getFunctionBody();
  WalkResult result = loop.getBody().walk([&](Operation *op) {
    if (auto access = dyn_cast<DifferentiableAccessInterface>(op)) {
      Value array = access.getAccessedStorage().memref;
      if (!array)
        return WalkResult::advance();
      auto argument = dyn_cast<BlockArgument>(array);
      if (!argument || argument.getOwner() != &kernel.front() ||
          !cast<MemRefType>(array.getType()).getLayout().isIdentity() ||
          !cast<MemRefType>(array.getType()).getElementType().isIntOrFloat())
        return WalkResult::interrupt();
      arrays.all.insert(array);
      if (access.getAccessKind() != AccessKind::Read)
        arrays.written.insert(array);
      return WalkResult::advance();
    }
    bool isKnown =
        op->hasTrait<OpTrait::HasRecursiveMemoryEffects>() ||
        isMemoryEffectFree(op) ||
        isa<AllocaOp, LocalLoadOp, LocalStoreOp, AssertOp, PrintOp, RandomOp>(
            op);
    return isKnown ? WalkResult::advance() : WalkResult::interrupt();
  });
  if (result.wasInterrupted() || arrays.all.size() > kMaxArrays)
    return std::nullopt;
  return arrays;
}

Value tai::createBoth(ImplicitLocOpBuilder &b, Value lhs, Value rhs) {
  if (!lhs || !rhs)
    return lhs ? lhs : rhs;
  return arith::AndIOp::create(b, lhs, rhs);
}

Value LoopArrays::createTest(ImplicitLocOpBuilder &b,
                             ParallelForOp loop) const {
  if (loop->hasAttr(kApartAttrName) || written.empty())
    return {};
  SmallVector<std::pair<Value, Value>> ranges;
  for (Value array : all) {
    auto type = cast<MemRefType>(array.getType());
    Value bytes = arith::ConstantIndexOp::create(
        b, llvm::divideCeil(type.getElementType().getIntOrFloatBitWidth(), 8));
    for (int64_t d = 0; d != type.getRank(); ++d)
      bytes =
          arith::MulIOp::create(b, bytes, memref::DimOp::create(b, array, d));
    auto toInteger = [&](Value value) -> Value {
      return arith::IndexCastOp::create(b, b.getI64Type(), value);
    };
    Value begin =
        toInteger(memref::ExtractAlignedPointerAsIndexOp::create(b, array));
    ranges.emplace_back(begin,
                        arith::AddIOp::create(b, begin, toInteger(bytes)));
  }
  auto isBefore = [&](unsigned i, unsigned j) -> Value {
    return arith::CmpIOp::create(b, arith::CmpIPredicate::ule, ranges[i].second,
                                 ranges[j].first);
  };
  Value test;
  for (unsigned i = 0; i != ranges.size(); ++i)
    for (unsigned j = i + 1; j != ranges.size(); ++j)
      if (written.contains(all[i]) || written.contains(all[j]))
        test = createBoth(
            b, test, arith::OrIOp::create(b, isBefore(i, j), isBefore(j, i)));
  return test;
}

Value RangeEnds::getIndex(ImplicitLocOpBuilder &b, Value number) const {
  Value isFirst =
      arith::CmpIOp::create(b, arith::CmpIPredicate::slt, number,
                            arith::ConstantIndexOp::create(b, width));
  Value rest = arith::AddIOp::create(b, second,
                                     arith::ConstantIndexOp::create(b, -width));
  return arith::AddIOp::create(
      b, number, arith::SelectOp::create(b, isFirst, first, rest));
}
