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

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/IndexDigits.h"
#include "tai/Analysis/IterationOrder.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

bool mlir::tai::isSerialLoop(Operation *op) {
  if (!isa<LoopLikeOpInterface>(op) || isa<scf::ParallelOp>(op))
    return false;
  auto parallel = dyn_cast<ParallelForOp>(op);
  return !parallel || parallel.getSerialize();
}

static std::optional<int64_t> getConstant(Value value) {
  APInt constant;
  if (!matchPattern(value, m_ConstantInt(&constant)) ||
      constant.getSignificantBits() > 64)
    return std::nullopt;
  return constant.getSExtValue();
}

/// True for an index of a loop whose bounds are constants: it has all values of
/// its range.
static bool hasConstantBounds(Value value) {
  Operation *loop = getLoopOf(value);
  if (auto serial = dyn_cast_if_present<scf::ForOp>(loop))
    return value == serial.getInductionVar() &&
           getConstant(serial.getLowerBound()) &&
           getConstant(serial.getUpperBound());
  auto parallel = dyn_cast_if_present<ParallelForOp>(loop);
  return parallel && getConstantBox(parallel);
}

namespace {
/// The distance of the second of two accesses from the first: in the same
/// iteration of all loops around both (no loop), or in a later one of a serial
/// loop, by the same positive number of steps of all values known to move.
struct Later {
  Operation *loop = nullptr;
  /// Values that grow by a constant, possibly negative, in each iteration.
  SmallVector<std::pair<Value, int64_t>, 2> moving;
  /// Moving values count modulo two to this.
  unsigned width = 64;
  /// Values of the loop, or of both regions of one, that are the same.
  SmallVector<Value, 2> same;
  /// Iterations between the first and the last, at most.
  __int128 most = kMostIterations;
  /// Whether indices wrap around only where they are known to.
  bool inRange = false;

  bool moves(Value value) const {
    return llvm::any_of(moving,
                        [&](auto &entry) { return entry.first == value; });
  }
};
} // namespace

/// The form in terms of the values with which a loop `scf.while` begins an
/// iteration: its second region is given values of the first one.
static IndexExpr getForm(IndexBuilder &builder, Value value) {
  IndexExpr form = builder.get(value);
  for (unsigned round = 0; round != 4; ++round) {
    IndexExpr next =
        form.substitute([&](Value term) -> std::optional<IndexExpr> {
          auto argument = dyn_cast<BlockArgument>(term);
          auto loop = dyn_cast_if_present<scf::WhileOp>(getLoopOf(term));
          if (!argument || !loop || argument.getOwner() != loop.getAfterBody())
            return std::nullopt;
          Value passed =
              loop.getConditionOp().getArgs()[argument.getArgNumber()];
          IndexExpr expr = builder.get(passed);
          return expr.isExact() ? expr : IndexExpr(passed);
        });
    if (next == form)
      break;
    form = std::move(next);
  }
  return form;
}

/// True if arithmetic of the form is known to leave its type in some iteration.
static bool isKnownToWrap(IndexBuilder &builder, const IndexExpr &form) {
  return form.allOf(hasConstantBounds) &&
         !builder.getRange(form).fits(form.width);
}

/// True if the indices differ whenever `second` is so much later.
static bool areApart(IndexBuilder &builder, const IndexExpr &first,
                     const IndexExpr &second, Block *common,
                     const Later &later) {
  auto isShared = [&](Value value) {
    if (llvm::is_contained(later.same, value))
      return true;
    Operation *owner = value.getParentBlock()->getParentOp();
    return later.loop ? !later.loop->isAncestor(owner)
                      : owner->isAncestor(common->getParentOp());
  };
  // Terms that both share cancel.
  IndexExpr shared;
  IndexDifference difference;
  // A moving term lies a positive number of steps ahead.
  int64_t perStep = 0;
  for (auto [value, step] : later.moving) {
    perStep -= second.getCoefficient(value) * step;
    int64_t factor = first.getCoefficient(value) - second.getCoefficient(value);
    if (factor != 0)
      difference.addUnknown(factor, builder.getRange(IndexAtom(value)));
  }
  difference.addUnknown(perStep, {1, later.most});
  auto addTerms = [&](const IndexExpr &form, int64_t sign) {
    difference.addConstant(static_cast<__int128>(sign) * form.constant);
    for (const auto &[atom, factor] : form.terms)
      if (atom.allOf(isShared))
        shared.add(IndexExpr(atom), sign * factor);
      else if (!atom.getValue() || !later.moves(atom.getValue()))
        difference.addUnknown(sign * factor, builder.getRange(atom));
  };
  addTerms(first, 1);
  addTerms(second, -1);
  for (const auto &[atom, factor] : shared.terms)
    difference.addUnknown(factor, builder.getRange(atom));
  auto widthOf = [&](const IndexExpr &form) {
    return later.inRange && !isKnownToWrap(builder, form) ? 64 : form.width;
  };
  return !difference.canBeZero(
      std::min({widthOf(first), widthOf(second), later.width}));
}

/// The same of lists of values of equal length.
static bool areApart(IndexBuilder &builder, ValueRange first, ValueRange second,
                     Block *common, const Later &later) {
  return llvm::any_of(llvm::zip(first, second), [&](auto pair) {
    auto [lhs, rhs] = pair;
    return areApart(builder, getForm(builder, lhs), getForm(builder, rhs),
                    common, later);
  });
}

/// True if no two iterations of `loop` have all indices in common, because both
/// lists are the same expressions, which tell iterations apart.
static bool tellApart(IndexBuilder &builder, Operation *loop, ValueRange first,
                      ValueRange second) {
  std::optional<SmallVector<Value>> ivs;
  if (isa<scf::ForOp, ParallelForOp>(loop))
    ivs = cast<LoopLikeOpInterface>(loop).getLoopInductionVars();
  if (!ivs || ivs->empty())
    return false;
  SmallVector<IndexExpr> common;
  for (auto [lhs, rhs] : llvm::zip(first, second)) {
    IndexExpr expr = builder.get(lhs);
    if (lhs == rhs || expr == builder.get(rhs))
      common.push_back(expr);
  }
  return !common.empty() && isInjectiveOver(builder, common, *ivs);
}

/// The ways in which an iteration of `loop` can be later than another.
static SmallVector<Later> getWays(IndexBuilder &builder, Operation *loop) {
  SmallVector<Later> ways;
  Later later;
  later.loop = loop;
  // False if the loop index has one value at most.
  auto setMost = [&](Value iv, int64_t step) {
    IndexRange range = builder.getRange(IndexAtom(iv));
    later.most =
        std::min<__int128>((range.high - range.low) / step, kMostIterations);
    return later.most > 0;
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
        IndexExpr form = getForm(builder, next);
        if (form.width < 32 || form.terms.size() != 1 ||
            form.getCoefficient(argument) != 1)
          continue;
        later.moving.emplace_back(argument, form.constant);
        // A counter does not run so long that it is where it was.
        later.width = std::min(later.width, form.width);
        later.most = std::min(
            later.most, (static_cast<__int128>(1) << form.width) /
                                std::max<__int128>(std::abs(form.constant), 1) -
                            1);
      }
  }
  ways.push_back(later);
  return ways;
}

bool mlir::tai::mayMeet(ParallelForOp loop, ElementPlace first,
                        ElementPlace second) {
  Block *body = &loop.getBody().front();
  IndexBuilder builder;
  auto areApartIn = [&](ValueRange a, ValueRange b, const Later &later) {
    return a.size() == b.size() && areApart(builder, a, b, body, later);
  };
  if (first.indices.size() == second.indices.size() &&
      tellApart(builder, loop, first.indices, second.indices))
    return false;
  auto numbers = findNumbersOfDigits(first.indices, second.indices, loop);
  auto areNumbersApart = [&](const Later &later, bool isSwapped) {
    return llvm::any_of(numbers, [&](auto &pair) {
      IndexExpr a = getForm(builder, pair.first);
      IndexExpr b = getForm(builder, pair.second);
      return isSwapped ? areApart(builder, b, a, body, later)
                       : areApart(builder, a, b, body, later);
    });
  };
  return llvm::any_of(getWays(builder, loop), [&](Later &later) {
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
  IndexBuilder builder;
  auto mayAlias = [&](const Later &later) {
    if (first.getAccessIndices().size() == second.getAccessIndices().size() &&
        areApart(builder, first.getAccessIndices(), second.getAccessIndices(),
                 common, later))
      return false;
    ValueRange parts = first.getAccessComponents();
    ValueRange otherParts = second.getAccessComponents();
    return parts.size() != otherParts.size() || parts.empty() ||
           !areApart(builder, parts, otherParts, common, later);
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
    if (isSerialLoop(loop) &&
        !(first.getAccessIndices().size() == second.getAccessIndices().size() &&
          tellApart(builder, loop, first.getAccessIndices(),
                    second.getAccessIndices())) &&
        llvm::any_of(getWays(builder, loop), mayAlias))
      return true;
  return false;
}
