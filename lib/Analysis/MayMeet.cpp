//===- MayMeet.cpp - Accesses that cannot be told apart -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Whether a later access may reach the element of an earlier one. Indices are
// compared as linear forms. What both accesses see the same cancels; what may
// differ between them is an unknown of its own, of which no more than a range
// is known. They are apart if the difference of some index cannot be zero.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include <numeric>

using namespace mlir;
using namespace mlir::tai;

bool mlir::tai::isSerialLoop(Operation *op) {
  if (!isa<LoopLikeOpInterface>(op) || isa<scf::ParallelOp>(op))
    return false;
  auto parallel = dyn_cast<ParallelForOp>(op);
  return !parallel || parallel.getSerialize();
}

namespace {
/// The values that an unknown can have, as far as is known; both ends included.
struct Interval {
  std::optional<int64_t> low, high;
};
} // namespace

static std::optional<int64_t> getConstant(Value value) {
  APInt constant;
  if (!matchPattern(value, m_ConstantInt(&constant)) ||
      constant.getSignificantBits() > 64)
    return std::nullopt;
  return constant.getSExtValue();
}

/// What is known of a term of an index.
static Interval getRange(Value value) {
  Interval range;
  if (auto rem = value.getDefiningOp<arith::RemSIOp>()) {
    std::optional<int64_t> divisor = getConstant(rem.getRhs());
    if (divisor && *divisor > 0)
      range = {1 - *divisor, *divisor - 1};
    return range;
  }
  Operation *loop = getLoopOf(value);
  if (auto serial = dyn_cast_if_present<scf::ForOp>(loop)) {
    if (value != serial.getInductionVar())
      return range;
    range.low = getConstant(serial.getLowerBound());
    if (std::optional<int64_t> upper = getConstant(serial.getUpperBound()))
      range.high = *upper - 1;
  } else if (auto parallel = dyn_cast_if_present<ParallelForOp>(loop)) {
    if (std::optional<LoopBox> box = getConstantBox(parallel))
      if (std::optional<unsigned> dim = box->find(value))
        range = {box->lower[*dim], box->upper[*dim] - 1};
  }
  return range;
}

namespace {
/// How the second of two accesses is later than the first: in the same
/// iteration of all loops around both (no loop), or in a later one of a serial
/// loop, of which `moving` has grown, where that is known of an induction
/// variable.
struct Later {
  Operation *loop = nullptr;
  Value moving;
  int64_t step = 1;
  /// Induction variables of the loop that are the same.
  ValueRange same;
};

/// A linear form of which it is asked whether it can be zero.
class Difference {
public:
  void addConstant(int64_t value) { constant += value; }
  void addUnknown(int64_t factor, Interval range) {
    if (factor == 0)
      return;
    divisor = std::gcd(divisor, factor);
    auto addTo = [&](std::optional<__int128> &sum, std::optional<int64_t> end) {
      if (sum && end)
        *sum += static_cast<__int128>(factor) * *end;
      else
        sum.reset();
    };
    addTo(low, factor > 0 ? range.low : range.high);
    addTo(high, factor > 0 ? range.high : range.low);
  }

  bool cannotBeZero(bool mayWrap) const {
    if (divisor == 0)
      return constant != 0;
    if (mayWrap)
      return false;
    return constant % divisor != 0 || (low && *low + constant > 0) ||
           (high && *high + constant < 0);
  }

private:
  int64_t constant = 0;
  int64_t divisor = 0; // of all factors; 0 if there are none
  std::optional<__int128> low = 0, high = 0;
};
} // namespace

/// True if the indices differ whenever `second` is so much later.
static bool areApart(const LinearIndex &first, const LinearIndex &second,
                     Block *common, const Later &later) {
  auto isShared = [&](Value value) {
    Operation *owner = value.getParentBlock()->getParentOp();
    if (!later.loop)
      return owner->isAncestor(common->getParentOp());
    return !later.loop->isAncestor(owner) ||
           llvm::is_contained(later.same, value);
  };
  Difference difference;
  difference.addConstant(first.constant - second.constant);
  Value moving = later.moving;
  if (moving) {
    // The later value lies a positive number of steps ahead.
    Interval ahead = {1, std::nullopt};
    Interval range = getRange(moving);
    if (range.low && range.high)
      ahead.high =
          std::max<int64_t>((*range.high - *range.low) / later.step, 1);
    difference.addUnknown(-second.getCoefficient(moving) * later.step, ahead);
    difference.addUnknown(
        first.getCoefficient(moving) - second.getCoefficient(moving), range);
  }
  auto addTerms = [&](const LinearIndex &form, int64_t sign) {
    for (auto [value, factor] : form.terms) {
      if (value == moving)
        continue;
      int64_t rest = sign * factor;
      if (isShared(value)) {
        // Met in both forms; counted when met in the first.
        const LinearIndex &other = sign > 0 ? second : first;
        int64_t otherFactor = other.getCoefficient(value);
        if (sign < 0 && otherFactor != 0)
          continue;
        rest -= sign * otherFactor;
      }
      difference.addUnknown(rest, getRange(value));
    }
  };
  addTerms(first, 1);
  addTerms(second, -1);
  return difference.cannotBeZero(first.mayWrap || second.mayWrap);
}

/// The same of lists of values of equal length.
static bool areApart(ValueRange first, ValueRange second, Block *common,
                     const Later &later) {
  return llvm::any_of(llvm::zip(first, second), [&](auto pair) {
    auto [lhs, rhs] = pair;
    return areApart(getLinearIndex(lhs), getLinearIndex(rhs), common, later);
  });
}

/// The ways in which an iteration of `loop` can be later than another.
static SmallVector<Later> getWays(Operation *loop) {
  SmallVector<Later> ways;
  if (auto serial = dyn_cast<scf::ForOp>(loop)) {
    // Steps are positive.
    int64_t step = getConstant(serial.getStep()).value_or(1);
    ways.push_back({loop, serial.getInductionVar(), std::max<int64_t>(step, 1),
                    ValueRange()});
    return ways;
  }
  if (auto parallel = dyn_cast<ParallelForOp>(loop)) {
    ValueRange ivs = parallel.getInductionVars();
    for (auto [i, iv] : llvm::enumerate(ivs))
      ways.push_back({loop, iv, 1, ivs.take_front(i)});
    return ways;
  }
  ways.emplace_back();
  ways.back().loop = loop;
  return ways;
}

bool mlir::tai::mayReachLater(DifferentiableAccessInterface first,
                              DifferentiableAccessInterface second) {
  Operation *firstUp = first, *secondUp = second;
  Block *common = findCommonBlock(firstUp, secondUp);
  if (!common)
    return true;
  auto mayMeet = [&](const Later &later) {
    if (first.getAccessIndices().size() == second.getAccessIndices().size() &&
        areApart(first.getAccessIndices(), second.getAccessIndices(), common,
                 later))
      return false;
    ValueRange parts = first.getAccessComponents();
    ValueRange otherParts = second.getAccessComponents();
    return parts.size() != otherParts.size() || parts.empty() ||
           !areApart(parts, otherParts, common, later);
  };
  // Arms of a branch exclude each other; regions of other ops may follow on one
  // another.
  bool follows = firstUp == secondUp
                     ? first != second && !isa<scf::IfOp>(firstUp)
                     : firstUp->isBeforeInBlock(secondUp);
  if (follows && mayMeet(Later()))
    return true;
  for (Operation *loop = common->getParentOp();
       loop && !isa<FunctionOpInterface>(loop); loop = loop->getParentOp())
    if (isSerialLoop(loop) && llvm::any_of(getWays(loop), mayMeet))
      return true;
  return false;
}
