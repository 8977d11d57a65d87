//===- VersionExtents.cpp - Versions of a loop for whole fields -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `for i in range(m)`, with an argument m, mostly visits all of a field whose
// size is constant. A version for the m at which the loop just reaches the end
// of the fields has constant bounds, and in it m is a constant in indices, too:
// later passes gather its additions and give it an interior.
//
//===----------------------------------------------------------------------===//

#include "VersionRemarks.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Analysis/Index/IndexBuilder.h"
#include "tai/Analysis/Index/IndexShift.h"
#include "tai/Analysis/IndexBounds.h"
#include "tai/Analysis/Reductions/ReductionPlan.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"
#include "llvm/ADT/MapVector.h"

namespace mlir::tai {
#define GEN_PASS_DEF_VERSIONEXTENTS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// Arguments of the kernel, and the number that each of them has in the
/// version.
using KnownSizes = llvm::MapVector<Value, int64_t>;

/// Returns the only kernel argument from which an integer outside of the loop
/// is computed.
static Value getOnlyVariable(Value value, Region &kernel) {
  SmallVector<Value> variables;
  if (!value.getType().isIntOrIndex() || matchPattern(value, m_Constant()) ||
      !collectIndexVariables(value, kernel, variables))
    return {};
  return variables.size() == 1 ? variables.front() : Value();
}

/// Returns the bound above which an index of the loop leaves a field: the least
/// bound over all accesses at a shift of the index.
static std::optional<int64_t> getEnd(ParallelForOp loop, Value iv) {
  std::optional<int64_t> end;
  loop.getBody().walk([&](Operation *op) {
    auto access = dyn_cast<FieldAccessOpInterface>(op);
    if (!access || !access.isElementAccess())
      return;
    FailureOr<FieldLayout> layout =
        getFieldLayout(lookupField(op, access.getFieldAttr()));
    if (failed(layout))
      return;
    for (auto [dimension, index] : llvm::enumerate(access.getIndices())) {
      IndexExpr shift = getIndexExpr(index);
      shift.add(IndexExpr(iv), -1);
      if (!shift.isConstant() || !shift.isExact())
        continue;
      int64_t here =
          layout->offset[dimension] + layout->shape[dimension] - shift.constant;
      end = end ? std::min(*end, here) : here;
    }
  });
  return end;
}

/// The argument values at which the loop reaches the end of fields along each
/// dimension whose bound depends on the launch.
static std::optional<KnownSizes> findSizes(ParallelForOp loop, Region &kernel) {
  KnownSizes sizes;
  for (auto [iv, lower, upper] :
       llvm::zip(loop.getInductionVars(), loop.getLowerBounds(),
                 loop.getUpperBounds())) {
    if (!matchPattern(lower, m_Constant()))
      return std::nullopt;
    if (matchPattern(upper, m_Constant()))
      continue;
    Value size = getOnlyVariable(upper, kernel);
    std::optional<int64_t> end = size ? getEnd(loop, iv) : std::nullopt;
    std::optional<int64_t> there =
        end ? evaluateIndex(upper, size, *end) : std::nullopt;
    if (!there)
      return std::nullopt;
    int64_t wanted = *end - (*there - *end);
    if (evaluateIndex(upper, size, wanted) != end)
      return std::nullopt;
    if (sizes.insert({size, wanted}).first->second != wanted)
      return std::nullopt;
  }
  return sizes;
}

/// Returns the number that `value` has in the version for known sizes, if it is
/// known there.
static std::optional<int64_t> evaluate(Value value, Region &kernel,
                                       const KnownSizes &sizes) {
  Value size = getOnlyVariable(value, kernel);
  const auto *known = size ? sizes.find(size) : sizes.end();
  if (known == sizes.end())
    return std::nullopt;
  return evaluateIndex(value, size, known->second);
}

/// True if constants in place of sizes may help: iterations add to elements
/// other than their own, or the body computes with a size.
static bool canGain(ParallelForOp loop, Region &kernel,
                    const KnownSizes &sizes) {
  WalkResult result = loop.getBody().walk([&](Operation *op) {
    for (Value operand : op->getOperands())
      if (loop.isDefinedOutsideOfLoop(operand) &&
          evaluate(operand, kernel, sizes))
        return WalkResult::interrupt();
    auto atomic = dyn_cast<AtomicOp>(op);
    if (!atomic || atomic.getExclusive() ||
        !isa<FloatType>(getElementTypeOrSelf(atomic.getValue().getType())))
      return WalkResult::advance();
    for (Value index : atomic.getIndices()) {
      SmallVector<Value> variables;
      if (collectIndexVariables(index, loop.getBody(), variables) &&
          !variables.empty() &&
          !llvm::is_contained(loop.getInductionVars(), index))
        return WalkResult::interrupt();
    }
    return WalkResult::advance();
  });
  return result.wasInterrupted();
}

static void version(ParallelForOp loop, Region &kernel,
                    const KnownSizes &sizes) {
  ImplicitLocOpBuilder b(loop.getLoc(), loop);
  Value isWhole;
  for (auto [size, number] : sizes) {
    Value wanted =
        arith::ConstantOp::create(b, b.getIntegerAttr(size.getType(), number));
    Value isEqual =
        arith::CmpIOp::create(b, arith::CmpIPredicate::eq, size, wanted);
    isWhole = isWhole ? arith::AndIOp::create(b, isWhole, isEqual).getResult()
                      : isEqual;
  }
  auto branch = scf::IfOp::create(b, isWhole, /*withElseRegion=*/true);
  b.setInsertionPointToStart(branch.thenBlock());
  auto whole = cast<ParallelForOp>(b.clone(*loop));
  b.setInsertionPoint(whole);
  whole->walk([&](Operation *op) {
    for (OpOperand &operand : op->getOpOperands()) {
      if (!whole.isDefinedOutsideOfLoop(operand.get()))
        continue;
      if (std::optional<int64_t> number =
              evaluate(operand.get(), kernel, sizes))
        operand.set(arith::ConstantOp::create(
            b, b.getIntegerAttr(operand.get().getType(), *number)));
    }
  });
  loop->moveBefore(branch.elseBlock(), branch.elseBlock()->begin());
}

namespace {
struct VersionExtents : tai::impl::VersionExtentsBase<VersionExtents> {
  using Base::Base;

  void runOnOperation() override {
    SmallVector<ParallelForOp> loops;
    getOperation()->walk<WalkOrder::PreOrder>([&](ParallelForOp loop) {
      loops.push_back(loop);
      return WalkResult::skip();
    });
    for (ParallelForOp loop : loops) {
      // Loops with sums of a common order are left alone, because another
      // target would add their terms in another order.
      if (loop.getSerialize() || loop.getInOrder() || loop.isStructFor() ||
          checksIndices(loop) || hasCommonOrder(loop))
        continue;
      int64_t ops = 0;
      loop.getBody().walk([&](Operation *) { ++ops; });
      if (ops > maxOps)
        continue;
      Region &kernel =
          loop->getParentOfType<FunctionOpInterface>().getFunctionBody();
      std::optional<KnownSizes> sizes = findSizes(loop, kernel);
      if (sizes && !sizes->empty() && canGain(loop, kernel, *sizes)) {
        reportVersions(loop, "arguments that are extents of fields");
        version(loop, kernel, *sizes);
      }
    }
  }
};
} // namespace
