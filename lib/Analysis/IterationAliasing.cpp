//===- IterationAliasing.cpp - Aliasing between iterations ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Decides whether a later access may reach the element of an earlier one.
// Indices are compared as linear forms. Terms with the same value in both
// accesses cancel; values that may differ between the accesses are separate
// unknowns with known ranges. The accesses are disjoint if the difference of
// some index cannot be zero.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/Accesses.h"
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

/// True for the index of a loop with constant bounds, which takes all values of
/// its range.
static bool hasConstantBounds(Value value) {
  Operation *loop = getLoopOf(value);
  if (auto serial = dyn_cast_if_present<scf::ForOp>(loop))
    return value == serial.getInductionVar() &&
           getConstantIntValue(serial.getLowerBound()) &&
           getConstantIntValue(serial.getUpperBound());
  auto parallel = dyn_cast_if_present<ParallelForOp>(loop);
  return parallel && getConstantBox(parallel);
}

namespace {
/// One way in which an access can come later than another: in the same
/// iteration of all loops around both (`loop` is null), or in a later iteration
/// of `loop`. In the latter case, all `moving` values are ahead by the same
/// positive number of steps.
struct Later {
  Operation *loop = nullptr;
  /// Values that grow by a constant in each iteration, each with its constant,
  /// which may be negative.
  SmallVector<std::pair<Value, int64_t>, 2> moving;
  /// The number of low bits in which the moving values grow by that constant.
  unsigned width = 64;
  /// Values that change in the loop (or in the two regions of a while loop) but
  /// have the same value in both accesses.
  SmallVector<Value, 2> same;
  /// An upper bound of the number of iterations between the two accesses.
  __int128 most = kMostIterations;
  /// True if indices are assumed to be in range, and so not to wrap around,
  /// unless they are known to wrap.
  bool inRange = false;

  bool moves(Value value) const {
    return llvm::any_of(moving,
                        [&](auto &entry) { return entry.first == value; });
  }
};
} // namespace

/// Rewrites an expression in terms of the values with which an iteration of
/// `scf.while` begins: arguments of its second region are replaced by the
/// values that its first region passes on.
static IndexExpr getForm(IndexBuilder &builder, IndexExpr form) {
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

/// True if the arithmetic of `form` certainly overflows its type in some
/// iteration.
static bool isKnownToWrap(IndexBuilder &builder, const IndexExpr &form) {
  return form.allOf(hasConstantBounds) &&
         !builder.getRange(form).fits(form.width);
}

/// True if the index `first` of one access and the index `second` of a later
/// access certainly differ, where `later` says in which way the second access
/// is later.
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
  // Terms that have the same value in both accesses cancel in the difference.
  IndexExpr shared;
  IndexDifference difference;
  // The moving terms of the second access are ahead by a positive number of
  // steps.
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

/// True if two lists of indices of equal length certainly differ in at least
/// one index.
static bool areApart(IndexBuilder &builder, ValueRange first, ValueRange second,
                     Block *common, const Later &later) {
  return llvm::any_of(llvm::zip(first, second), [&](auto pair) {
    auto [lhs, rhs] = pair;
    return areApart(builder, getForm(builder, builder.get(lhs)),
                    getForm(builder, builder.get(rhs)), common, later);
  });
}

/// True if equal indices imply the same iteration of `loop`.
static bool tellApart(IndexBuilder &builder, Operation *loop, ValueRange first,
                      ValueRange second) {
  if (!isa<scf::ForOp, ParallelForOp>(loop) || first.size() != second.size())
    return false;
  IterationEquations equations(builder, loop);
  equations.add(first, second);
  return equations.solve(
      *cast<LoopLikeOpInterface>(loop).getLoopInductionVars());
}

/// Lists the conditions under which one iteration of `loop` comes after
/// another.
static SmallVector<Later> getWays(IndexBuilder &builder, Operation *loop) {
  SmallVector<Later> ways;
  Later later;
  later.loop = loop;
  // Bounds the number of steps by the range of the loop index. False if that
  // index has at most one value.
  auto setMost = [&](Value iv, int64_t step) {
    IndexRange range = builder.getRange(IndexAtom(iv));
    later.most =
        std::min<__int128>((range.high - range.low) / step, kMostIterations);
    return later.most > 0;
  };
  if (auto serial = dyn_cast<scf::ForOp>(loop)) {
    // Steps are positive.
    int64_t step =
        std::max<int64_t>(getConstantIntValue(serial.getStep()).value_or(1), 1);
    later.moving.emplace_back(serial.getInductionVar(), step);
    if (!setMost(serial.getInductionVar(), step))
      return ways;
  } else if (auto parallel = dyn_cast<ParallelForOp>(loop)) {
    // Iterations of a loop with several indices are ordered lexicographically:
    // `same` has the outer indices, which are equal in both iterations, and
    // `iv` is the first index that differs.
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
        IndexExpr form = getForm(builder, builder.get(next));
        if (form.width < 32 || form.terms.size() != 1 ||
            form.getCoefficient(argument) != 1)
          continue;
        later.moving.emplace_back(argument, form.constant);
        // A counter is assumed to make too few steps to wrap around to an
        // earlier value.
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
  IterationEquations equations(builder, loop);
  if (first.indices.size() == second.indices.size())
    equations.add(first.indices, second.indices);
  if (first.components.size() == second.components.size())
    equations.add(first.components, second.components);
  SmallVector<Value> ivs(loop.getInductionVars());
  if (equations.solve(ivs) && !ivs.empty())
    return false;
  return llvm::any_of(getWays(builder, loop), [&](Later &later) {
    later.inRange = true;
    auto mayHold = [&](bool isSwapped) {
      return llvm::none_of(equations.get(), [&](const auto &equation) {
        IndexExpr a = getForm(builder, equation.first);
        IndexExpr b = getForm(builder, equation.second);
        return areApart(builder, isSwapped ? b : a, isSwapped ? a : b, body,
                        later);
      });
    };
    return mayHold(false) || mayHold(true);
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
    // In an iteration of an scf.while, the second region runs after the first
    // region; in the order of all iterations, the first region runs after the
    // second region of the iteration before.
    follows = whileOp.getBefore().isAncestor(first->getParentRegion());
    llvm::append_range(inSame.same, whileOp.getBeforeArguments());
    loop = whileOp;
  } else {
    // In the same iteration, only one arm of an scf.if runs.
    follows = first != second && !isa<scf::IfOp>(firstUp);
  }
  if (follows && mayAlias(inSame))
    return true;
  for (; loop && !isa<FunctionOpInterface>(loop) &&
         !(scope && loop == scope->getParentOp());
       loop = loop->getParentOp())
    if (isSerialLoop(loop) &&
        !tellApart(builder, loop, first.getAccessIndices(),
                   second.getAccessIndices()) &&
        llvm::any_of(getWays(builder, loop), mayAlias))
      return true;
  return false;
}
