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
#include <numeric>

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Differences
//===----------------------------------------------------------------------===//

/// Beyond this, a range counts as unbounded.
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
  // Multiples of the divisor reach all multiples of its largest power of two.
  unsigned twos = std::min<unsigned>(llvm::countr_zero(divisor), width);
  if (constant % (static_cast<__int128>(1) << twos) != 0)
    return false;
  // Zero is the only multiple of the modulus in the range. A single unknown
  // times an odd factor is a multiple only if the unknown is one.
  __int128 most = modulus;
  if (unknowns == 1 && constant == 0)
    most *= static_cast<__int128>(divisor >> twos);
  if (isUnbounded || range.low <= -most || range.high >= most)
    return true;
  return range.low <= 0 && range.high >= 0 &&
         constant % static_cast<__int128>(divisor) == 0;
}

bool mlir::tai::areDistinct(const IndexExpr &lhs, const IndexExpr &rhs) {
  IndexExpr difference = lhs;
  difference.add(rhs, -1);
  IndexDifference form;
  form.addConstant(difference.constant);
  return difference.isConstant() && !form.canBeZero(difference.width);
}

//===----------------------------------------------------------------------===//
// Injectivity
//===----------------------------------------------------------------------===//

namespace {
/// Finds the unknowns that are the same in two iterations if all of a list of
/// expressions are.
class Solver {
public:
  Solver(IndexBuilder &builder, ArrayRef<IndexExpr> indices, ValueRange ivs)
      : builder(builder), equations(indices), ivs(ivs) {
    loop = cast<BlockArgument>(ivs.front()).getOwner()->getParentOp();
    if (auto like = dyn_cast_if_present<LoopLikeOpInterface>(loop))
      if (auto all = like.getLoopInductionVars())
        llvm::append_range(others, *all);
    llvm::erase_if(others,
                   [&](Value iv) { return llvm::is_contained(ivs, iv); });
  }

  bool solve() {
    bool changed = true;
    while (changed) {
      changed = false;
      // Dividends are added behind.
      for (size_t i = 0; i != equations.size(); ++i)
        changed |= solveOne(i);
      changed |= joinDigits();
      if (llvm::all_of(ivs, [&](Value iv) { return isKnown(iv); }))
        return true;
    }
    return false;
  }

private:
  /// True for a value that is the same in both iterations.
  bool isKnown(Value value) const {
    if (solved(IndexAtom(value)) || llvm::is_contained(others, value))
      return true;
    return !loop || !loop->isAncestor(value.getParentBlock()->getParentOp());
  }

  bool solved(const IndexAtom &atom) const {
    return llvm::is_contained(solutions, atom);
  }

  bool isKnown(const IndexAtom &atom) const {
    return solved(atom) ||
           atom.allOf([&](Value value) { return isKnown(value); });
  }

  /// The difference of an unknown in two iterations.
  IndexRange getDifference(const IndexAtom &atom) {
    IndexRange range = builder.getRange(atom);
    __int128 most = range.high - range.low;
    if (atom.getValue() && llvm::is_contained(ivs, atom.getValue()))
      most = std::min<__int128>(most, kMostIterations);
    return {-most, most};
  }

  bool solveOne(size_t number) {
    const std::pair<IndexAtom, int64_t> *unknown = nullptr;
    for (const auto &term : equations[number].terms) {
      if (isKnown(term.first))
        continue;
      if (unknown)
        return false;
      unknown = &term;
    }
    if (!unknown)
      return false;
    unsigned width = equations[number].width;
    if (width == 64 && std::abs(unknown->second) == 1) {
      solutions.push_back(unknown->first);
      return true;
    }
    // Only the difference zero gives equal low bits: positive ones do not.
    IndexDifference difference;
    IndexRange range = getDifference(unknown->first);
    range.low = 1;
    difference.addUnknown(unknown->second, range);
    if (range.high >= 1 && difference.canBeZero(width))
      return false;
    solutions.push_back(unknown->first);
    return true;
  }

  /// The quotient and the remainder of one division determine the dividend.
  bool joinDigits() {
    SmallVector<IndexExpr> found;
    for (const IndexAtom &atom : solutions) {
      const IndexNode *node = atom.getNode();
      if (!node || node->kind != IndexNode::Kind::Remainder ||
          !isKnown(node->rhs))
        continue;
      if (isKnown(builder.getQuotient(node->lhs, node->rhs)) &&
          !llvm::is_contained(equations, node->lhs))
        found.push_back(node->lhs);
    }
    llvm::append_range(equations, found);
    return !found.empty();
  }

  bool isKnown(const IndexExpr &expr) const {
    return llvm::all_of(expr.terms,
                        [&](const auto &term) { return isKnown(term.first); });
  }

  IndexBuilder &builder;
  SmallVector<IndexExpr> equations;
  ValueRange ivs;
  Operation *loop;
  SmallVector<Value> others;
  SmallVector<IndexAtom> solutions;
};
} // namespace

bool mlir::tai::isInjectiveOver(ArrayRef<IndexExpr> indices, ValueRange ivs) {
  IndexBuilder builder;
  return isInjectiveOver(builder, indices, ivs);
}

bool mlir::tai::isInjectiveOver(IndexBuilder &builder,
                                ArrayRef<IndexExpr> indices, ValueRange ivs) {
  return ivs.empty() || Solver(builder, indices, ivs).solve();
}
