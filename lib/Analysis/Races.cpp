//===- Races.cpp - Iterations that meet for certain -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Looks for two points i != j of the box of a parallel loop with lhs(i) ==
// rhs(j). Indices must be linear forms with at most one loop index, so that
// each dimension of the box can be solved separately; for other indices,
// nothing is proven. Conditions around an access narrow its box if they compare
// an index with a constant; under other conditions, nothing is proven.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Races.h"
#include "mlir/IR/Matchers.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Analysis/SharedElements.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// Facts about one dimension of two iterations i and j: their indices and the
/// difference, as far as determined.
struct Unknown {
  std::optional<int64_t> i, j, difference; // j - i

  static bool set(std::optional<int64_t> &slot, int64_t value) {
    if (slot && *slot != value)
      return false;
    slot = value;
    return true;
  }
};
} // namespace

/// Returns the dimension of the loop whose index the atom is.
static std::optional<unsigned> findIndex(LoopBox &box, const IndexAtom &atom) {
  return atom.getValue() ? box.find(atom.getValue()) : std::nullopt;
}

/// Returns the loop index of a form, as its dimension and coefficient;
/// dimension -1 if there is none. Fails if there are several, or if other parts
/// of the form differ between iterations.
static FailureOr<std::pair<int, int64_t>> getLoopTerm(LoopBox &box,
                                                      const IndexExpr &form) {
  std::pair<int, int64_t> found(-1, 0);
  for (const auto &[atom, coefficient] : form.terms) {
    std::optional<unsigned> dim = findIndex(box, atom);
    if (!dim) {
      if (!atom.allOf([&](Value value) {
            return !box.loop->isAncestor(value.getParentBlock()->getParentOp());
          }))
        return failure();
      continue;
    }
    if (found.first >= 0)
      return failure();
    found = {static_cast<int>(*dim), coefficient};
  }
  return found;
}

/// Returns the part of an index expression that is the same in all iterations
/// of the loop, without its constant.
static IndexExpr dropLoopTerms(LoopBox &box, IndexExpr form) {
  llvm::erase_if(form.terms,
                 [&](auto &term) { return findIndex(box, term.first); });
  form.constant = 0;
  return form;
}

/// Adds the equation lhs(i) == rhs(j) for one index, in exact integers: equal
/// integers have equal low bits. False if the equation cannot hold, or is not
/// supported.
static bool addEquation(LoopBox &box, const IndexExpr &lhs,
                        const IndexExpr &rhs,
                        MutableArrayRef<Unknown> unknowns) {
  FailureOr<std::pair<int, int64_t>> a = getLoopTerm(box, lhs);
  FailureOr<std::pair<int, int64_t>> b = getLoopTerm(box, rhs);
  if (failed(a) || failed(b) ||
      !(dropLoopTerms(box, lhs) == dropLoopTerms(box, rhs)))
    return false;
  int64_t constant = lhs.constant - rhs.constant;
  auto [aDim, aFactor] = *a;
  auto [bDim, bFactor] = *b;
  if (aDim < 0 && bDim < 0)
    return constant == 0;
  if (aDim >= 0 && bDim >= 0)
    return aDim == bDim && aFactor == bFactor && constant % aFactor == 0 &&
           Unknown::set(unknowns[aDim].difference, constant / aFactor);
  if (aDim >= 0)
    return constant % aFactor == 0 &&
           Unknown::set(unknowns[aDim].i, -constant / aFactor);
  return constant % bFactor == 0 &&
         Unknown::set(unknowns[bDim].j, constant / bFactor);
}

namespace {
/// The integers in [lower, upper), as a range of a loop index.
struct Interval {
  int64_t lower, upper;

  bool contains(int64_t value) const { return value >= lower && value < upper; }
};
} // namespace

/// True if the equations `unknown` have a solution with i in `is` and j in
/// `js`; sets `differ` if there is a solution with i != j.
static bool solve(Unknown unknown, Interval is, Interval js, bool &differ) {
  if (is.lower >= is.upper || js.lower >= js.upper)
    return false;
  if (unknown.difference) {
    int64_t difference = *unknown.difference;
    if (unknown.i && !Unknown::set(unknown.j, *unknown.i + difference))
      return false;
    if (unknown.j && !Unknown::set(unknown.i, *unknown.j - difference))
      return false;
    differ |= difference != 0;
    if (unknown.i)
      return is.contains(*unknown.i) && js.contains(*unknown.j);
    return std::max(is.lower, js.lower - difference) <
           std::min(is.upper, js.upper - difference);
  }
  if (unknown.i && !is.contains(*unknown.i))
    return false;
  if (unknown.j && !js.contains(*unknown.j))
    return false;
  if (unknown.i)
    is = {*unknown.i, *unknown.i + 1};
  if (unknown.j)
    js = {*unknown.j, *unknown.j + 1};
  differ |= is.upper - is.lower >= 2 || js.upper - js.lower >= 2 ||
            is.lower != js.lower;
  return true;
}

/// Returns the box of a loop; a bound that is not known is replaced by a very
/// large number, so that the loop counts as long.
static LoopBox getLongBox(ParallelForOp loop) {
  constexpr int64_t kFar = int64_t(1) << 40;
  if (std::optional<LoopBox> box = getIndexBox(loop))
    return *box;
  LoopBox box{loop, {}, {}};
  auto get = [](Value bound, int64_t otherwise) {
    APInt constant;
    bool isKnown = matchPattern(bound, m_ConstantInt(&constant)) &&
                   constant.getSignificantBits() <= 40;
    return isKnown ? constant.getSExtValue() : otherwise;
  };
  for (auto [lower, upper] :
       llvm::zip(loop.getLowerBounds(), loop.getUpperBounds())) {
    box.lower.push_back(get(lower, -kFar));
    box.upper.push_back(get(upper, kFar));
  }
  return box;
}

Operation *mlir::tai::findRace(DifferentiableAccessInterface lhs,
                               DifferentiableAccessInterface rhs,
                               bool ofLongLoops) {
  auto loop = dyn_cast_if_present<ParallelForOp>(getEnclosingParallelLoop(lhs));
  if (!loop || loop.getSerialize() || getEnclosingParallelLoop(rhs) != loop)
    return nullptr;
  ValueRange lhsParts = lhs.getAccessComponents();
  ValueRange rhsParts = rhs.getAccessComponents();
  if (lhs.getAccessIndices().size() != rhs.getAccessIndices().size())
    return nullptr;
  // For most pairs of accesses, the equations alone show that the accesses do
  // not meet; bounds are looked up only for the remaining pairs.
  LoopBox unbounded{loop, {}, {}};
  SmallVector<Unknown> unknowns(loop.getInductionVars().size());
  auto add = [&](ValueRange a, ValueRange b) {
    return llvm::all_of(llvm::zip_equal(a, b), [&](auto pair) {
      auto [x, y] = pair;
      return addEquation(unbounded, getIndexExpr(x), getIndexExpr(y), unknowns);
    });
  };
  if (!add(lhs.getAccessIndices(), rhs.getAccessIndices()) ||
      (lhsParts.size() == rhsParts.size() && !add(lhsParts, rhsParts)))
    return nullptr;
  std::optional<LoopBox> box =
      ofLongLoops ? getLongBox(loop) : getConstantBox(loop);
  if (!box || box->lower.size() != unknowns.size())
    return nullptr;
  // Within other conditions or loops, an access may not run at all.
  LoopBox other = *box;
  if (!narrowToAccess(lhs, *box) || !narrowToAccess(rhs, other))
    return nullptr;
  bool differ = false;
  for (size_t dim = 0; dim != unknowns.size(); ++dim)
    if (!solve(unknowns[dim], {box->lower[dim], box->upper[dim]},
               {other.lower[dim], other.upper[dim]}, differ))
      return nullptr;
  return differ ? loop.getOperation() : nullptr;
}
