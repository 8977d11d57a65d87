//===- VersionRanges.cpp - Interiors of ranges of the launch --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `tai-version-interior` evaluates conditions over constant ranges. Where the
// range is known at the launch, a condition is decided by the distance of its
// sides from the ends of the range: i + 1 < n, with i < n - w, holds for w >=
// 1, whatever n is.
//
//===----------------------------------------------------------------------===//

#include "VersionRemarks.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/Index/IndexBuilder.h"
#include "tai/Analysis/IndexBounds.h"
#include "tai/Analysis/IterationOrder.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Analysis/Reductions/ReductionPlan.h"
#include "tai/Interfaces/Differentiable.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Utils/ArrayRanges.h"
#include "llvm/ADT/MapVector.h"

namespace mlir::tai {
#define GEN_PASS_DEF_VERSIONRANGES
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// The most iterations at one end of a range that are not in the interior.
constexpr int64_t kMaxWidth = 16;
/// Bounds and constants up to these have sums that fit 32 bits.
constexpr int64_t kSmallBound = int64_t(1) << 30;
constexpr int64_t kSmallConstant = int64_t(1) << 20;

namespace {
/// Bounds of a number over the iterations from lower + w to upper - w - 1 along
/// index `k`: it is at least `least` + w, and at most `most` - w.
struct SlidingBounds {
  unsigned k = 0;
  std::optional<int64_t> least, most;

  /// The least w for which the number is at least, or at most, `limit`.
  std::optional<int64_t> widthForAtLeast(int64_t limit) const {
    return least ? std::optional(std::max<int64_t>(0, limit - *least))
                 : std::nullopt;
  }
  std::optional<int64_t> widthForAtMost(int64_t limit) const {
    return most ? std::optional(std::max<int64_t>(0, *most - limit))
                : std::nullopt;
  }
};

/// The value in the interior of a value of the body.
struct Decision {
  Value value;
  /// A truth value, an operand of the op, or an index plus a constant.
  std::optional<bool> answer;
  Value operand;
  int64_t offset = 0;
};

/// Decides values of the body, and finds the widths for which this holds.
class RangeDecider {
public:
  explicit RangeDecider(ParallelForOp loop)
      : loop(loop), widths(loop.getInductionVars().size()) {}

  /// False if there is nothing to decide.
  bool run();
  ArrayRef<Decision> getDecisions() const { return decisions; }
  ArrayRef<int64_t> getWidths() const { return widths; }
  /// Whether decisions assume that the bounds of the loop are small enough for
  /// integers of 32 bits to hold indices.
  bool needsSmallBounds() const { return isSmall; }

private:
  IndexExpr getExpr(Value value);
  bool isBounded(const IndexAtom &atom);
  std::optional<SlidingBounds> getBounds(const IndexExpr &expr);
  bool accept(const SlidingBounds &bounds, std::optional<int64_t> width);
  bool isNonNegative(Value value);
  void decideTruth(Value value, bool answer);
  void decideComparison(arith::CmpIOp op);
  void decideExtreme(Operation *op);
  void decideRemainder(Operation *op);
  void decideChoice(arith::SelectOp op);
  void decideIndex(Value value);

  ParallelForOp loop;
  IndexBuilder builder;
  SmallVector<int64_t> widths;
  SmallVector<Decision> decisions;
  /// The results of decided ops in the interior.
  llvm::DenseMap<Value, IndexExpr> known;
  llvm::DenseMap<Value, bool> answers;
  bool isSmall = false;
};
} // namespace

/// Whether `atom` is an index of the loop, or a bound of the loop is `atom`
/// plus a small constant.
bool RangeDecider::isBounded(const IndexAtom &atom) {
  if (llvm::is_contained(loop.getInductionVars(), atom.getValue()))
    return true;
  return llvm::any_of(loop->getOperands(), [&](Value bound) {
    IndexExpr rest = builder.get(bound);
    rest.add(IndexExpr(atom), -1);
    return rest.isConstant() && rest.isExact() &&
           std::abs(rest.constant) <= kSmallConstant;
  });
}

/// The expression of a value in the interior. A sum of 32 bits is exact if the
/// bounds of the loop are small.
IndexExpr RangeDecider::getExpr(Value value) {
  auto found = known.find(value);
  if (found != known.end())
    return found->second;
  IndexExpr expr = builder.get(value);
  if (expr.isExact() || expr.width < 32 || expr.terms.size() != 1 ||
      std::abs(expr.terms[0].second) != 1 ||
      std::abs(expr.constant) > kSmallConstant ||
      !isBounded(expr.terms[0].first))
    return expr;
  isSmall = true;
  expr.width = 64;
  return expr;
}

/// The bounds of an expression in one index of the loop, whose distance from an
/// end of the range is a constant.
std::optional<SlidingBounds> RangeDecider::getBounds(const IndexExpr &expr) {
  if (!expr.isExact())
    return std::nullopt;
  SlidingBounds bounds;
  int64_t factor = 0;
  for (auto [k, iv] : llvm::enumerate(loop.getInductionVars())) {
    int64_t here = expr.getCoefficient(iv);
    if (here != 0 && factor != 0)
      return std::nullopt;
    if (here != 0) {
      factor = here;
      bounds.k = k;
    }
  }
  if (std::abs(factor) != 1)
    return std::nullopt;
  IndexExpr rest = expr;
  rest.add(IndexExpr(Value(loop.getInductionVars()[bounds.k])), -factor);
  auto getDistance = [&](Value end) -> std::optional<int64_t> {
    IndexExpr distance = rest;
    distance.add(builder.get(end), factor);
    return distance.isConstant() && distance.isExact()
               ? std::optional(distance.constant)
               : std::nullopt;
  };
  std::optional<int64_t> atLower = getDistance(loop.getLowerBounds()[bounds.k]);
  std::optional<int64_t> atUpper = getDistance(loop.getUpperBounds()[bounds.k]);
  if (factor == 1) {
    bounds.least = atLower;
    if (atUpper)
      bounds.most = *atUpper - 1;
  } else {
    bounds.most = atLower;
    if (atUpper)
      bounds.least = *atUpper + 1;
  }
  return bounds;
}

/// Widens the ends of the range if the width is not too large.
bool RangeDecider::accept(const SlidingBounds &bounds,
                          std::optional<int64_t> width) {
  if (!width || *width > kMaxWidth)
    return false;
  widths[bounds.k] = std::max(widths[bounds.k], *width);
  return true;
}

void RangeDecider::decideComparison(arith::CmpIOp op) {
  auto mixed = op.getLhs().getDefiningOp<arith::XOrIOp>();
  if (mixed && op.getPredicate() == arith::CmpIPredicate::slt &&
      matchPattern(op.getRhs(), m_Zero()) && isNonNegative(mixed.getLhs()) &&
      isNonNegative(mixed.getRhs()))
    return decideTruth(op.getResult(), false);
  IndexExpr difference = getExpr(op.getLhs());
  difference.add(getExpr(op.getRhs()), -1);
  std::optional<SlidingBounds> bounds = getBounds(difference);
  if (!bounds)
    return;
  auto decide = [&](std::optional<int64_t> width, bool answer) {
    bool accepted = accept(*bounds, width);
    if (accepted)
      decideTruth(op.getResult(), answer);
    return accepted;
  };
  using Predicate = arith::CmpIPredicate;
  switch (op.getPredicate()) {
  case Predicate::slt:
    (void)(decide(bounds->widthForAtMost(-1), true) ||
           decide(bounds->widthForAtLeast(0), false));
    return;
  case Predicate::sle:
    (void)(decide(bounds->widthForAtMost(0), true) ||
           decide(bounds->widthForAtLeast(1), false));
    return;
  case Predicate::sgt:
    (void)(decide(bounds->widthForAtLeast(1), true) ||
           decide(bounds->widthForAtMost(0), false));
    return;
  case Predicate::sge:
    (void)(decide(bounds->widthForAtLeast(0), true) ||
           decide(bounds->widthForAtMost(-1), false));
    return;
  case Predicate::eq:
  case Predicate::ne:
    (void)(decide(bounds->widthForAtLeast(1),
                  op.getPredicate() == Predicate::ne) ||
           decide(bounds->widthForAtMost(-1),
                  op.getPredicate() == Predicate::ne));
    return;
  default:
    return;
  }
}

void RangeDecider::decideExtreme(Operation *op) {
  Value lhs = op->getOperand(0), rhs = op->getOperand(1);
  IndexExpr difference = getExpr(lhs);
  difference.add(getExpr(rhs), -1);
  std::optional<SlidingBounds> bounds = getBounds(difference);
  if (!bounds)
    return;
  bool isMin = isa<arith::MinSIOp>(op);
  Value chosen;
  if (accept(*bounds, bounds->widthForAtMost(0)))
    chosen = isMin ? lhs : rhs;
  else if (accept(*bounds, bounds->widthForAtLeast(0)))
    chosen = isMin ? rhs : lhs;
  else
    return;
  decisions.push_back({op->getResult(0), {}, chosen, 0});
  known[op->getResult(0)] = getExpr(chosen);
}

/// Decides a remainder whose dividend is between zero and the divisor.
void RangeDecider::decideRemainder(Operation *op) {
  IndexExpr dividend = getExpr(op->getOperand(0)), beyond = dividend;
  beyond.add(getExpr(op->getOperand(1)), -1);
  std::optional<SlidingBounds> bounds = getBounds(dividend);
  std::optional<SlidingBounds> above = getBounds(beyond);
  if (!bounds || !above)
    return;
  std::optional<int64_t> low = bounds->widthForAtLeast(0);
  std::optional<int64_t> high = above->widthForAtMost(-1);
  if (!low || *low > kMaxWidth || !accept(*above, high))
    return;
  (void)accept(*bounds, low);
  decisions.push_back({op->getResult(0), {}, op->getOperand(0), 0});
  known[op->getResult(0)] = dividend;
}

/// Whether a value is no negative number in the interior.
bool RangeDecider::isNonNegative(Value value) {
  IndexExpr expr = getExpr(value);
  if (std::optional<SlidingBounds> bounds = getBounds(expr))
    return accept(*bounds, bounds->widthForAtLeast(0));
  // A bound above a range that is not empty and begins at zero or more.
  for (auto [lower, upper] :
       llvm::zip(loop.getLowerBounds(), loop.getUpperBounds())) {
    IndexExpr least = builder.get(lower), rest = expr;
    rest.add(builder.get(upper), -1);
    if (least.isConstant() && rest.isConstant() && rest.isExact() &&
        least.constant >= 0 && rest.constant >= -least.constant)
      return true;
  }
  return false;
}

void RangeDecider::decideTruth(Value value, bool answer) {
  decisions.push_back({value, answer, {}, 0});
  answers[value] = answer;
}

void RangeDecider::decideChoice(arith::SelectOp op) {
  auto found = answers.find(op.getCondition());
  if (found == answers.end())
    return;
  Value chosen = found->second ? op.getTrueValue() : op.getFalseValue();
  decisions.push_back({op.getResult(), {}, chosen, 0});
  if (chosen.getType().isIntOrIndex())
    known[op.getResult()] = getExpr(chosen);
}

/// Writes an index that is computed in 32 bits, or is known in the interior
/// alone, as an index of the loop plus a constant.
void RangeDecider::decideIndex(Value value) {
  IndexExpr here = builder.get(value);
  Value narrow = value.getDefiningOp()->getOperand(0);
  IndexExpr expr = getExpr(narrow);
  if (!expr.isExact() || expr.terms.size() != 1 || expr.terms[0].second != 1 ||
      (here.isExact() && here == expr))
    return;
  Value iv = expr.terms[0].first.getValue();
  if (!iv || !llvm::is_contained(loop.getInductionVars(), iv))
    return;
  decisions.push_back({value, {}, iv, expr.constant});
  known[value] = expr;
}

bool RangeDecider::run() {
  loop.getBody().walk([&](Operation *op) {
    if (op->getNumResults() != 1 || op->getNumRegions() != 0)
      return;
    Value result = op->getResult(0);
    if (auto choice = dyn_cast<arith::SelectOp>(op))
      return decideChoice(choice);
    if (auto comparison = dyn_cast<arith::CmpIOp>(op))
      return decideComparison(comparison);
    if (isa<arith::MinSIOp, arith::MaxSIOp>(op))
      return decideExtreme(op);
    if (isa<arith::RemSIOp, arith::RemUIOp>(op))
      return decideRemainder(op);
    if (isa<arith::IndexCastOp>(op) && result.getType().isIndex())
      return decideIndex(result);
    if (!isa<arith::AndIOp, arith::OrIOp>(op) || !result.getType().isInteger(1))
      return;
    bool decides = isa<arith::OrIOp>(op);
    auto lhs = answers.find(op->getOperand(0));
    auto rhs = answers.find(op->getOperand(1));
    bool hasLhs = lhs != answers.end(), hasRhs = rhs != answers.end();
    if ((hasLhs && lhs->second == decides) ||
        (hasRhs && rhs->second == decides))
      decideTruth(result, decides);
    else if (hasLhs && hasRhs)
      decideTruth(result, !decides);
  });
  return llvm::any_of(widths, [](int64_t width) { return width != 0; });
}

//===----------------------------------------------------------------------===//
// The loops
//===----------------------------------------------------------------------===//

/// Puts the decided values into a copy of the loop.
static void apply(ArrayRef<Decision> decisions, IRMapping &mapping) {
  for (const Decision &decision : decisions) {
    Value value = mapping.lookup(decision.value);
    ImplicitLocOpBuilder b(value.getLoc(), value.getDefiningOp());
    Value known;
    if (decision.answer) {
      known = arith::ConstantOp::create(b, b.getBoolAttr(*decision.answer));
    } else {
      known = mapping.lookupOrDefault(decision.operand);
      if (decision.offset != 0)
        known = arith::AddIOp::create(
            b, known, arith::ConstantIndexOp::create(b, decision.offset));
      if (known.getType() != value.getType())
        known = arith::IndexCastOp::create(b, value.getType(), known);
    }
    value.replaceAllUsesWith(known);
  }
}

static void version(ParallelForOp loop, const RangeDecider &decider,
                    const LoopArrays &arrays) {
  ImplicitLocOpBuilder b(loop.getLoc(), loop);
  ArrayRef<int64_t> widths = decider.getWidths();
  auto add = [&](Value value, int64_t constant) -> Value {
    return constant == 0
               ? value
               : arith::AddIOp::create(
                     b, value, arith::ConstantIndexOp::create(b, constant))
                     .getResult();
  };
  Value test = arrays.createTest(b, loop);
  for (auto [lower, upper, width] :
       llvm::zip_equal(loop.getLowerBounds(), loop.getUpperBounds(), widths)) {
    Value length = arith::SubIOp::create(b, upper, lower);
    test = createBoth(
        b, test,
        arith::CmpIOp::create(b, arith::CmpIPredicate::sgt, length,
                              arith::ConstantIndexOp::create(b, 2 * width)));
    if (!decider.needsSmallBounds())
      continue;
    auto isAtMost = [&](Value less, Value more) -> Value {
      return arith::CmpIOp::create(b, arith::CmpIPredicate::sle, less, more);
    };
    test = createBoth(
        b, test,
        isAtMost(arith::ConstantIndexOp::create(b, -kSmallBound), lower));
    test = createBoth(
        b, test,
        isAtMost(upper, arith::ConstantIndexOp::create(b, kSmallBound)));
  }
  auto branch = scf::IfOp::create(b, test, /*withElseRegion=*/true);
  b.setInsertionPointToStart(branch.thenBlock());

  // The range along index `d` for the loop over the ends along index `k`.
  auto getRange = [&](unsigned d, unsigned k) -> std::pair<Value, Value> {
    Value lower = loop.getLowerBounds()[d], upper = loop.getUpperBounds()[d];
    if (d < k)
      return {add(lower, widths[d]), add(upper, -widths[d])};
    if (d == k)
      return {arith::ConstantIndexOp::create(b, 0),
              arith::ConstantIndexOp::create(b, 2 * widths[d])};
    return {lower, upper};
  };
  auto copyLoop = [&](unsigned k, IRMapping &mapping) {
    SmallVector<Value> lower, upper;
    for (unsigned d = 0; d != widths.size(); ++d) {
      auto [from, to] = getRange(d, k);
      lower.push_back(from);
      upper.push_back(to);
    }
    auto copy = cast<ParallelForOp>(b.clone(*loop, mapping));
    copy.getLowerBoundsMutable().assign(lower);
    copy.getUpperBoundsMutable().assign(upper);
    copy->setAttr(kApartAttrName, b.getUnitAttr());
    return copy;
  };
  IRMapping inner;
  (void)copyLoop(widths.size(), inner);
  apply(decider.getDecisions(), inner);
  for (unsigned k = 0; k != widths.size(); ++k) {
    if (widths[k] == 0)
      continue;
    RangeEnds ends{loop.getLowerBounds()[k],
                   add(loop.getUpperBounds()[k], -widths[k]), widths[k]};
    IRMapping mapping;
    ParallelForOp copy = copyLoop(k, mapping);
    copy->setAttr(kFallbackAttrName, b.getUnitAttr());
    // A few iterations are no work for several threads.
    if (widths.size() == 1)
      copy.setSerialize(true);
    Value number = copy.getInductionVars()[k];
    ImplicitLocOpBuilder body(loop.getLoc(), &copy.getBody().front().front());
    Value index = ends.getIndex(body, number);
    llvm::SmallPtrSet<Operation *, 8> made;
    for (Operation &op : copy.getBody().front()) {
      made.insert(&op);
      if (&op == index.getDefiningOp())
        break;
    }
    number.replaceAllUsesExcept(index, made);
  }
  loop->setAttr(kFallbackAttrName, b.getUnitAttr());
  loop->moveBefore(branch.elseBlock(), branch.elseBlock()->begin());
}

/// Whether `value` is computed from `iv` and values from outside of the loop,
/// without memory.
static bool follows(ParallelForOp loop, Value value, Value iv,
                    unsigned depth = 16) {
  if (value == iv)
    return true;
  Operation *op = value.getDefiningOp();
  return op && depth != 0 && !loop.isDefinedOutsideOfLoop(value) &&
         op->getNumRegions() == 0 && isMemoryEffectFree(op) &&
         llvm::any_of(op->getOperands(), [&](Value operand) {
           return follows(loop, operand, iv, depth - 1);
         });
}

/// Whether iterations add to one element: several loops would add in another
/// order than one.
static bool hasSum(ParallelForOp loop) {
  return loop.getBody()
      .walk([&](DifferentiableAccessInterface access) {
        if (access.getAccessKind() == AccessKind::Read ||
            access.getAccessKind() == AccessKind::Write)
          return WalkResult::advance();
        bool isOwn = llvm::all_of(loop.getInductionVars(), [&](Value iv) {
          return llvm::any_of(access.getAccessIndices(), [&](Value index) {
            return follows(loop, index, iv);
          });
        });
        return isOwn ? WalkResult::advance() : WalkResult::interrupt();
      })
      .wasInterrupted();
}

/// Whether the iterations may run in another order once arrays are apart.
static bool isFree(ParallelForOp loop) {
  bool wasApart = loop->hasAttr(kApartAttrName);
  loop->setAttr(kApartAttrName, UnitAttr::get(loop.getContext()));
  bool result = !dependsOnOrder(loop);
  if (!wasApart)
    loop->removeAttr(kApartAttrName);
  return result;
}

namespace {
struct VersionRanges : tai::impl::VersionRangesBase<VersionRanges> {
  using Base::Base;

  void runOnOperation() override {
    SmallVector<ParallelForOp> loops;
    getOperation()->walk<WalkOrder::PreOrder>([&](ParallelForOp loop) {
      loops.push_back(loop);
      return WalkResult::skip();
    });
    for (ParallelForOp loop : loops) {
      if (loop.getSerialize() || loop.getInOrder() || loop.isStructFor() ||
          checksIndices(loop) || hasCommonOrder(loop) || getConstantBox(loop))
        continue;
      int64_t ops = 0;
      bool isRandom = false;
      loop.getBody().walk([&](Operation *op) {
        ++ops;
        isRandom |= isa<RandomOp>(op);
      });
      std::optional<LoopArrays> arrays = LoopArrays::collect(loop);
      if (ops > maxOps || isRandom || !arrays || !isFree(loop) ||
          (hasFixedBits(loop) && hasSum(loop)))
        continue;
      RangeDecider decider(loop);
      if (decider.run()) {
        reportVersions(loop, "ranges that are longer than their borders");
        version(loop, decider, *arrays);
      }
    }
  }
};
} // namespace
