//===- IterationDomains.cpp - When a block of a kernel runs ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/IterationDomains.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/IR/Matchers.h"
#include "tai/Dialect/Tai/IR/Layout.h"

using namespace mlir;
using namespace mlir::tai;

/// The maximum number of pieces of a domain. Each piece is a way in which the
/// conditions can hold, and is checked by a system of its own.
static constexpr size_t kMaxPieces = 8;

void IterationDomain::addRow(const LinearSum &row) {
  for (SmallVector<LinearSum> &piece : pieces)
    piece.push_back(row);
}

void IterationDomain::addFacts(const LinearForm &form) {
  for (const LinearSum &fact : form.facts)
    addRow(fact);
  isCertain &= form.isCertain;
  isComplete &= form.isComplete;
}

//===----------------------------------------------------------------------===//
// Conditions
//===----------------------------------------------------------------------===//

/// Adds to `domain` the constraint lhs - rhs >= gap.
void IterationDomains::addComparison(Domain &domain, Value lhs, Value rhs,
                                     int64_t gap) {
  LinearForm difference = forms.formOf(lhs).plus(forms.formOf(rhs), -1);
  domain.addFacts(difference);
  domain.addRow(difference.sum.plus(-gap));
}

/// Makes `domain` the union of the domains that the two functions derive from
/// it.
void IterationDomains::addEither(Domain &domain,
                                 function_ref<void(Domain &)> first,
                                 function_ref<void(Domain &)> second) {
  Domain other = domain;
  first(domain);
  second(other);
  domain.isCertain &= other.isCertain;
  domain.isComplete &= other.isComplete;
  domain.pieces.append(other.pieces.begin(), other.pieces.end());
}

void IterationDomains::addCondition(Domain &domain, Value condition,
                                    bool holds) {
  auto give = [&] { domain.isCertain = false; };
  if (domain.pieces.size() >= kMaxPieces)
    return give();
  APInt constant;
  if (matchPattern(condition, m_ConstantInt(&constant))) {
    if (constant.isOne() != holds)
      domain.pieces.clear();
    return;
  }
  auto both = [&](Value a, bool aHolds, Value b, bool bHolds) {
    addCondition(domain, a, aHolds);
    addCondition(domain, b, bHolds);
  };
  auto either = [&](Value a, bool aHolds, Value b, bool bHolds) {
    addEither(
        domain, [&](Domain &one) { addCondition(one, a, aHolds); },
        [&](Domain &one) { addCondition(one, b, bHolds); });
  };
  Operation *op = condition.getDefiningOp();
  if (auto conjunction = dyn_cast_if_present<arith::AndIOp>(op))
    return holds ? both(conjunction.getLhs(), true, conjunction.getRhs(), true)
                 : either(conjunction.getLhs(), false, conjunction.getRhs(),
                          false);
  if (auto disjunction = dyn_cast_if_present<arith::OrIOp>(op))
    return holds
               ? either(disjunction.getLhs(), true, disjunction.getRhs(), true)
               : both(disjunction.getLhs(), false, disjunction.getRhs(), false);
  if (auto difference = dyn_cast_if_present<arith::XOrIOp>(op)) {
    if (matchPattern(difference.getRhs(), m_One()))
      return addCondition(domain, difference.getLhs(), !holds);
    return give();
  }
  if (auto select = dyn_cast_if_present<arith::SelectOp>(op)) {
    // A select with a constant arm is a logical "and" or "or" with
    // short-circuit evaluation.
    if (matchPattern(select.getFalseValue(), m_Zero()))
      return holds ? both(select.getCondition(), true, select.getTrueValue(),
                          true)
                   : either(select.getCondition(), false, select.getTrueValue(),
                            false);
    if (matchPattern(select.getTrueValue(), m_One()))
      return holds ? either(select.getCondition(), true, select.getFalseValue(),
                            true)
                   : both(select.getCondition(), false, select.getFalseValue(),
                          false);
  }
  if (forms.isLaunchValue(condition)) {
    LinearForm form = forms.formOf(condition);
    domain.addFacts(form);
    return domain.addRow(holds ? form.sum.plus(-1)
                               : LinearSum().plus(form.sum, -1));
  }
  auto compare = dyn_cast_if_present<arith::CmpIOp>(op);
  if (!compare || compare.getLhs().getType().isInteger(1))
    return give();
  using Predicate = arith::CmpIPredicate;
  Predicate predicate = compare.getPredicate();
  if (!holds)
    predicate = arith::invertPredicate(predicate);
  Value a = compare.getLhs(), b = compare.getRhs();
  switch (predicate) {
  case Predicate::sge:
    return addComparison(domain, a, b, 0);
  case Predicate::sgt:
    return addComparison(domain, a, b, 1);
  case Predicate::sle:
    return addComparison(domain, b, a, 0);
  case Predicate::slt:
    return addComparison(domain, b, a, 1);
  case Predicate::eq:
    addComparison(domain, a, b, 0);
    return addComparison(domain, b, a, 0);
  case Predicate::ne:
    return addEither(
        domain, [&](Domain &one) { addComparison(one, a, b, 1); },
        [&](Domain &one) { addComparison(one, b, a, 1); });
  case Predicate::ult:
  case Predicate::ule:
    // An unsigned a < b (or a <= b) with a b that is not negative means 0 <= a
    // < b (or 0 <= a <= b).
    if (forms.rangeOf(b).low < 0)
      return give();
    domain.addRow(forms.formOf(a).sum);
    return addComparison(domain, b, a, predicate == Predicate::ult);
  case Predicate::uge:
  case Predicate::ugt:
    if (forms.rangeOf(a).low < 0 || forms.rangeOf(b).low < 0)
      return give();
    return addComparison(domain, a, b, predicate == Predicate::ugt);
  }
}

//===----------------------------------------------------------------------===//
// Loops
//===----------------------------------------------------------------------===//

/// Adds to `domain` the bounds of a loop index: lower <= iv < upper.
void IterationDomains::addLoop(Domain &domain, BlockArgument iv, Value lower,
                               Value upper) {
  LinearForm index = forms.formOf(iv);
  for (auto [variable, factor] : index.sum.terms)
    if (forms.getKind(variable) == IndexForms::Kind::Loop &&
        !llvm::is_contained(domain.loops, variable))
      domain.loops.push_back(variable);
  addComparison(domain, iv, lower, 0);
  addComparison(domain, upper, iv, 1);
}

void IterationDomains::addLoop(Domain &domain, ParallelForOp loop) {
  if (!loop.isStructFor()) {
    for (auto [iv, lower, upper] :
         llvm::zip(loop.getInductionVars(), loop.getLowerBounds(),
                   loop.getUpperBounds()))
      addLoop(domain, iv, lower, upper);
    return;
  }
  FieldLayout layout = *getFieldLayout(lookupField(loop, loop.getFieldAttr()));
  for (auto [iv, first, extent] :
       llvm::zip(loop.getInductionVars(), layout.offset, layout.shape)) {
    LinearForm index = forms.formOf(iv);
    // The index along a dimension of extent 1 is a constant, so its sum has no
    // variable.
    for (auto [variable, factor] : index.sum.terms)
      domain.loops.push_back(variable);
    domain.addRow(index.sum.plus(-first));
    domain.addRow(LinearSum::of(first + extent - 1).plus(index.sum, -1));
  }
  // In sparse fields, the loop visits only a subset of this domain.
  domain.isCertain &= !loop.getLevel() && !layout.path.getFirstSparse();
}

IterationDomain IterationDomains::domainOf(Block *block) {
  if (auto known = domains.find(block); known != domains.end())
    return known->second;
  Operation *parent = block->getParentOp();
  Domain domain;
  if (parent == kernel) {
    domain.pieces.emplace_back();
    return domains[block] = domain;
  }
  domain = domainOf(parent->getBlock());
  if (auto loop = dyn_cast<ParallelForOp>(parent)) {
    addLoop(domain, loop);
  } else if (auto serial = dyn_cast<scf::ForOp>(parent)) {
    std::optional<int64_t> step = getConstantIntValue(serial.getStep());
    auto iv = cast<BlockArgument>(serial.getInductionVar());
    size_t outer = domain.loops.size();
    if (serial.getUnsignedCmp()) {
      domain.isCertain = false;
    } else {
      addLoop(domain, iv, serial.getLowerBound(), serial.getUpperBound());
      domain.isCertain &= step && *step > 0;
    }
    // The sum of a loop index with a step has a variable for the number of
    // steps, which is not negative. A loop with a single iteration has no
    // variable.
    if (step && *step > 1 && domain.loops.size() > outer)
      domain.addRow(LinearSum::variable(domain.loops.back()));
  } else if (auto branch = dyn_cast<scf::IfOp>(parent)) {
    addCondition(domain, branch.getCondition(), block == branch.thenBlock());
  } else {
    domain.isCertain = false;
  }
  return domains[block] = domain;
}
