//===- IterationAliasing.cpp - Aliasing between iterations ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Whether a later access may reach the element of an earlier one. Indices are
// compared as linear forms. Terms with the same value in both accesses cancel;
// values that may differ between them are separate unknowns, of which only a
// range is known. The accesses are disjoint if the difference of some index
// cannot be zero.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/IndexDigits.h"
#include "tai/Analysis/IterationOrder.h"
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

/// The known range of a term of an index.
static Interval getInterval(Value value) {
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
    // Bounds that are compared without a sign are none of signed numbers.
    if (serial.getUnsignedCmp() &&
        !(range.low && range.high && *range.low >= 0 && *range.high >= -1))
      range = Interval();
  } else if (auto parallel = dyn_cast_if_present<ParallelForOp>(loop)) {
    if (std::optional<LoopBox> box = getConstantBox(parallel))
      if (std::optional<unsigned> dim = box->find(value))
        range = {box->lower[*dim], box->upper[*dim] - 1};
  }
  return range;
}

namespace {
/// The distance of the second of two accesses from the first: in the same
/// iteration of all loops around both (no loop), or in a later one of a serial
/// loop, by the same positive number of steps of all values known to move.
struct Later {
  Operation *loop = nullptr;
  /// Values that grow by a constant, possibly negative, in each iteration.
  SmallVector<std::pair<Value, int64_t>, 2> moving;
  /// Values of the loop, or of both regions of one, that are the same.
  SmallVector<Value, 2> same;
  /// Iterations between the first and the last, if known.
  std::optional<int64_t> most;
  /// Whether indices wrap around only where they are known to.
  bool inRange = false;

  bool moves(Value value) const {
    return llvm::any_of(moving,
                        [&](auto &entry) { return entry.first == value; });
  }
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

/// The form in terms of the values with which a loop `scf.while` begins an
/// iteration: its second region is given values of the first one.
static LinearIndex getForm(Value value) {
  LinearIndex form = getLinearIndex(value);
  for (unsigned round = 0; round != 4; ++round) {
    bool changed = false;
    LinearIndex next;
    next.constant = form.constant;
    next.mayWrap = form.mayWrap;
    auto add = [&](Value term, int64_t factor) {
      auto *it = llvm::find_if(
          next.terms, [&](auto &known) { return known.first == term; });
      if (it == next.terms.end())
        next.terms.emplace_back(term, factor);
      else
        it->second += factor;
    };
    for (auto [term, factor] : form.terms) {
      auto argument = dyn_cast<BlockArgument>(term);
      auto loop = dyn_cast_if_present<scf::WhileOp>(getLoopOf(term));
      if (!argument || !loop || argument.getOwner() != loop.getAfterBody()) {
        add(term, factor);
        continue;
      }
      LinearIndex passed = getLinearIndex(
          loop.getConditionOp().getArgs()[argument.getArgNumber()]);
      next.constant += factor * passed.constant;
      next.mayWrap |= passed.mayWrap;
      for (auto [inner, innerFactor] : passed.terms)
        add(inner, factor * innerFactor);
      changed = true;
    }
    llvm::erase_if(next.terms, [](auto &term) { return term.second == 0; });
    form = std::move(next);
    if (!changed)
      break;
  }
  return form;
}

/// True if a product in the form is known to leave 32 bits.
static bool isKnownToWrap(const LinearIndex &form) {
  __int128 low = form.constant, high = form.constant;
  for (auto [value, factor] : form.terms) {
    Interval range = getInterval(value);
    if (!range.low || !range.high)
      return false;
    low +=
        static_cast<__int128>(factor) * (factor > 0 ? *range.low : *range.high);
    high +=
        static_cast<__int128>(factor) * (factor > 0 ? *range.high : *range.low);
  }
  return low < std::numeric_limits<int32_t>::min() ||
         high > std::numeric_limits<int32_t>::max();
}

/// True if the indices differ whenever `second` is so much later.
static bool areApart(const LinearIndex &first, const LinearIndex &second,
                     Block *common, const Later &later) {
  auto isShared = [&](Value value) {
    if (llvm::is_contained(later.same, value))
      return true;
    Operation *owner = value.getParentBlock()->getParentOp();
    return later.loop ? !later.loop->isAncestor(owner)
                      : owner->isAncestor(common->getParentOp());
  };
  Difference difference;
  difference.addConstant(first.constant - second.constant);
  // Terms that cancel are not looked at: ranges come from the layout.
  auto addUnknown = [&](int64_t factor, Value value) {
    if (factor != 0)
      difference.addUnknown(factor, getInterval(value));
  };
  // A moving term lies a positive number of steps ahead.
  int64_t perStep = 0;
  for (auto [value, step] : later.moving) {
    perStep -= second.getCoefficient(value) * step;
    addUnknown(first.getCoefficient(value) - second.getCoefficient(value),
               value);
  }
  difference.addUnknown(perStep, {1, later.most});
  auto addTerms = [&](const LinearIndex &form, int64_t sign) {
    for (auto [value, factor] : form.terms) {
      if (later.moves(value))
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
      addUnknown(rest, value);
    }
  };
  addTerms(first, 1);
  addTerms(second, -1);
  auto wraps = [&](const LinearIndex &form) {
    return form.mayWrap && (!later.inRange || isKnownToWrap(form));
  };
  return difference.cannotBeZero(wraps(first) || wraps(second));
}

/// The same of lists of values of equal length.
static bool areApart(ValueRange first, ValueRange second, Block *common,
                     const Later &later) {
  return llvm::any_of(llvm::zip(first, second), [&](auto pair) {
    auto [lhs, rhs] = pair;
    return areApart(getForm(lhs), getForm(rhs), common, later);
  });
}

/// The ways in which an iteration of `loop` can be later than another.
static SmallVector<Later> getWays(Operation *loop) {
  SmallVector<Later> ways;
  Later later;
  later.loop = loop;
  // False if the loop index has one value at most.
  auto setMost = [&](Value iv, int64_t step) {
    Interval range = getInterval(iv);
    if (range.low && range.high)
      later.most = (*range.high - *range.low) / step;
    else
      later.most = std::nullopt;
    return !later.most || *later.most > 0;
  };
  if (auto serial = dyn_cast<scf::ForOp>(loop)) {
    // Steps are positive.
    int64_t step =
        std::max<int64_t>(getConstant(serial.getStep()).value_or(1), 1);
    later.moving.emplace_back(serial.getInductionVar(), step);
    if (!setMost(serial.getInductionVar(), step))
      return ways;
  } else if (auto parallel = dyn_cast<ParallelForOp>(loop)) {
    // In order of the last induction variable, then of the one before.
    for (BlockArgument iv : parallel.getInductionVars()) {
      later.moving.assign({{iv, 1}});
      if (setMost(iv, 1))
        ways.push_back(later);
      later.same.push_back(iv);
    }
    return ways;
  } else if (auto whileOp = dyn_cast<scf::WhileOp>(loop)) {
    for (auto [argument, next] : llvm::zip(whileOp.getBeforeArguments(),
                                           whileOp.getYieldOp().getOperands()))
      if (argument.getType().isIntOrIndex()) {
        LinearIndex form = getForm(next);
        if (form.terms.size() == 1 && form.getCoefficient(argument) == 1)
          later.moving.emplace_back(argument, form.constant);
      }
  }
  ways.push_back(later);
  return ways;
}

bool mlir::tai::mayMeet(ParallelForOp loop, ElementPlace first,
                        ElementPlace second) {
  Block *body = &loop.getBody().front();
  auto areApartIn = [&](ValueRange a, ValueRange b, const Later &later) {
    return a.size() == b.size() && areApart(a, b, body, later);
  };
  auto numbers = findNumbersOfDigits(first.indices, second.indices, loop);
  auto areNumbersApart = [&](const Later &later, bool isSwapped) {
    return llvm::any_of(numbers, [&](auto &pair) {
      LinearIndex a = getForm(pair.first), b = getForm(pair.second);
      return isSwapped ? areApart(b, a, body, later)
                       : areApart(a, b, body, later);
    });
  };
  return llvm::any_of(getWays(loop), [&](Later &later) {
    later.inRange = true;
    auto mayAlias = [&](const ElementPlace &a, const ElementPlace &b) {
      return !areApartIn(a.indices, b.indices, later) &&
             !areApartIn(a.components, b.components, later);
    };
    return (mayAlias(first, second) && !areNumbersApart(later, false)) ||
           (mayAlias(second, first) && !areNumbersApart(later, true));
  });
}

bool mlir::tai::mayReachLater(DifferentiableAccessInterface first,
                              DifferentiableAccessInterface second,
                              Block *scope) {
  Operation *firstUp = first, *secondUp = second;
  Block *common = findCommonBlock(firstUp, secondUp);
  if (!common)
    return true;
  auto mayAlias = [&](const Later &later) {
    if (first.getAccessIndices().size() == second.getAccessIndices().size() &&
        areApart(first.getAccessIndices(), second.getAccessIndices(), common,
                 later))
      return false;
    ValueRange parts = first.getAccessComponents();
    ValueRange otherParts = second.getAccessComponents();
    return parts.size() != otherParts.size() || parts.empty() ||
           !areApart(parts, otherParts, common, later);
  };
  Later inSame;
  bool follows;
  Operation *loop = common->getParentOp();
  if (firstUp != secondUp) {
    follows = firstUp->isBeforeInBlock(secondUp);
  } else if (auto whileOp = dyn_cast<scf::WhileOp>(firstUp);
             whileOp && first != second) {
    // The second region runs after the first; in the next iteration it is the
    // other way round.
    follows = whileOp.getBefore().isAncestor(first->getParentRegion());
    llvm::append_range(inSame.same, whileOp.getBeforeArguments());
    loop = whileOp;
  } else {
    // Arms of a branch exclude each other.
    follows = first != second && !isa<scf::IfOp>(firstUp);
  }
  if (follows && mayAlias(inSame))
    return true;
  for (; loop && !isa<FunctionOpInterface>(loop) &&
         !(scope && loop == scope->getParentOp());
       loop = loop->getParentOp())
    if (isSerialLoop(loop) && llvm::any_of(getWays(loop), mayAlias))
      return true;
  return false;
}
