//===- ExpandAtomics.cpp - Expands exclusive atomics ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An atomic on an element that only one iteration reaches is differentiated as
// a load, an operation and a store. Expanded to these, it needs no rule of its
// own, and its result is the loaded value.
//
//===----------------------------------------------------------------------===//

#include "../SelectedFunctionsPass.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/Transforms/LoopInvariantCodeMotionUtils.h"
#include "tai/AD/Conventions.h"
#include "tai/AD/Passes.h"
#include "tai/AD/Prepare/Selection.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {
#define GEN_PASS_DEF_EXPANDATOMICS
#include "tai/AD/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// The minimum or maximum of `old` and `value` as a compare and a select, in
/// which `value` wins a tie. An op for minimum or maximum would not do: it
/// commutes, and canonicalization makes a constant `old` its second operand, to
/// which a tie gives the derivative. NaN is propagated.
static Value choose(OpBuilder &b, Location loc, arith::CmpFPredicate wins,
                    Value old, Value value) {
  Value stays = arith::CmpFOp::create(b, loc, wins, old, value);
  Value isNaN =
      arith::CmpFOp::create(b, loc, arith::CmpFPredicate::UNO, old, old);
  stays = arith::OrIOp::create(b, loc, stays, isNaN);
  return arith::SelectOp::create(b, loc, stays, old, value);
}

/// Emits the value of the element after the update: `old` combined with
/// `value`. In a tie of minimum and maximum, `value` wins.
static Value combine(OpBuilder &b, AtomicOp atomic, Value old, Value value) {
  Location loc = atomic.getLoc();
  AtomicKind kind = atomic.getKind();
  bool isFloat = isFloatOrVector(value.getType());
  // Under the convention that splits ties in halves, the order of the operands
  // of minimum and maximum does not matter.
  bool isOrdered = isFloat && !Conventions::of(atomic).splitTies;
  switch (kind) {
  case AtomicKind::Add:
    return isFloat ? arith::AddFOp::create(b, loc, old, value).getResult()
                   : arith::AddIOp::create(b, loc, old, value).getResult();
  case AtomicKind::Sub:
    return isFloat ? arith::SubFOp::create(b, loc, old, value).getResult()
                   : arith::SubIOp::create(b, loc, old, value).getResult();
  case AtomicKind::Mul:
    return isFloat ? arith::MulFOp::create(b, loc, old, value).getResult()
                   : arith::MulIOp::create(b, loc, old, value).getResult();
  case AtomicKind::Min:
    if (isOrdered)
      return choose(b, loc, arith::CmpFPredicate::OLT, old, value);
    return isFloat ? arith::MinimumFOp::create(b, loc, old, value).getResult()
                   : arith::MinSIOp::create(b, loc, old, value).getResult();
  case AtomicKind::Max:
    if (isOrdered)
      return choose(b, loc, arith::CmpFPredicate::OGT, old, value);
    return isFloat ? arith::MaximumFOp::create(b, loc, old, value).getResult()
                   : arith::MaxSIOp::create(b, loc, old, value).getResult();
  case AtomicKind::MinU:
    return arith::MinUIOp::create(b, loc, old, value);
  case AtomicKind::MaxU:
    return arith::MaxUIOp::create(b, loc, old, value);
  case AtomicKind::And:
    return arith::AndIOp::create(b, loc, old, value);
  case AtomicKind::Or:
    return arith::OrIOp::create(b, loc, old, value);
  case AtomicKind::Xor:
    return arith::XOrIOp::create(b, loc, old, value);
  }
  llvm_unreachable("unknown kind");
}

static bool hasAdjoint(AtomicOp atomic) {
  FieldOp field = lookupField(atomic, atomic.getFieldAttr());
  return field.getAdjointAttr() && isFloatOrVector(field.getType());
}

static bool isSum(AtomicOp atomic) {
  return atomic.getKind() == AtomicKind::Add ||
         atomic.getKind() == AtomicKind::Sub;
}

static void expand(AtomicOp atomic) {
  OpBuilder builder(atomic);
  Location loc = atomic.getLoc();
  Value value = atomic.getValue();
  Value old =
      LoadOp::create(builder, loc, value.getType(), atomic.getFieldAttr(),
                     atomic.getIndices(), atomic.getComponents());
  Value combined = combine(builder, atomic, old, value);
  StoreOp::create(builder, loc, combined, atomic.getFieldAttr(),
                  atomic.getIndices(), atomic.getComponents());
  atomic.getOld().replaceAllUsesWith(old);
  atomic.erase();
}

/// Replaces an atomic update of a vector by one update for each component.
static void split(AtomicOp atomic) {
  auto type = dyn_cast<VectorType>(atomic.getValue().getType());
  if (!type)
    return;
  OpBuilder builder(atomic);
  Location loc = atomic.getLoc();
  SmallVector<Value> old;
  for (int64_t i = 0, e = type.getNumElements(); i != e; ++i) {
    SmallVector<int64_t> position(type.getRank());
    for (int64_t dim = type.getRank() - 1, rest = i; dim >= 0; --dim) {
      position[dim] = rest % type.getDimSize(dim);
      rest /= type.getDimSize(dim);
    }
    SmallVector<Value> components =
        llvm::map_to_vector(position, [&](int64_t p) -> Value {
          return arith::ConstantIndexOp::create(builder, loc, p);
        });
    Value part =
        vector::ExtractOp::create(builder, loc, atomic.getValue(), position);
    old.push_back(AtomicOp::create(builder, loc, atomic.getKind(), part,
                                   atomic.getFieldAttr(), atomic.getIndices(),
                                   components));
  }
  if (!atomic.getOld().use_empty())
    atomic.getOld().replaceAllUsesWith(
        vector::FromElementsOp::create(builder, loc, type, old));
  atomic.erase();
}

namespace {
struct ExpandAtomics
    : SelectedFunctionsPass<ExpandAtomics, tai::impl::ExpandAtomicsBase> {
  using SelectedFunctionsPass::SelectedFunctionsPass;

  LogicalResult runOnFunction(FunctionOpInterface function) {
    markExclusiveAtomics(function);
    SmallVector<AtomicOp> exclusive, contended;
    function.walk([&](AtomicOp atomic) {
      bool isPlainSum = isSum(atomic) && atomic.getOld().use_empty();
      if (isPlainSum || (!hasAdjoint(atomic) && atomic.getOld().use_empty()))
        return;
      if (atomic.getExclusive())
        exclusive.push_back(atomic);
      else if (!isSum(atomic) && hasAdjoint(atomic))
        contended.push_back(atomic);
    });
    // Indices that are computed outside of the loop show which part of the
    // field a contended atomic updates.
    llvm::SetVector<Operation *> loops;
    for (AtomicOp atomic : contended)
      loops.insert(getEnclosingParallelLoop(atomic));
    llvm::for_each(exclusive, expand);
    llvm::for_each(contended, split);
    for (Operation *loop : loops)
      moveLoopInvariantCode(cast<LoopLikeOpInterface>(loop));
    return success();
  }
};
} // namespace
