//===- SharedElements.cpp - Elements that iterations share ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/SharedElements.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Conditions
//===----------------------------------------------------------------------===//

/// True if a remainder is part of the expression: many values of its dividend
/// give the same result.
static bool hasRemainder(const IndexExpr &expr) {
  return llvm::any_of(expr.terms, [](const auto &term) {
    const IndexNode *node = term.first.getNode();
    return node && (node->isRemainder() || hasRemainder(node->lhs) ||
                    hasRemainder(node->rhs));
  });
}

/// The two conditions of `first and second` where the second condition is
/// computed in a branch; or of `first or second`, if it is known not to hold.
static std::pair<Value, Value> getConjunction(Value condition, bool holds) {
  auto branch = condition.getDefiningOp<scf::IfOp>();
  if (!branch)
    return {};
  unsigned number = cast<OpResult>(condition).getResultNumber();
  Value yes = branch.thenYield().getOperand(number);
  Value no = branch.elseYield().getOperand(number);
  if (holds ? matchPattern(no, m_Zero()) : matchPattern(yes, m_One()))
    return {branch.getCondition(), holds ? yes : no};
  return {};
}

namespace {
/// The comparisons that are known to hold where an access runs, because of the
/// branches around it.
class Conditions {
public:
  Conditions(Operation *access, ParallelForOp loop) : loop(loop) {
    for (Operation *op = access; op->getParentOp() != loop;
         op = op->getParentOp())
      if (auto branch = dyn_cast<scf::IfOp>(op->getParentOp()))
        add(branch.getCondition(),
            branch.getThenRegion().isAncestor(op->getParentRegion()));
  }

  /// Returns the differences that are zero because a comparison for equality
  /// holds.
  ArrayRef<IndexExpr> getZeros() const { return zeros; }
  /// True if a condition around the access compares for equality, so that only
  /// few iterations satisfy it.
  bool haveEquality() const { return isEquality; }

  /// Removes from `box` the iterations that do not satisfy the comparisons with
  /// constants.
  void narrow(LoopBox &box) const {
    for (const IndexExpr &zero : zeros)
      narrow(box, zero, /*most=*/0, /*least=*/true);
    for (const auto &bound : bounds)
      narrow(box, bound.second, bound.first == Less ? -1 : 0, /*least=*/false);
  }

  /// True if every condition around the access is a comparison that narrow()
  /// handles.
  bool areUnderstood(LoopBox &box) const {
    return !isUnknown && llvm::all_of(zeros, [&](auto &zero) {
      return isOfOneIndex(box, zero);
    }) && llvm::all_of(bounds, [&](auto &bound) {
      return isOfOneIndex(box, bound.second);
    });
  }

  /// Adds to `limits` the bounds that comparisons with values from outside of
  /// the loop give for loop indices. False if there is a condition of another
  /// kind.
  bool limit(IndexLimits &limits) {
    return !isUnknown && llvm::all_of(zeros, [&](auto &zero) {
      return limit(limits, zero, /*most=*/0, /*least=*/true);
    }) && llvm::all_of(bounds, [&](auto &bound) {
      return limit(limits, bound.second, bound.first == Less ? -1 : 0,
                   /*least=*/false);
    });
  }

private:
  enum Bound { Less, LessOrEqual };

  bool limit(IndexLimits &limits, const IndexExpr &form, int64_t most,
             bool least) {
    std::optional<unsigned> dim;
    for (auto [number, iv] : llvm::enumerate(loop.getInductionVars()))
      if (form.mentions(iv)) {
        if (dim)
          return false;
        dim = number;
      }
    if (!dim || !form.isExact())
      return false;
    Value iv = loop.getInductionVars()[*dim];
    int64_t factor = form.getCoefficient(iv);
    IndexExpr rest = form;
    rest.add(IndexExpr(iv), -factor);
    bool isOfOutside = rest.allOf([&](Value value) {
      return !loop->isAncestor(value.getParentBlock()->getParentOp());
    });
    if (std::abs(factor) != 1 || !isOfOutside)
      return false;
    // The comparison says factor * iv <= most - rest, where the factor is 1 or
    // -1.
    IndexExpr bound(factor * most);
    bound.add(rest, -factor);
    IndexExpr next = bound;
    next.add(IndexExpr(1));
    if (factor > 0 || least)
      limits.upper[*dim].push_back(next);
    if (factor < 0 || least)
      limits.lower[*dim].push_back(bound);
    return true;
  }

  static bool isOfOneIndex(LoopBox &box, const IndexExpr &form) {
    return form.terms.size() == 1 && form.isExact() &&
           std::abs(form.terms.front().second) == 1 &&
           form.terms.front().first.getValue() &&
           box.find(form.terms.front().first.getValue());
  }

  /// Narrows the box by form <= `most`, or with `least` by form == `most`.
  static void narrow(LoopBox &box, const IndexExpr &form, int64_t most,
                     bool least) {
    if (!isOfOneIndex(box, form))
      return;
    const auto &[atom, factor] = form.terms.front();
    unsigned dim = *box.find(atom.getValue());
    int64_t bound = most - form.constant; // of factor * iv
    if (factor > 0 || least)
      box.upper[dim] = std::min(box.upper[dim], factor * bound + 1);
    if (factor < 0 || least)
      box.lower[dim] = std::max(box.lower[dim], factor * bound);
  }

  void add(Value condition, bool holds) {
    if (auto both = condition.getDefiningOp<arith::AndIOp>(); both && holds) {
      add(both.getLhs(), true);
      add(both.getRhs(), true);
    } else if (auto either = condition.getDefiningOp<arith::OrIOp>();
               either && !holds) {
      add(either.getLhs(), false);
      add(either.getRhs(), false);
    } else if (auto [first, second] = getConjunction(condition, holds); first) {
      add(first, holds);
      add(second, holds);
    } else if (auto flip = condition.getDefiningOp<arith::XOrIOp>();
               flip && matchPattern(flip.getRhs(), m_One())) {
      add(flip.getLhs(), !holds);
    } else if (auto compare = condition.getDefiningOp<arith::CmpIOp>()) {
      addComparison(compare, holds);
    } else if (auto compare = condition.getDefiningOp<arith::CmpFOp>()) {
      arith::CmpFPredicate predicate = compare.getPredicate();
      isEquality |= holds ? predicate == arith::CmpFPredicate::OEQ ||
                                predicate == arith::CmpFPredicate::UEQ
                          : predicate == arith::CmpFPredicate::UNE ||
                                predicate == arith::CmpFPredicate::ONE;
      isUnknown = true;
    } else {
      // A boolean of unknown origin, such as a mask, may be true in only one
      // iteration.
      isEquality |= !matchPattern(condition, m_Constant());
      isUnknown = true;
    }
  }

  void addComparison(arith::CmpIOp compare, bool holds) {
    using Predicate = arith::CmpIPredicate;
    Predicate predicate = compare.getPredicate();
    if (!holds)
      predicate = arith::invertPredicate(predicate);
    auto difference = [&](Value lhs, Value rhs) {
      return builder.get(lhs).add(builder.get(rhs), -1);
    };
    // Once arithmetic has wrapped, the order of two numbers does not bound
    // their difference.
    auto addBound = [&](Bound bound, Value less, Value more) {
      for (Value side : {less, more}) {
        IndexExpr expr = builder.get(side);
        if (!expr.isExact() || !builder.getRange(expr).fits(64)) {
          isUnknown = true;
          return;
        }
      }
      bounds.emplace_back(bound, difference(less, more));
    };
    Value lhs = compare.getLhs(), rhs = compare.getRhs();
    switch (predicate) {
    case Predicate::eq:
      zeros.push_back(difference(lhs, rhs));
      isEquality |= !hasRemainder(zeros.back());
      break;
    case Predicate::slt:
      addBound(Less, lhs, rhs);
      break;
    case Predicate::sle:
      addBound(LessOrEqual, lhs, rhs);
      break;
    case Predicate::sgt:
      addBound(Less, rhs, lhs);
      break;
    case Predicate::sge:
      addBound(LessOrEqual, rhs, lhs);
      break;
    default:
      isUnknown = true;
      break;
    }
  }

  ParallelForOp loop;
  IndexBuilder builder;
  SmallVector<IndexExpr> zeros;
  SmallVector<std::pair<Bound, IndexExpr>> bounds;
  bool isEquality = false;
  bool isUnknown = false;
};
} // namespace

//===----------------------------------------------------------------------===//
// Sharing
//===----------------------------------------------------------------------===//

/// True if the value is the same in all iterations of `loop`, or is the index
/// of an inner loop whose bounds are the same in all iterations.
static bool isAlike(Value value, ParallelForOp loop) {
  Operation *owner = value.getParentBlock()->getParentOp();
  if (!loop->isAncestor(owner))
    return true;
  auto inner = dyn_cast<scf::ForOp>(owner);
  return inner && value == inner.getInductionVar() &&
         llvm::all_of(ValueRange{inner.getLowerBound(), inner.getUpperBound(),
                                 inner.getStep()},
                      [&](Value bound) {
                        return matchPattern(bound, m_Constant()) ||
                               !loop->isAncestor(
                                   bound.getParentBlock()->getParentOp());
                      });
}

bool mlir::tai::narrowToAccess(Operation *access, LoopBox &box) {
  for (Operation *op = access->getParentOp(); op != box.loop;
       op = op->getParentOp())
    if (!isa<scf::IfOp>(op))
      return false;
  Conditions conditions(access, box.loop);
  if (!conditions.areUnderstood(box))
    return false;
  conditions.narrow(box);
  return true;
}

std::optional<IndexLimits> mlir::tai::getLimits(Operation *access,
                                                ParallelForOp loop) {
  for (Operation *op = access->getParentOp(); op != loop;
       op = op->getParentOp())
    if (!isa<scf::IfOp>(op))
      return std::nullopt;
  IndexLimits limits;
  limits.lower.resize(loop.getInductionVars().size());
  limits.upper.resize(loop.getInductionVars().size());
  return Conditions(access, loop).limit(limits) ? std::optional(limits)
                                                : std::nullopt;
}

Sharing mlir::tai::getSharing(DifferentiableAccessInterface access,
                              ParallelForOp loop) {
  if (loop.getSerialize())
    return Sharing::Own;
  Value memref = access.getAccessedStorage().memref;
  if (memref && loop->isAncestor(memref.getParentBlock()->getParentOp()))
    return Sharing::Own;
  Conditions conditions(access, loop);
  SmallVector<IndexExpr> indices = getIndexExprs(access.getAccessIndices());
  SmallVector<IndexExpr> determined = indices;
  llvm::append_range(determined, conditions.getZeros());

  // Along a dimension with a single iteration, there are no iterations to
  // distinguish, so its index is left out.
  std::optional<LoopBox> box = getIndexBox(loop);
  if (box)
    conditions.narrow(*box);
  SmallVector<Value> moving;
  for (auto [dim, iv] : llvm::enumerate(loop.getInductionVars())) {
    std::optional<int64_t> extent;
    APInt lower, upper;
    if (box)
      extent = box->upper[dim] - box->lower[dim];
    else if (!loop.isStructFor() &&
             matchPattern(loop.getLowerBounds()[dim], m_ConstantInt(&lower)) &&
             matchPattern(loop.getUpperBounds()[dim], m_ConstantInt(&upper)))
      extent = upper.getSExtValue() - lower.getSExtValue();
    if (!extent || *extent > 1)
      moving.push_back(iv);
  }
  if (moving.empty() || isInjectiveOver(determined, moving))
    return Sharing::Own;
  if (conditions.haveEquality())
    return Sharing::Possible;
  llvm::append_range(indices, getIndexExprs(access.getAccessComponents()));
  for (const IndexExpr &index : indices)
    if (!index.allOf([&](Value value) {
          return llvm::is_contained(loop.getInductionVars(), value) ||
                 isAlike(value, loop);
        }))
      return Sharing::Possible;
  bool isFree = llvm::any_of(moving, [&](Value iv) {
    return llvm::none_of(
        indices, [&](const IndexExpr &index) { return index.mentions(iv); });
  });
  return isFree ? Sharing::Certain : Sharing::Possible;
}

//===----------------------------------------------------------------------===//
// Equal values
//===----------------------------------------------------------------------===//

SameIteration::SameIteration(ParallelForOp loop) {
  loop.walk([&](Operation *op) {
    auto access = dyn_cast<DifferentiableAccessInterface>(op);
    if (access && access.getAccessKind() != AccessKind::Read)
      written.insert(getStorageKey(access));
  });
}

/// True if the storage that two reads access is not written between the reads.
static bool haveNoWriteBetween(Operation *first, Operation *second) {
  const void *key = getStorageKey(cast<DifferentiableAccessInterface>(first));
  if (!findCommonBlock(first, second))
    return false;
  if (second->isBeforeInBlock(first))
    std::swap(first, second);
  auto writes = [&](Operation *op) {
    return op
        ->walk([&](DifferentiableAccessInterface access) {
          return access.getAccessKind() != AccessKind::Read &&
                         getStorageKey(access) == key
                     ? WalkResult::interrupt()
                     : WalkResult::advance();
        })
        .wasInterrupted();
  };
  for (Operation *op = first;; op = op->getNextNode()) {
    if (writes(op))
      return false;
    if (op == second)
      return true;
  }
}

bool SameIteration::areEqual(Value lhs, Value rhs, unsigned depth) const {
  if (lhs == rhs)
    return true;
  auto a = dyn_cast<OpResult>(lhs), b = dyn_cast<OpResult>(rhs);
  if (!a || !b || depth == 0 || a.getResultNumber() != b.getResultNumber())
    return false;
  Operation *x = a.getOwner(), *y = b.getOwner();
  if (x->getName() != y->getName() || x->getNumRegions() != 0 ||
      x->getNumOperands() != y->getNumOperands() ||
      x->getRawDictionaryAttrs() != y->getRawDictionaryAttrs() ||
      x->getPropertiesAsAttribute() != y->getPropertiesAsAttribute() ||
      x->getResultTypes() != y->getResultTypes())
    return false;
  if (!isMemoryEffectFree(x)) {
    auto access = dyn_cast<DifferentiableAccessInterface>(x);
    if (!access || access.getAccessKind() != AccessKind::Read ||
        (written.contains(getStorageKey(access)) && !haveNoWriteBetween(x, y)))
      return false;
  }
  return llvm::all_of(llvm::zip(x->getOperands(), y->getOperands()),
                      [&](auto pair) {
                        auto [p, q] = pair;
                        return areEqual(p, q, depth - 1);
                      });
}

bool SameIteration::areEqual(ValueRange lhs, ValueRange rhs) const {
  return lhs.size() == rhs.size() &&
         llvm::all_of(llvm::zip(lhs, rhs), [&](auto pair) {
           auto [a, b] = pair;
           return areEqual(a, b) || getIndexExpr(a) == getIndexExpr(b);
         });
}

bool SameIteration::reachSame(DifferentiableAccessInterface lhs,
                              DifferentiableAccessInterface rhs) const {
  return getStorageKey(lhs) == getStorageKey(rhs) &&
         areEqual(lhs.getAccessIndices(), rhs.getAccessIndices()) &&
         areEqual(lhs.getAccessComponents(), rhs.getAccessComponents());
}
