//===- IndexForms.cpp - Indices as linear sums ----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Linear forms of index values rest on assumptions, such as a limit of launch
// values (kLargest). A launch is refused only because of iterations in which
// these assumptions hold.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Index/IndexForms.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "llvm/Support/MathExtras.h"

using namespace mlir;
using namespace mlir::tai;

/// A size that no storage exceeds. A launch's 64-bit arguments are assumed to
/// be smaller as well, so that sums of them do not overflow.
static constexpr int64_t kLargest = int64_t(1) << 47;
/// Launch values that are factors of a product are assumed to be no larger than
/// this number, so that products do not overflow.
static constexpr int64_t kLargestFactor = int64_t(1) << 31;

//===----------------------------------------------------------------------===//
// Ranges
//===----------------------------------------------------------------------===//

/// Returns the range of all values of `type`. An index has 64 bits; an i1 is 0
/// or 1, not -1.
static NumberRange rangeOfType(Type type) {
  unsigned width = type.isIndex() ? 64 : type.getIntOrFloatBitWidth();
  if (width >= 64)
    return {};
  if (width == 1)
    return {0, 1};
  return {llvm::minIntN(width), llvm::maxIntN(width)};
}

static NumberRange addRanges(NumberRange a, NumberRange b) {
  NumberRange sum;
  if (!a.isBounded() || !b.isBounded() ||
      llvm::AddOverflow(a.low, b.low, sum.low) ||
      llvm::AddOverflow(a.high, b.high, sum.high))
    return {};
  return sum;
}

static NumberRange scaleRange(NumberRange a, int64_t factor) {
  NumberRange product;
  if (!a.isBounded() || llvm::MulOverflow(a.low, factor, product.low) ||
      llvm::MulOverflow(a.high, factor, product.high))
    return {};
  if (factor < 0)
    std::swap(product.low, product.high);
  return product;
}

/// Returns the range of the quotient a / d, rounded down. For rounding towards
/// zero, only where both quotients are equal.
static NumberRange divideRange(NumberRange a, int64_t d) {
  return {a.low == INT64_MIN ? INT64_MIN : llvm::divideFloorSigned(a.low, d),
          a.high == INT64_MAX ? INT64_MAX : llvm::divideFloorSigned(a.high, d)};
}

NumberRange IndexForms::rangeOfSum(const LinearSum &sum) const {
  NumberRange range{sum.constant, sum.constant};
  for (auto [variable, factor] : sum.terms)
    range = addRanges(range, scaleRange(variables[variable].range, factor));
  return sum.hasOverflow ? NumberRange() : range;
}

IndexForms::IndexForms(KernelOp kernel)
    : kernel(kernel),
      ranges([](Value value) -> std::optional<ConstantIntRanges> {
        if (!isa_and_present<memref::DimOp, LengthOp>(value.getDefiningOp()))
          return std::nullopt;
        unsigned width = ConstantIntRanges::getStorageBitwidth(value.getType());
        return ConstantIntRanges::fromSigned(
            APInt::getZero(width), width > 48
                                       ? APInt(width, kLargest)
                                       : APInt::getSignedMaxValue(width));
      }) {}

NumberRange IndexForms::rangeOf(Value value) {
  Type type = value.getType();
  if (!type.isIntOrIndex())
    return {};
  ConstantIntRanges range = ranges.get(value);
  if (range.smin().getBitWidth() > 64)
    return {};
  // An i1 counts as unsigned: it is 0 or 1.
  if (type.isInteger(1))
    return {static_cast<int64_t>(range.umin().getZExtValue()),
            static_cast<int64_t>(range.umax().getZExtValue())};
  return {range.smin().getSExtValue(), range.smax().getSExtValue()};
}

//===----------------------------------------------------------------------===//
// Launch values
//===----------------------------------------------------------------------===//

/// Returns the array and the dimension whose extent `value` is, if the array is
/// a block argument.
static std::optional<std::pair<Value, int64_t>> getArrayExtent(Value value) {
  auto dim = value.getDefiningOp<memref::DimOp>();
  if (!dim || !isa<BlockArgument>(dim.getSource()))
    return std::nullopt;
  std::optional<int64_t> number = dim.getConstantIndex();
  if (!number)
    return std::nullopt;
  return std::make_pair(dim.getSource(), *number);
}

bool IndexForms::isLaunchValue(Value value) {
  if (auto known = launchValues.find(value); known != launchValues.end())
    return known->second;
  bool is = false;
  if (auto argument = dyn_cast<BlockArgument>(value)) {
    is = argument.getOwner() == &kernel.getBody().front();
  } else if (Operation *op = value.getDefiningOp();
             value.getType().isIntOrIndexOrFloat() &&
             op->getNumRegions() == 0 && isPure(op)) {
    // A launch value must not be computed by an op that may fault, since the
    // program might not execute the op.
    is = llvm::all_of(op->getOperands(),
                      [&](Value operand) { return isLaunchValue(operand); });
  }
  // The answer is remembered for each value, because expressions share
  // operands.
  return launchValues[value] = is;
}

const LaunchValue *IndexForms::getLaunchValue(unsigned variable) const {
  const Variable &known = variables[variable];
  return known.kind == Kind::Launch ? &known.launch : nullptr;
}

//===----------------------------------------------------------------------===//
// Forms
//===----------------------------------------------------------------------===//

LinearForm IndexForms::makeVariable(Kind kind, NumberRange range) {
  unsigned number = variables.size();
  variables.push_back({kind, range});
  LinearForm form;
  form.sum = LinearSum::variable(number);
  form.isCertain = kind != Kind::Data;
  return form;
}

LinearForm IndexForms::makeLaunchForm(const LaunchValue &launch,
                                      NumberRange range) {
  auto [entry, isNew] =
      launch.array
          ? extentVariables.try_emplace({launch.array, launch.dimension}, 0)
          : std::pair{extentVariables.end(), true};
  if (!isNew) {
    LinearForm form;
    form.sum = LinearSum::variable(entry->second);
    return form;
  }
  LinearForm form = makeVariable(Kind::Launch, range);
  unsigned number = form.sum.terms.front().first;
  variables[number].launch = launch;
  if (launch.array)
    entry->second = number;
  if (!range.isWithin({-kLargest, kLargest})) {
    form.facts = {form.sum.plus(kLargest),
                  LinearSum::of(kLargest).plus(form.sum, -1)};
    form.isComplete = false;
  }
  return form;
}

/// True for a <= b and a < b, which can be tested without computing a
/// difference.
static bool isComparison(const LinearSum &row) {
  return row.terms.size() == 2 && row.terms[0].second == -row.terms[1].second &&
         (row.constant == 0 || row.constant == -1);
}

LinearSystem IndexForms::dropAssumptions(const LinearSystem &system,
                                         const LinearSum &index) const {
  auto isUnit = [](auto term) { return std::abs(term.second) == 1; };
  LinearSystem rest;
  bool isExact = true;
  for (const LinearSum &row : system.getRows()) {
    if (!llvm::all_of(row.terms, isUnit))
      return system;
    if (row.terms.size() == 1 && row.constant == kLargest &&
        getLaunchValue(row.terms.front().first))
      continue;
    rest.require(row);
    isExact &= row.terms.size() == 1 || isComparison(row);
  }
  // If a launch value is larger than assumed, a multiple of it may wrap around
  // to an index in range, and a sum other than the index itself may wrap to the
  // other sign, so the assumptions are kept in these cases.
  for (auto term : index.terms)
    if (getLaunchValue(term.first) && !isUnit(term))
      return system;
  return isExact || rest.getRows().size() == 1 ? rest : system;
}

LinearForm LinearForm::plus(const LinearForm &other, int64_t scale) const {
  LinearForm form = *this;
  form.sum.add(other.sum, scale);
  form.facts.append(other.facts.begin(), other.facts.end());
  form.isCertain &= other.isCertain;
  form.isComplete &= other.isComplete;
  return form;
}

void IndexForms::assumeFits(LinearForm &form, Type type) const {
  NumberRange most = rangeOfType(type);
  // A product is checked in the first and the last iterations. If it wraps
  // there, the program's index is not valid either.
  if (hasProduct(form.sum)) {
    form.isComplete = false;
    return;
  }
  if (!most.isBounded() || rangeOfSum(form.sum).isWithin(most))
    return;
  form.facts.push_back(form.sum.plus(LinearSum::of(most.low), -1));
  form.facts.push_back(LinearSum::of(most.high).plus(form.sum, -1));
  form.isComplete = false;
}

/// Makes the form of a loop index. With a step it is the first index plus a
/// multiple of the step, unless the loop compares without a sign: then it may
/// pass from the greatest signed number to the least.
LinearForm IndexForms::makeLoopForm(BlockArgument argument) {
  auto loop = dyn_cast<scf::ForOp>(argument.getOwner()->getParentOp());
  std::optional<int64_t> step =
      loop ? getConstantIntValue(loop.getStep()) : std::nullopt;
  if (!step || *step <= 1 || loop.getUnsignedCmp())
    return makeVariable(Kind::Loop, rangeOf(argument));
  LinearForm steps = makeVariable(Kind::Loop, {0, INT64_MAX});
  return formOf(loop.getLowerBound()).plus(steps, *step);
}

/// Makes the linear form of a sum, difference, multiple or cast; none for other
/// operations.
std::optional<LinearForm> IndexForms::makeLinear(Operation *op) {
  LinearForm form;
  if (auto add = dyn_cast<arith::AddIOp>(op)) {
    form = formOf(add.getLhs()).plus(formOf(add.getRhs()), 1);
  } else if (auto sub = dyn_cast<arith::SubIOp>(op)) {
    form = formOf(sub.getLhs()).plus(formOf(sub.getRhs()), -1);
  } else if (auto mul = dyn_cast<arith::MulIOp>(op)) {
    std::optional<int64_t> left = getConstantIntValue(mul.getLhs());
    std::optional<int64_t> right = getConstantIntValue(mul.getRhs());
    if (!left && !right)
      return makeProduct(op);
    form = LinearForm().plus(formOf(left ? mul.getRhs() : mul.getLhs()),
                             left ? *left : *right);
  } else if (isa<arith::IndexCastOp, arith::ExtSIOp, arith::TruncIOp>(op) &&
             !op->getOperand(0).getType().isInteger(1)) {
    form = formOf(op->getOperand(0));
  } else if (isa<arith::ExtUIOp, arith::IndexCastUIOp>(op)) {
    form = formOf(op->getOperand(0));
    // Zero-extension of a negative number changes its value: assume that the
    // number is not negative.
    if (rangeOf(op->getOperand(0)).low < 0) {
      form.facts.push_back(form.sum);
      form.isComplete = false;
    }
  } else {
    return std::nullopt;
  }
  assumeFits(form, op->getResult(0).getType());
  return form;
}

/// Makes the linear form of a quotient or remainder by a constant d > 0: the
/// quotient q is a new variable with d q <= a <= d q + d - 1.
std::optional<LinearForm> IndexForms::makeQuotient(Operation *op) {
  bool isFloor = isa<arith::FloorDivSIOp>(op);
  bool isDivision = isFloor || isa<arith::DivSIOp, arith::DivUIOp>(op);
  if (!isDivision && !isa<arith::RemSIOp, arith::RemUIOp>(op))
    return std::nullopt;
  int64_t d = getConstantIntValue(op->getOperand(1)).value_or(0);
  if (d <= 0 || (!isFloor && rangeOf(op->getOperand(0)).low < 0))
    return std::nullopt;
  LinearForm dividend = formOf(op->getOperand(0));
  // A dividend that contains a product has no linear form, because the program
  // may intend the product to wrap, as in a hash.
  if (hasProduct(dividend.sum))
    return std::nullopt;
  LinearForm quotient =
      makeVariable(Kind::Quotient, divideRange(rangeOf(op->getOperand(0)), d));
  LinearForm rest = dividend.plus(quotient, -d);
  SmallVector<LinearSum, 2> facts = dividend.facts;
  facts.push_back(rest.sum);
  facts.push_back(LinearSum::of(d - 1).plus(rest.sum, -1));
  LinearForm form = isDivision ? quotient : rest;
  form.facts = std::move(facts);
  form.isCertain = dividend.isCertain;
  form.isComplete = dividend.isComplete;
  return form;
}

/// A minimum is no larger than either operand, a maximum no smaller. These
/// facts can prove that an index is in range, but not that an iteration goes
/// out of range.
std::optional<LinearForm> IndexForms::makeExtreme(Operation *op) {
  if (!isa<arith::MinSIOp, arith::MaxSIOp>(op))
    return std::nullopt;
  int64_t sign = isa<arith::MinSIOp>(op) ? 1 : -1;
  LinearForm a = formOf(op->getOperand(0)), b = formOf(op->getOperand(1));
  LinearForm form = makeVariable(Kind::Data, rangeOf(op->getResult(0)));
  for (const LinearForm &other : {a, b}) {
    form.facts.append(other.facts.begin(), other.facts.end());
    form.facts.push_back(
        LinearSum().plus(other.sum, sign).plus(form.sum, -sign));
    form.isComplete &= other.isComplete;
  }
  return form;
}

LinearForm IndexForms::makeForm(Value value) {
  if (!value.getType().isIntOrIndex())
    return makeVariable(Kind::Data, {});
  NumberRange range = rangeOf(value);
  if (range.isBounded() && range.low == range.high) {
    LinearForm form;
    form.sum = LinearSum::of(range.low);
    return form;
  }
  Operation *op = value.getDefiningOp();
  if (!op) {
    auto argument = cast<BlockArgument>(value);
    Operation *parent = argument.getOwner()->getParentOp();
    auto loop = dyn_cast<scf::ForOp>(parent);
    if (isa<ParallelForOp>(parent) ||
        (loop && argument == loop.getInductionVar()))
      return makeLoopForm(argument);
  }
  if (std::optional<std::pair<Value, int64_t>> extent = getArrayExtent(value))
    return makeLaunchForm({{}, extent->first, extent->second}, range);
  std::optional<LinearForm> linear;
  if (op && (linear = makeLinear(op)) && linear->isComplete)
    return *linear;
  if (isLaunchValue(value))
    return makeLaunchForm({value, {}, 0}, range);
  if (linear)
    return *linear;
  if (op)
    if (std::optional<LinearForm> form = makeQuotient(op))
      return *form;
  if (op)
    if (std::optional<LinearForm> form = makeExtreme(op))
      return *form;
  return makeVariable(Kind::Data, range);
}

// Returns a copy of the table's entry, since a later query may reallocate the
// table.
LinearForm IndexForms::formOf(Value value) {
  if (auto known = forms.find(value); known != forms.end())
    return known->second;
  LinearForm form = makeForm(value);
  forms[value] = form;
  return form;
}

//===----------------------------------------------------------------------===//
// Products
//===----------------------------------------------------------------------===//

bool IndexForms::isOfLaunch(const LinearSum &sum) const {
  return !sum.hasOverflow && llvm::all_of(sum.terms, [&](auto term) {
    return variables[term.first].kind == Kind::Launch;
  });
}

bool IndexForms::hasProduct(const LinearSum &sum) const {
  return llvm::any_of(sum.terms, [&](auto term) {
    return variables[term.first].kind == Kind::Product;
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

/// Makes the linear form of a product of a sum of launch values and a sum with
/// loop indices; none for other products.
std::optional<LinearForm> IndexForms::makeProduct(Operation *op) {
  LinearForm a = formOf(op->getOperand(0)), b = formOf(op->getOperand(1));
  if (!isOfLaunch(a.sum))
    std::swap(a, b);
  if (!isOfLaunch(a.sum) || isOfLaunch(b.sum) || !a.isCertain || !b.isCertain)
    return std::nullopt;
  for (auto [variable, factor] : b.sum.terms)
    if (variables[variable].kind == Kind::Quotient)
      return std::nullopt;
  LinearForm form = makeVariable(
      Kind::Product, multiplyRanges(rangeOfSum(a.sum), rangeOfSum(b.sum)));
  variables.back().factors = {a.sum, b.sum};
  form.facts = a.facts;
  form.facts.append(b.facts.begin(), b.facts.end());
  form.isComplete = false;
  return form;
}

LinearSum IndexForms::multiply(const LinearSum &a, const LinearSum &b,
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
    product = makeVariable(Kind::Launch, range).sum;
    variables.back().launch.factors = std::move(factors);
  }
  return product;
}
