//===- NonFiniteAdjoints.cpp - Adjoints that may be infinite or NaN -------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "NonFiniteAdjoints.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/Iterators.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/ControlFlowInterfaces.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/Activity.h"
#include "tai/Analysis/DerivativePaths.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

/// True for ops whose partial derivatives are 1, -1, or an absent entry: none
/// of them multiplies an infinite adjoint by zero.
static bool movesOrSums(Operation *op) {
  return isa<arith::AddFOp, arith::SubFOp, arith::NegFOp, arith::ExtFOp,
             arith::TruncFOp, vector::BroadcastOp, vector::ExtractOp,
             vector::FromElementsOp, vector::InsertOp, vector::ShapeCastOp,
             vector::ToElementsOp, SumOp, TransposeOp>(op);
}

//===----------------------------------------------------------------------===//
// Loops and branches
//===----------------------------------------------------------------------===//

/// True if the derivative rule of an op may turn a finite adjoint into an
/// infinite one.
static bool mayMakeInfinite(OpOperand &operand, FloatFacts &facts) {
  Operation *op = operand.getOwner();
  auto isNonFinite = [&](Value value) { return facts.mayBeNonFinite(value); };
  if (movesOrSums(op) ||
      isa<arith::SelectOp, arith::MaximumFOp, arith::MinimumFOp, math::AbsFOp>(
          op))
    return false;
  // The partial derivative of a product by one factor is the other factor.
  if (isa<arith::MulFOp, math::FmaOp, vector::FMAOp>(op)) {
    unsigned number = operand.getOperandNumber();
    return number < 2 && isNonFinite(op->getOperand(1 - number));
  }
  return mayHaveNonFinitePartial(op, facts) ||
         llvm::any_of(op->getOperands(), isNonFinite) ||
         llvm::any_of(op->getResults(), isNonFinite);
}

namespace {
/// Finds the values whose adjoint may be infinite or NaN according to the
/// rules, and which of these values enter or leave a region.
class AdjointFlow {
public:
  AdjointFlow(AdjointBuilder &b, DenseSet<Value> &infinite,
              DenseSet<Value> &undefined)
      : b(b), all{{}, {}}, handedOn{&infinite, &undefined} {}

  /// Walks over the function once, from its end to its beginning. True if the
  /// walk has found more values whose adjoint may be non-finite.
  bool run(FunctionOpInterface function) {
    grown = false;
    function.walk<WalkOrder::PreOrder, ReverseIterator>(
        [&](Operation *op) { visit(op); });
    return grown;
  }

private:
  enum Kind { Infinite, Undefined };
  void visit(Operation *op);
  void mark(Kind kind, Value value) {
    if (b.isActive(value))
      grown |= all[kind].insert(value).second;
  }
  /// The values `from` are forwarded to `to`, arguments of a region or results
  /// of an op: if the adjoint of a value in `to` may be non-finite, so may the
  /// adjoint of the value in `from`.
  void pass(ValueRange from, ValueRange to) {
    for (auto [source, target] : llvm::zip(from, to))
      for (Kind kind : {Infinite, Undefined})
        if (all[kind].contains(target) && b.isActive(source)) {
          mark(kind, source);
          handedOn[kind]->insert(source);
        }
  }

  AdjointBuilder &b;
  DenseSet<Value> all[2];
  DenseSet<Value> *handedOn[2];
  bool grown = false;
};
} // namespace

void AdjointFlow::visit(Operation *op) {
  if (auto parallel = dyn_cast<scf::ParallelOp>(op)) {
    pass(parallel.getInitVals(), parallel.getResults());
    pass(parallel.getBody()->getTerminator()->getOperands(),
         parallel.getResults());
    return;
  }
  if (auto branch = dyn_cast<RegionBranchOpInterface>(op))
    return forEachForwarding(
        branch, [&](OperandRange from, ValueRange to) { pass(from, to); });
  if (op->hasTrait<OpTrait::IsTerminator>() ||
      llvm::none_of(op->getResults(),
                    [&](Value result) { return b.isActive(result); }))
    return;
  FloatFacts &facts = b.getFacts();
  auto isMarked = [&](Kind kind) {
    return llvm::any_of(op->getResults(), [&](Value result) {
      return all[kind].contains(result);
    });
  };
  bool isInfinite = isMarked(Infinite), isUndefined = isMarked(Undefined);
  for (OpOperand &operand : op->getOpOperands()) {
    if (!b.isActive(operand.get()) || !carriesDerivative(operand))
      continue;
    if (isInfinite || mayMakeInfinite(operand, facts))
      mark(Infinite, operand.get());
    bool isExponent = isa<math::PowFOp>(op) && operand.getOperandNumber() == 1;
    if (isUndefined ||
        (isExponent && !facts.isNonNegative(op->getOperand(0), op)))
      mark(Undefined, operand.get());
  }
}

void NonFiniteAdjoints::propagateMarks(FunctionOpInterface function) {
  WalkResult found = function.walk([](Operation *op) {
    bool handsOn = op->getNumRegions() != 0 && op->getNumResults() != 0;
    return handsOn ? WalkResult::interrupt() : WalkResult::advance();
  });
  if (!b.wantsGuards() || !found.wasInterrupted())
    return;
  AdjointFlow flow(b, mayBeInfinite, mayBeUndefined);
  while (flow.run(function))
    ;
}

//===----------------------------------------------------------------------===//
// Rules
//===----------------------------------------------------------------------===//

void NonFiniteAdjoints::beginRule(Operation *op) {
  current = op;
  seedIsInfinite = {};
  findSeeds(op);
  seedIsUndefined = llvm::any_of(op->getResults(), [&](Value result) {
    return mayBeUndefined.contains(result);
  });
}

void NonFiniteAdjoints::endRule() {
  current = nullptr;
  seeds.clear();
  infiniteSeeds.clear();
  seedIsUndefined = false;
}

void NonFiniteAdjoints::findSeeds(Operation *op) {
  for (Value result : op->getResults())
    if (Value seed = b.getAdjoint(result)) {
      seeds.insert(seed);
      if (mayBeInfinite.contains(result))
        infiniteSeeds.push_back(seed);
    }
}

/// Emits the test whether an incoming adjoint of the current derivative rule is
/// infinite.
Value NonFiniteAdjoints::createInfinityTest() {
  Value any;
  for (Value seed : infiniteSeeds) {
    Value size = math::AbsFOp::create(b, seed);
    if (isa<VectorType>(size.getType()))
      size = b.createSum(size);
    Value infinity = b.createConstant(size.getType(),
                                      std::numeric_limits<double>::infinity());
    Value test =
        arith::CmpFOp::create(b, arith::CmpFPredicate::OEQ, size, infinity);
    any = any ? Value(arith::OrIOp::create(b, any, test)) : test;
  }
  return any;
}

/// Emits the partial derivative by which a rule multiplies: the computation of
/// `contribution`, repeated with 1 in place of the incoming adjoints. Null if
/// more than a few ops, or ops with regions or side effects, compute the
/// contribution.
Value NonFiniteAdjoints::createUnitContribution(Value contribution) {
  SmallVector<Operation *> slice;
  DenseMap<Value, bool> known;
  auto depends = [&](auto &self, Value value) -> bool {
    if (seeds.contains(value))
      return true;
    Operation *op = value.getDefiningOp();
    if (!op || op->getBlock() != b.getInsertionBlock())
      return false;
    if (auto it = known.find(value); it != known.end())
      return it->second;
    bool any = false;
    for (Value operand : op->getOperands())
      any |= self(self, operand);
    known[value] = any;
    if (any && !llvm::is_contained(slice, op))
      slice.push_back(op);
    return any;
  };
  constexpr size_t most = 64;
  if (!depends(depends, contribution) || slice.size() > most ||
      llvm::any_of(slice, [](Operation *op) {
        return op->getNumRegions() != 0 || !isMemoryEffectFree(op);
      }))
    return {};
  IRMapping mapping;
  for (Value seed : seeds)
    mapping.map(seed, b.createConstant(seed.getType(), 1));
  for (Operation *op : slice) {
    Operation *clone = b.clone(*op, mapping);
    SmallVector<Value> folded;
    if (failed(b.tryFold(clone, folded)) || folded.empty())
      continue;
    mapping.map(op->getResults(), folded);
    clone->erase();
  }
  return mapping.lookup(contribution);
}

/// True if `value` is a constant without a component that is zero or NaN.
static bool isNonZeroConstant(Value value) {
  Attribute constant;
  if (!matchPattern(value, m_Constant(&constant)))
    return false;
  auto isNonZero = [](const APFloat &number) {
    return !number.isZero() && !number.isNaN();
  };
  if (auto number = dyn_cast<FloatAttr>(constant))
    return isNonZero(number.getValue());
  auto numbers = dyn_cast<DenseFPElementsAttr>(constant);
  return numbers && llvm::all_of(numbers.getValues<APFloat>(), isNonZero);
}

Value NonFiniteAdjoints::createTagged(Value drops, Value contribution) {
  auto guard = arith::SelectOp::create(
      b, drops, b.createZero(contribution.getType()), contribution);
  guard->setAttr(kInfiniteGuard, b.getUnitAttr());
  return guard;
}

/// Emits the contribution of an infinite adjoint: zero if the partial
/// derivative is zero, instead of the NaN of their product. A partial
/// derivative that is NaN is not replaced.
Value NonFiniteAdjoints::guard(Value value, Value contribution) {
  if (seedIsUndefined)
    mayBeUndefined.insert(value);
  if (infiniteSeeds.empty())
    return contribution;
  mayBeInfinite.insert(value);
  if (movesOrSums(current))
    return contribution;
  Value partial = createUnitContribution(contribution);
  // In an elementwise op whose incoming adjoints are not NaN, a partial that is
  // a number makes a NaN only if it is zero: one test is enough.
  if (partial && !seedIsUndefined &&
      OpTrait::hasElementwiseMappableTraits(current)) {
    if (isNonZeroConstant(partial))
      return contribution;
    Value zero = b.createZero(contribution.getType());
    Value drops =
        arith::CmpFOp::create(b, arith::CmpFPredicate::OEQ, partial, zero);
    return createTagged(drops, contribution);
  }
  if (!seedIsInfinite)
    seedIsInfinite = createInfinityTest();
  auto isOrdered = [&](arith::CmpFPredicate predicate, Value number) {
    return arith::CmpFOp::create(b, predicate, number, number);
  };
  Value isNaN = isOrdered(arith::CmpFPredicate::UNO, contribution);
  if (partial && !matchPattern(partial, m_Constant()))
    isNaN = arith::AndIOp::create(
        b, isNaN, isOrdered(arith::CmpFPredicate::ORD, partial));
  Value infinite = seedIsInfinite;
  if (isa<VectorType>(isNaN.getType()))
    infinite = vector::BroadcastOp::create(b, isNaN.getType(), infinite);
  Value drops = arith::AndIOp::create(b, infinite, isNaN);
  return createTagged(drops, contribution);
}
