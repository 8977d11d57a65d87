//===- IndexProducts.cpp - Products of loop indices and arguments ---------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The part of IndexBounds that looks at x[i * n + j], where n is known to the
// launch only. That is no linear sum, but it is one for each launch, and so
// its largest and its smallest value are in a corner of a box of iterations:
// each loop is in its first or in its last one. There the index is a sum of
// launch values and of their products, which the launch computes. What is
// found in a corner is an iteration that runs, as all conditions around the
// access are asked for it; other iterations are not looked at.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "tai/Analysis/IndexBounds.h"
#include "llvm/Support/MathExtras.h"

using namespace mlir;
using namespace mlir::tai;

/// Factors are assumed to be no larger, so that products do not overflow.
static constexpr int64_t kLargestFactor = int64_t(1) << 31;
/// More loops have too many corners.
static constexpr size_t kMaxLoops = 3;

ArrayRef<LinearSum> IndexBounds::getFactors(unsigned variable) const {
  return variables[variable].factors;
}

bool IndexBounds::isOfLaunch(const LinearSum &sum) const {
  return !sum.hasOverflow && llvm::all_of(sum.terms, [&](auto term) {
    return variables[term.first].kind == Variable::Kind::Launch;
  });
}

bool IndexBounds::hasProduct(const LinearSum &sum) const {
  return llvm::any_of(sum.terms, [&](auto term) {
    return variables[term.first].kind == Variable::Kind::Product;
  });
}

static NumberRange multiplyRanges(NumberRange a, NumberRange b) {
  NumberRange range{INT64_MAX, INT64_MIN};
  if (!a.isBounded() || !b.isBounded())
    return {};
  for (int64_t x : {a.low, a.high})
    for (int64_t y : {b.low, b.high}) {
      int64_t product;
      if (llvm::MulOverflow(x, y, product))
        return {};
      range = {std::min(range.low, product), std::max(range.high, product)};
    }
  return range;
}

/// A sum of launch values times one of loop indices.
std::optional<IndexBounds::Form> IndexBounds::makeProduct(Operation *op) {
  Form a = formOf(op->getOperand(0)), b = formOf(op->getOperand(1));
  if (!isOfLaunch(a.sum))
    std::swap(a, b);
  if (!isOfLaunch(a.sum) || isOfLaunch(b.sum) || !a.isCertain || !b.isCertain)
    return std::nullopt;
  for (auto [variable, factor] : b.sum.terms)
    if (variables[variable].kind == Variable::Kind::Quotient)
      return std::nullopt;
  Form form =
      makeVariable(Variable::Kind::Product,
                   multiplyRanges(rangeOfSum(a.sum), rangeOfSum(b.sum)));
  variables.back().factors = {a.sum, b.sum};
  form.facts = a.facts;
  form.facts.append(b.facts.begin(), b.facts.end());
  form.isComplete = false;
  return form;
}

/// Adds the loops whose indices stand in products.
void IndexBounds::collectLoopsOfProducts(
    const LinearSum &sum, bool isInProduct,
    SmallVectorImpl<unsigned> &loops) const {
  for (auto [variable, factor] : sum.terms) {
    const Variable &known = variables[variable];
    if (known.kind == Variable::Kind::Product)
      collectLoopsOfProducts(known.factors[1], true, loops);
    else if (known.kind == Variable::Kind::Loop && isInProduct &&
             !llvm::is_contained(loops, variable))
      loops.push_back(variable);
  }
}

/// The product of two sums of launch values as a launch value.
LinearSum IndexBounds::multiply(const LinearSum &a, const LinearSum &b,
                                SmallVectorImpl<LinearSum> &facts) {
  for (const LinearSum *factor : {&a, &b}) {
    if (rangeOfSum(*factor).isWithin({-kLargestFactor, kLargestFactor}))
      continue;
    facts.push_back(factor->plus(kLargestFactor));
    facts.push_back(LinearSum::of(kLargestFactor).plus(*factor, -1));
  }
  LinearSum product;
  if (a.terms.empty() || b.terms.empty()) {
    const LinearSum &constant = a.terms.empty() ? a : b;
    product.add(a.terms.empty() ? b : a, constant.constant);
    return product;
  }
  SmallVector<LinearSum, 0> factors = {a, b};
  auto known = llvm::find_if(variables, [&](const Variable &variable) {
    return variable.launch.factors == factors;
  });
  if (known != variables.end()) {
    product = LinearSum::variable(known - variables.begin());
  } else {
    NumberRange range = multiplyRanges(rangeOfSum(a), rangeOfSum(b));
    product = makeVariable(Variable::Kind::Launch, range).sum;
    variables.back().launch.factors = std::move(factors);
  }
  return product;
}

/// The sum in the given corner. Products whose loops are in it become launch
/// values.
LinearSum IndexBounds::substitute(const LinearSum &sum, const Corner &corner,
                                  SmallVectorImpl<LinearSum> &facts) {
  LinearSum result = LinearSum::of(sum.constant);
  result.hasOverflow = sum.hasOverflow;
  for (auto [variable, factor] : sum.terms) {
    LinearSum value = LinearSum::variable(variable);
    if (auto known = corner.find(variable); known != corner.end()) {
      value = known->second;
    } else if (variables[variable].kind == Variable::Kind::Product) {
      // By value: a new variable may move the table.
      LinearSum first = variables[variable].factors[0];
      LinearSum second = variables[variable].factors[1];
      second = substitute(second, corner, facts);
      if (isOfLaunch(second))
        value = multiply(first, second, facts);
    }
    result.add(value, factor);
  }
  return result;
}

/// Asks in the corners of the loops whose indices stand in products whether
/// the access goes out of range.
void IndexBounds::checkCorners(const Domain &domain, ArrayRef<LinearSum> piece,
                               const LinearSum &beyond, BoundsAnswer &answer,
                               bool &isExact) {
  answer.isInRange = isExact = false;
  SmallVector<unsigned> used, loops;
  collectLoopsOfProducts(beyond, false, used);
  // The outermost first: its index may bound the others.
  for (unsigned loop : domain.loops)
    if (llvm::is_contained(used, loop))
      loops.push_back(loop);
  if (!domain.isCertain || loops.size() != used.size() ||
      loops.size() > kMaxLoops)
    return;
  for (unsigned choice = 0; choice != 1u << loops.size(); ++choice) {
    Corner corner;
    SmallVector<LinearSum> facts;
    Violation violation;
    for (auto [number, loop] : llvm::enumerate(loops)) {
      // loop - first >= 0, or last - loop >= 0.
      int64_t side = choice >> number & 1 ? -1 : 1;
      for (const LinearSum &row : piece) {
        if (row.getFactor(loop) != side)
          continue;
        LinearSum rest = row.plus(LinearSum::variable(loop), -side);
        rest = substitute(LinearSum().plus(rest, -side), corner, facts);
        if (!isOfLaunch(rest))
          continue;
        corner[loop] = rest;
        Violation::Step step{loop, {}};
        step.system.require(LinearSum::variable(loop).plus(rest, -1));
        violation.iteration.push_back(std::move(step));
        break;
      }
    }
    if (corner.size() != loops.size())
      continue;
    LinearSystem system;
    system.require(substitute(beyond, corner, facts));
    for (const LinearSum &row : piece)
      system.require(substitute(row, corner, facts));
    system.require(facts);
    if (!system.isContradictory() && !system.isUnknown())
      eliminateLoops(domain, std::move(system), std::move(violation), answer,
                     isExact);
  }
}
