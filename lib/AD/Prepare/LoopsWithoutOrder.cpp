//===- LoopsWithoutOrder.cpp - Stores of loops without an order -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// If several iterations of `scf.parallel` store to one element, any of their
// values may remain, and the gradient would be that of an arbitrary one.
//
//===----------------------------------------------------------------------===//

#include "LoopsWithoutOrder.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/IR/Matchers.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Index/IndexBuilder.h"
#include "tai/Analysis/Index/IndexQueries.h"
#include "llvm/ADT/MapVector.h"

using namespace mlir;
using namespace mlir::tai;

/// Returns the dimensions in which the loop may have more than one iteration.
static SmallVector<Value> getMovingDimensions(scf::ParallelOp loop) {
  SmallVector<Value> moving;
  for (auto [iv, lower, upper, step] :
       llvm::zip(loop.getInductionVars(), loop.getLowerBound(),
                 loop.getUpperBound(), loop.getStep())) {
    std::optional<int64_t> from = getConstantIntValue(lower),
                           to = getConstantIntValue(upper),
                           by = getConstantIntValue(step);
    if (!from || !to || !by || *to - *from > *by)
      moving.push_back(iv);
  }
  return moving;
}

namespace {
/// A product of an index of the loop and a size that the loop does not change.
struct SizedDigit {
  Value iv;
  IndexExpr size;
};
} // namespace

static std::optional<SizedDigit> matchSizedDigit(scf::ParallelOp loop,
                                                 const IndexAtom &atom) {
  const IndexNode *node = atom.getNode();
  if (!node || node->kind != IndexNode::Kind::Product)
    return std::nullopt;
  for (auto [index, size] :
       {std::pair(node->lhs, node->rhs), std::pair(node->rhs, node->lhs)})
    for (Value iv : loop.getInductionVars())
      if (index == IndexExpr(iv) && size.isExact() &&
          size.allOf(
              [&](Value value) { return loop.isDefinedOutsideOfLoop(value); }))
        return SizedDigit{iv, size};
  return std::nullopt;
}

/// True if `iv` counts from zero to `size`, with a positive step.
static bool countsTo(scf::ParallelOp loop, Value iv, const IndexExpr &size) {
  for (auto [own, lower, upper, step] :
       llvm::zip(loop.getInductionVars(), loop.getLowerBound(),
                 loop.getUpperBound(), loop.getStep()))
    if (own == iv)
      return getIndexExpr(upper) == size && isConstantIntValue(lower, 0) &&
             getConstantIntValue(step).value_or(0) > 0;
  return false;
}

/// True if `digits`, indices of the loop, are the digits of `index`: a step of
/// one of them moves it further than all those with smaller factors together.
static bool areDigits(scf::ParallelOp loop, const IndexExpr &index,
                      ArrayRef<Value> digits) {
  // Pairs of the distance of one step, and the distance from the first
  // iteration to the last, or none if that is not known.
  SmallVector<std::pair<int64_t, std::optional<int64_t>>> moves;
  constexpr int64_t most = int64_t(1) << 30;
  for (auto [iv, lower, upper, step] :
       llvm::zip(loop.getInductionVars(), loop.getLowerBound(),
                 loop.getUpperBound(), loop.getStep())) {
    if (!llvm::is_contained(digits, iv))
      continue;
    std::optional<int64_t> from = getConstantIntValue(lower),
                           to = getConstantIntValue(upper),
                           by = getConstantIntValue(step);
    int64_t factor = std::abs(index.getCoefficient(iv));
    if (factor == 0 || factor > most || !by || *by <= 0 || *by > most)
      return false;
    std::optional<int64_t> reach;
    if (from && to && *to > *from && *to - *from <= most)
      reach = (*to - *from - 1) / *by * *by * factor;
    moves.emplace_back(*by * factor, reach);
  }
  llvm::sort(moves, llvm::less_first());
  int64_t below = 0;
  for (auto [i, pair] : llvm::enumerate(moves)) {
    auto [move, reach] = pair;
    if (move <= below)
      return false;
    // Only the first digit may be of any size.
    if (!reach)
      return i + 1 == moves.size();
    if (*reach > most - below)
      return false;
    below += *reach;
  }
  return true;
}

/// Returns the indices of the loop that `index` determines, as its digits.
/// Blocks of a size that is not known are digits, too: i * n + j with j < n.
static SmallVector<Value> findDigits(scf::ParallelOp loop,
                                     const IndexExpr &index,
                                     ArrayRef<Value> moving) {
  if (!index.isExact())
    return {};
  SmallVector<Value> digits;
  std::optional<SizedDigit> block;
  for (const auto &[atom, factor] : index.terms) {
    Value value = atom.getValue();
    if (value && llvm::is_contained(moving, value)) {
      digits.push_back(value);
      continue;
    }
    if (atom.allOf(
            [&](Value value) { return loop.isDefinedOutsideOfLoop(value); }))
      continue;
    std::optional<SizedDigit> sized = matchSizedDigit(loop, atom);
    if (!sized || block || std::abs(factor) != 1)
      return {};
    block = sized;
  }
  if (!block)
    return areDigits(loop, index, digits) ? digits : SmallVector<Value>();
  if (digits.size() != 1 || digits.front() == block->iv ||
      std::abs(index.getCoefficient(digits.front())) != 1 ||
      !countsTo(loop, digits.front(), block->size))
    return {};
  return {digits.front(), block->iv};
}

/// True if each moving index of the loop is a digit of one of `indices`.
static bool areAllDigits(scf::ParallelOp loop, ArrayRef<IndexExpr> indices,
                         ArrayRef<Value> moving) {
  SmallVector<Value> left(moving);
  for (const IndexExpr &index : indices)
    for (Value digit : findDigits(loop, index, moving))
      llvm::erase(left, digit);
  return left.empty();
}

LogicalResult mlir::tai::checkLoopsWithoutOrder(FunctionOpInterface function,
                                                const Activity &activity) {
  LogicalResult result = success();
  function.getFunctionBody().walk([&](scf::ParallelOp loop) {
    SmallVector<Value> moving = getMovingDimensions(loop);
    llvm::MapVector<const void *, SmallVector<DifferentiableAccessInterface>>
        storages;
    loop.walk([&](DifferentiableAccessInterface access) {
      Value memref = access.getAccessedStorage().memref;
      if (access.getAccessKind() == AccessKind::Write &&
          !matchPattern(access.getAccessedValue(), m_Constant()) &&
          !(memref && loop->isAncestor(memref.getParentBlock()->getParentOp())))
        storages[getStorageKey(access)].push_back(access);
    });
    for (auto &[key, stores] : storages) {
      SmallVector<IndexExpr> indices =
          getIndexExprs(stores.front().getAccessIndices());
      SmallVector<IndexExpr> common;
      for (size_t i = 0; i != indices.size(); ++i)
        if (llvm::all_of(stores, [&](auto store) {
              return getIndexExpr(store.getAccessIndices()[i]) == indices[i];
            }))
          common.push_back(indices[i]);
      bool isActive = llvm::any_of(
          stores, [&](auto store) { return activity.isActiveAccess(store); });
      if (!isActive || moving.empty() || isInjectiveOver(common, moving) ||
          areAllDigits(loop, common, moving))
        continue;
      InFlightDiagnostic diag = stores.front()->emitError(
          "iterations of a parallel loop may store to the same element here, "
          "and the gradient belongs to the one whose value remains");
      diag.attachNote(loop.getLoc())
          << "the iterations of 'scf.parallel' have no order, so that none of "
             "them is the last";
      diag.attachNote() << "store to an element for each iteration, or write "
                           "the loop as 'tai.parallel_for' or as 'scf.for'";
      result = failure();
    }
  });
  return result;
}
