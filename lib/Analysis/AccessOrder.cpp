//===- AccessOrder.cpp - Order of accesses --------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/AccessOrder.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

AccessTable::AccessTable(FunctionOpInterface function) {
  function.walk([&](DifferentiableAccessInterface access) {
    const void *key = getStorageKey(access);
    storages[key].push_back(access);
    if (access.getAccessKind() != AccessKind::Read)
      writes[key].push_back(access);
  });
}

DifferentiableAccessInterface
AccessTable::findLaterWrite(DifferentiableAccessInterface access) const {
  auto it = writes.find(getStorageKey(access));
  if (it == writes.end())
    return {};
  const auto *found = llvm::find_if(
      it->second, [&](auto write) { return mayReachLater(access, write); });
  return found == it->second.end() ? DifferentiableAccessInterface() : *found;
}

DifferentiableAccessInterface
AccessTable::findEarlierWrite(DifferentiableAccessInterface access) const {
  auto it = writes.find(getStorageKey(access));
  if (it == writes.end())
    return {};
  const auto *found = llvm::find_if(
      it->second, [&](auto write) { return mayReachLater(write, access); });
  return found == it->second.end() ? DifferentiableAccessInterface() : *found;
}

Block *mlir::tai::findCommonBlock(Operation *&lhs, Operation *&rhs) {
  for (Operation *up = lhs; up && !isa<FunctionOpInterface>(up);
       up = up->getParentOp())
    if (Operation *other = up->getBlock()->findAncestorOpInBlock(*rhs)) {
      lhs = up;
      rhs = other;
      return up->getBlock();
    }
  return nullptr;
}

/// True if some branch lies between `op` and the op `outer` that contains it.
static bool isConditional(Operation *op, Operation *outer) {
  for (; op != outer; op = op->getParentOp()) {
    Operation *parent = op->getParentOp();
    if (!isa<LoopLikeOpInterface>(parent) || isa<scf::WhileOp>(parent))
      return true;
  }
  return false;
}

bool mlir::tai::runsAfter(Operation *first, Operation *second) {
  Operation *firstUp = first, *secondUp = second;
  if (!findCommonBlock(firstUp, secondUp) || firstUp == secondUp)
    return false;
  return firstUp->isBeforeInBlock(secondUp) &&
         (!isConditional(first, firstUp) || !isConditional(second, secondUp));
}

/// Returns the loops between `op` and the op `outer` that contains it,
/// outermost first.
static SmallVector<Operation *> getLoopsBelow(Operation *op, Operation *outer) {
  SmallVector<Operation *> loops;
  for (; op != outer; op = op->getParentOp())
    if (isa<LoopLikeOpInterface>(op->getParentOp()))
      loops.push_back(op->getParentOp());
  std::reverse(loops.begin(), loops.end());
  return loops;
}

/// True if the loops `lhs` and `rhs` have the same range of indices; the range
/// may be empty.
static bool haveSameRange(Operation *lhs, Operation *rhs) {
  if (lhs->getName() != rhs->getName())
    return false;
  if (auto loop = dyn_cast<ParallelForOp>(lhs)) {
    auto other = cast<ParallelForOp>(rhs);
    return loop.getFieldAttr() == other.getFieldAttr() &&
           areProvablyEqual(loop.getLowerBounds(), other.getLowerBounds()) &&
           areProvablyEqual(loop.getUpperBounds(), other.getUpperBounds());
  }
  auto loop = cast<LoopLikeOpInterface>(lhs);
  auto other = cast<LoopLikeOpInterface>(rhs);
  auto areEqual = [](std::optional<SmallVector<OpFoldResult>> a,
                     std::optional<SmallVector<OpFoldResult>> b) {
    if (!a || !b || a->size() != b->size())
      return false;
    return llvm::all_of(llvm::zip(*a, *b), [](auto pair) {
      auto [x, y] = pair;
      return isEqualConstantIntOrValue(x, y);
    });
  };
  return areEqual(loop.getLoopLowerBounds(), other.getLoopLowerBounds()) &&
         areEqual(loop.getLoopUpperBounds(), other.getLoopUpperBounds()) &&
         areEqual(loop.getLoopSteps(), other.getLoopSteps());
}

bool mlir::tai::reachSameElement(DifferentiableAccessInterface lhs,
                                 DifferentiableAccessInterface rhs) {
  // An access to a whole element also reaches each of its components.
  ValueRange lhsParts = lhs.getAccessComponents();
  ValueRange rhsParts = rhs.getAccessComponents();
  if (!lhsParts.empty() && !rhsParts.empty() &&
      !areProvablyEqual(lhsParts, rhsParts))
    return false;
  if (lhs.getAccessIndices().size() != rhs.getAccessIndices().size())
    return false;

  // A loop around one access corresponds to a loop around the other access if
  // both loops have the same range.
  Operation *lhsUp = lhs, *rhsUp = rhs;
  if (!findCommonBlock(lhsUp, rhsUp))
    return false;
  DenseMap<Value, Value> renamed;
  SmallVector<Operation *> lhsLoops = getLoopsBelow(lhs, lhsUp);
  SmallVector<Operation *> rhsLoops = getLoopsBelow(rhs, rhsUp);
  for (auto [a, b] : llvm::zip(lhsLoops, rhsLoops)) {
    if (!haveSameRange(a, b))
      break;
    auto aIvs = cast<LoopLikeOpInterface>(a).getLoopInductionVars();
    auto bIvs = cast<LoopLikeOpInterface>(b).getLoopInductionVars();
    if (!aIvs || !bIvs || aIvs->size() != bIvs->size())
      break;
    for (auto [aIv, bIv] : llvm::zip(*aIvs, *bIvs))
      renamed[bIv] = aIv;
  }
  for (auto [a, b] :
       llvm::zip(lhs.getAccessIndices(), rhs.getAccessIndices())) {
    IndexExpr rhsForm = getIndexExpr(b).substitute(
        [&](Value value) -> std::optional<IndexExpr> {
          Value other = renamed.lookup(value);
          return other ? std::optional(IndexExpr(other)) : std::nullopt;
        });
    if (!(getIndexExpr(a) == rhsForm))
      return false;
  }
  return true;
}
