//===- IndexQueries.cpp - Questions about index expressions ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Index/IndexQueries.h"
#include "mlir/IR/Operation.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "llvm/ADT/STLExtras.h"
#include "llvm/ADT/bit.h"
#include "llvm/Support/MathExtras.h"
#include <numeric>

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Differences
//===----------------------------------------------------------------------===//

/// A range that reaches beyond this magnitude counts as unbounded.
static constexpr __int128 kFar = static_cast<__int128>(1) << 120;

void IndexDifference::addConstant(__int128 value) {
  constant += value;
  range.low += value;
  range.high += value;
}

void IndexDifference::addUnknown(int64_t factor, IndexRange values) {
  if (factor == 0)
    return;
  ++unknowns;
  divisor = std::gcd(divisor, factor < 0 ? -static_cast<uint64_t>(factor)
                                         : static_cast<uint64_t>(factor));
  if (factor < 0)
    std::swap(values.low, values.high);
  for (auto [sum, end] : {std::pair{&range.low, values.low},
                          std::pair{&range.high, values.high}}) {
    __int128 product;
    isUnbounded |=
        __builtin_mul_overflow(end, static_cast<__int128>(factor), &product) ||
        product > kFar || product < -kFar;
    if (!isUnbounded)
      *sum += product;
    isUnbounded |= *sum > kFar || *sum < -kFar;
  }
}

bool IndexDifference::canBeZero(unsigned width) const {
  __int128 modulus = static_cast<__int128>(1) << width;
  if (unknowns == 0)
    return constant % modulus == 0;
  // Modulo 2^width, all multiples of `divisor` are multiples of the largest
  // power of two that divides it, so `constant` must be a multiple of this
  // power too.
  unsigned twos = std::min<unsigned>(llvm::countr_zero(divisor), width);
  if (constant % (static_cast<__int128>(1) << twos) != 0)
    return false;
  // If the sum has a small range, zero is the only multiple of the modulus in
  // the range. A single unknown times an odd factor is such a multiple only if
  // the unknown itself is.
  __int128 most = modulus;
  if (unknowns == 1 && constant == 0)
    most *= static_cast<__int128>(divisor >> twos);
  if (isUnbounded || range.low <= -most || range.high >= most)
    return true;
  return range.low <= 0 && range.high >= 0 &&
         constant % static_cast<__int128>(divisor) == 0;
}

/// The most unknowns in a difference whose ranges are computed.
static constexpr size_t kMostUnknowns = 2;

bool mlir::tai::areDistinct(const IndexExpr &lhs, const IndexExpr &rhs) {
  IndexExpr difference = lhs;
  difference.add(rhs, -1);
  // Differences with more unknowns are skipped: many pairs are compared, and
  // few have ranges that tell them apart.
  if (difference.terms.size() > kMostUnknowns)
    return false;
  IndexBuilder builder;
  IndexDifference form;
  form.addConstant(difference.constant);
  for (const auto &[atom, factor] : difference.terms)
    form.addUnknown(factor, builder.getRange(atom));
  return !form.canBeZero(difference.width);
}

bool mlir::tai::areDistinctOver(const IndexExpr &lhs, const IndexExpr &rhs,
                                Operation *loop) {
  auto isOutside = [&](Value value) {
    return !loop->isAncestor(value.getParentBlock()->getParentOp());
  };
  // Values from outside of the loop are the same on both sides. Each other atom
  // has a value of its own on each side.
  IndexExpr outside;
  outside.constant = lhs.constant;
  outside.add(IndexExpr(rhs.constant), -1);
  IndexBuilder builder;
  IndexDifference form;
  for (auto [side, sign] : {std::pair{&lhs, 1}, std::pair{&rhs, -1}})
    for (const auto &[atom, factor] : side->terms) {
      if (factor == INT64_MIN)
        return false;
      if (atom.allOf(isOutside))
        outside.add(IndexExpr(atom), sign * factor);
      else
        form.addUnknown(sign * factor, builder.getRange(atom));
    }
  if (outside.terms.size() > kMostUnknowns)
    return false;
  form.addConstant(outside.constant);
  for (const auto &[atom, factor] : outside.terms)
    form.addUnknown(factor, builder.getRange(atom));
  return !form.canBeZero(std::min(lhs.width, rhs.width));
}

//===----------------------------------------------------------------------===//
// Equations
//===----------------------------------------------------------------------===//

void IterationEquations::add(const IndexExpr &first, const IndexExpr &second) {
  std::pair equation(first, second);
  if (!llvm::is_contained(equations, equation))
    equations.push_back(std::move(equation));
}

void IterationEquations::add(ValueRange first, ValueRange second) {
  for (auto [a, b] : llvm::zip_equal(first, second))
    add(builder.get(a), builder.get(b));
}

bool IterationEquations::solve(ValueRange values) {
  size_t steps;
  do {
    steps = equations.size() + solutions.size();
    // The loop bounds are read anew in each turn, because solveOne and
    // joinDigits append equations.
    for (size_t i = 0; i != equations.size(); ++i)
      solveOne(equations[i].first, equations[i].second);
    joinDigits();
  } while (steps != equations.size() + solutions.size());
  return llvm::all_of(
      values, [&](const IndexAtom &value) { return isSame(value, value); });
}

bool IterationEquations::isSame(const IndexAtom &first,
                                const IndexAtom &second) const {
  if (llvm::is_contained(solutions, std::pair(first, second)))
    return true;
  const IndexNode *a = first.getNode(), *b = second.getNode();
  if (a && b)
    return a->kind == b->kind && isSame(a->lhs, b->lhs) &&
           isSame(a->rhs, b->rhs);
  Value value = first.getValue();
  return value && value == second.getValue() &&
         (llvm::is_contained(same, value) ||
          !loop->isAncestor(value.getParentBlock()->getParentOp()));
}

bool IterationEquations::isSame(IndexExpr first, IndexExpr second) const {
  cancel(first, second);
  return first.isConstant() && second.isConstant() &&
         first.constant == second.constant;
}

/// Removes from both sums the terms that both sums have.
void IterationEquations::cancel(IndexExpr &first, IndexExpr &second) const {
  llvm::erase_if(first.terms, [&](const auto &term) {
    auto *at = llvm::find_if(second.terms, [&](const auto &other) {
      return term.second == other.second && isSame(term.first, other.first);
    });
    if (at == second.terms.end())
      return false;
    second.terms.erase(at);
    return true;
  });
}

/// Solves the equation first == second if each side has one unknown: adds that
/// the unknowns are equal. The parameters are copies, because solutions add
/// equations to the list.
void IterationEquations::solveOne(IndexExpr first, IndexExpr second) {
  cancel(first, second);
  if (first.terms.size() > 1 && second.terms.size() > 1)
    splitDigits(first, second);
  if (first.terms.size() != 1 || second.terms.size() != 1 ||
      first.constant != second.constant ||
      first.terms.front().second != second.terms.front().second)
    return;
  const auto &[a, factor] = first.terms.front();
  const IndexAtom &b = second.terms.front().first;
  unsigned width = std::min(first.width, second.width);
  if (width != 64 || std::abs(factor) != 1) {
    // The equation is given up if the unknowns can differ although the low bits
    // of the two sides are equal.
    IndexRange lhs = builder.getRange(a), rhs = builder.getRange(b);
    __int128 most = std::max(lhs.high - rhs.low, rhs.high - lhs.low);
    auto iv = dyn_cast_if_present<BlockArgument>(a.getValue());
    if (iv && a == b && iv.getOwner()->getParentOp() == loop)
      most = std::min<__int128>(most, kMostIterations);
    IndexDifference difference;
    difference.addUnknown(factor, {1, most});
    if (most >= 1 && difference.canBeZero(width))
      return;
  }
  solutions.emplace_back(a, b);
  // A value is a term, rather than a sum, where it may wrap before a division
  // or an extension; its sum must be equal as well.
  if (a.getValue() && b.getValue())
    add(a.getValue(), b.getValue());
}

/// Returns the least value of the sum of those terms of `expr` that are no
/// multiples of `base`.
static __int128 getLeastBelow(IndexBuilder &builder, const IndexExpr &expr,
                              int64_t base) {
  IndexExpr below;
  for (const auto &[atom, factor] : expr.terms)
    if (factor % base != 0)
      below.add(IndexExpr(atom), factor);
  return builder.getRange(below).low;
}

/// Equal numbers have equal digits: where a factor exceeds the sum of the terms
/// below it, adds equations for quotient and remainder by this factor.
void IterationEquations::splitDigits(IndexExpr first, IndexExpr second) {
  unsigned width = std::min(first.width, second.width);
  IndexRange a = builder.getRange(first), b = builder.getRange(second);
  // The sums must be equal as integers, not only in their low bits.
  __int128 most = std::max(a.high - b.low, b.high - a.low);
  if (most >= static_cast<__int128>(1) << width ||
      llvm::SubOverflow(first.constant, second.constant, first.constant))
    return;
  first.width = second.width = 64;
  second.constant = 0;
  for (const auto &[atom, factor] : first.terms) {
    if (factor == INT64_MIN || std::abs(factor) == 1)
      continue;
    int64_t base = std::abs(factor);
    // Terms that count down may make the low digit negative: add a constant to
    // both sums that prevents this.
    __int128 low = std::min(getLeastBelow(builder, first, base),
                            getLeastBelow(builder, second, base));
    if (low <= -base)
      continue;
    IndexExpr lifted = first, other = second;
    int64_t lift = low < 0 ? -static_cast<int64_t>(low) : 0;
    if (llvm::AddOverflow(first.constant, lift, lifted.constant))
      continue;
    other.constant = lift;
    auto high = builder.split(lifted, base);
    auto otherHigh = high ? builder.split(other, base) : std::nullopt;
    if (!otherHigh)
      continue;
    add(high->first, otherHigh->first);
    add(high->second, otherHigh->second);
  }
}

/// If quotients and remainders of two divisions by one divisor are equal, the
/// dividends are equal: adds these equations.
void IterationEquations::joinDigits() {
  for (const auto &[first, second] : solutions) {
    const IndexNode *a = first.getNode(), *b = second.getNode();
    if (a && b && a->isRemainder() && b->kind == a->kind &&
        isSame(a->rhs, b->rhs) &&
        isSame(builder.getQuotientOf(*a), builder.getQuotientOf(*b)))
      add(a->lhs, b->lhs);
  }
}

bool mlir::tai::isInjectiveOver(ArrayRef<IndexExpr> indices, ValueRange ivs) {
  IndexBuilder builder;
  return isInjectiveOver(builder, indices, ivs);
}

bool mlir::tai::isInjectiveOver(IndexBuilder &builder,
                                ArrayRef<IndexExpr> indices, ValueRange ivs) {
  if (ivs.empty())
    return true;
  Operation *loop = cast<BlockArgument>(ivs.front()).getOwner()->getParentOp();
  SmallVector<Value> others;
  if (auto like = dyn_cast_if_present<LoopLikeOpInterface>(loop))
    others = *like.getLoopInductionVars();
  llvm::erase_if(others, [&](Value iv) { return llvm::is_contained(ivs, iv); });
  IterationEquations equations(builder, loop, others);
  for (const IndexExpr &index : indices)
    equations.add(index, index);
  return equations.solve(ivs);
}
