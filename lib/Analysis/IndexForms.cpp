//===- IndexForms.cpp - Indices as linear sums ----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The part of IndexBounds that looks at one value: the numbers it can be, and
// how it is made up. Integers wrap around, sums do not: where it is not known
// that a value does not, that is an assumption, and launches are refused for
// what happens in the iterations for which it holds.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/IndexBounds.h"
#include "llvm/ADT/TypeSwitch.h"
#include "llvm/Support/MathExtras.h"

using namespace mlir;
using namespace mlir::tai;

/// Beyond this no storage reaches. Numbers of 64 bits that the launch is given
/// are assumed to be smaller, so that sums of them do not overflow.
static constexpr int64_t kLargest = int64_t(1) << 47;

//===----------------------------------------------------------------------===//
// Ranges
//===----------------------------------------------------------------------===//

/// Index counts as 64 bits, and a truth value is 0 or 1.
static NumberRange rangeOfType(Type type) {
  unsigned width = type.isIndex() ? 64 : type.getIntOrFloatBitWidth();
  if (width >= 64)
    return {};
  if (width == 1)
    return {0, 1};
  return {llvm::minIntN(width), llvm::maxIntN(width)};
}

/// What is left of `range` in `type`, where more would wrap around.
static NumberRange fit(NumberRange range, Type type) {
  NumberRange most = rangeOfType(type);
  return range.isWithin(most) ? range : most;
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

static NumberRange unite(NumberRange a, NumberRange b) {
  return {std::min(a.low, b.low), std::max(a.high, b.high)};
}

/// The range of a / d, rounded down, or towards zero where that is the same.
static NumberRange divideRange(NumberRange a, int64_t d) {
  return {a.low == INT64_MIN ? INT64_MIN : llvm::divideFloorSigned(a.low, d),
          a.high == INT64_MAX ? INT64_MAX : llvm::divideFloorSigned(a.high, d)};
}

NumberRange IndexBounds::rangeOfSum(const LinearSum &sum) const {
  NumberRange range{sum.constant, sum.constant};
  for (auto [variable, factor] : sum.terms)
    range = addRanges(range, scaleRange(variables[variable].range, factor));
  return sum.hasOverflow ? NumberRange() : range;
}

NumberRange IndexBounds::rangeOf(Value value) {
  if (auto known = ranges.find(value); known != ranges.end())
    return known->second;
  NumberRange range = fit(computeRange(value), value.getType());
  ranges[value] = range;
  return range;
}

NumberRange IndexBounds::computeRange(Value value) {
  Type type = value.getType();
  APInt constant;
  if (matchPattern(value, m_ConstantInt(&constant))) {
    if (type.isInteger(1))
      return {constant.isOne(), constant.isOne()};
    return {constant.getSExtValue(), constant.getSExtValue()};
  }
  NumberRange all = rangeOfType(type);
  Operation *op = value.getDefiningOp();
  if (!op) {
    auto argument = cast<BlockArgument>(value);
    Operation *parent = argument.getOwner()->getParentOp();
    if (auto loop = dyn_cast<scf::ForOp>(parent);
        loop && argument == loop.getInductionVar() && !loop.getUnsignedCmp())
      return {rangeOf(loop.getLowerBound()).low,
              addRanges(rangeOf(loop.getUpperBound()), {-1, -1}).high};
    auto loop = dyn_cast<ParallelForOp>(parent);
    if (!loop)
      return all;
    unsigned k = argument.getArgNumber();
    if (!loop.isStructFor())
      return {rangeOf(loop.getLowerBounds()[k]).low,
              addRanges(rangeOf(loop.getUpperBounds()[k]), {-1, -1}).high};
    FailureOr<FieldLayout> layout =
        getFieldLayout(lookupField(loop, loop.getFieldAttr()));
    if (failed(layout) || k >= layout->shape.size())
      return all;
    return {layout->offset[k], layout->offset[k] + layout->shape[k] - 1};
  }
  auto of = [&](unsigned number) { return rangeOf(op->getOperand(number)); };
  auto divisor = [&]() -> int64_t {
    return getConstantIntValue(op->getOperand(1)).value_or(0);
  };
  return llvm::TypeSwitch<Operation *, NumberRange>(op)
      .Case<arith::IndexCastOp, arith::ExtSIOp, arith::TruncIOp>([&](auto) {
        // Truth values are -1 where the sign is taken along.
        return op->getOperand(0).getType().isInteger(1) ? all
                                                        : fit(of(0), type);
      })
      .Case<arith::ExtUIOp, arith::IndexCastUIOp>([&](auto) -> NumberRange {
        unsigned width =
            op->getOperand(0).getType().isIndex()
                ? 64
                : op->getOperand(0).getType().getIntOrFloatBitWidth();
        if (of(0).low >= 0)
          return of(0);
        return width < 63 ? NumberRange{0, int64_t(llvm::maxUIntN(width))}
                          : all;
      })
      .Case([&](arith::AddIOp) { return addRanges(of(0), of(1)); })
      .Case([&](arith::SubIOp) {
        return addRanges(of(0), scaleRange(of(1), -1));
      })
      .Case([&](arith::MulIOp) {
        NumberRange b = of(1);
        return b.isBounded()
                   ? unite(scaleRange(of(0), b.low), scaleRange(of(0), b.high))
                   : all;
      })
      .Case([&](arith::MinSIOp) {
        return NumberRange{std::min(of(0).low, of(1).low),
                           std::min(of(0).high, of(1).high)};
      })
      .Case([&](arith::MaxSIOp) {
        return NumberRange{std::max(of(0).low, of(1).low),
                           std::max(of(0).high, of(1).high)};
      })
      .Case<arith::RemSIOp, arith::RemUIOp>([&](auto) -> NumberRange {
        int64_t d = divisor();
        if (d <= 0)
          return all;
        bool isPositive = of(0).low >= 0 || isa<arith::RemUIOp>(op);
        return {isPositive ? 0 : 1 - d, d - 1};
      })
      .Case([&](arith::FloorDivSIOp) {
        return divisor() > 0 ? divideRange(of(0), divisor()) : all;
      })
      .Case<arith::DivSIOp, arith::DivUIOp>([&](auto) {
        return divisor() > 0 && of(0).low >= 0 ? divideRange(of(0), divisor())
                                               : all;
      })
      .Case([&](arith::AndIOp) -> NumberRange {
        int64_t mask = divisor();
        return mask > 0 ? NumberRange{0, mask} : all;
      })
      .Case([&](arith::SelectOp) { return unite(of(1), of(2)); })
      .Case([&](memref::DimOp) { return NumberRange{0, kLargest}; })
      .Case([&](LengthOp) { return NumberRange{0, kLargest}; })
      .Default([&](Operation *) { return all; });
}

//===----------------------------------------------------------------------===//
// Launch values
//===----------------------------------------------------------------------===//

/// The array and dimension that an extent is asked of, if it is that of an
/// argument.
static std::optional<std::pair<Value, int64_t>> getArrayExtent(Value value) {
  auto dim = value.getDefiningOp<memref::DimOp>();
  if (!dim || !isa<BlockArgument>(dim.getSource()))
    return std::nullopt;
  std::optional<int64_t> number = dim.getConstantIndex();
  if (!number)
    return std::nullopt;
  return std::make_pair(dim.getSource(), *number);
}

bool IndexBounds::isLaunchValue(Value value) {
  if (auto known = launchValues.find(value); known != launchValues.end())
    return known->second;
  bool is = false;
  if (auto argument = dyn_cast<BlockArgument>(value)) {
    is = argument.getOwner() == &kernel.getBody().front();
  } else if (Operation *op = value.getDefiningOp();
             value.getType().isIntOrIndexOrFloat() &&
             op->getNumRegions() == 0 && isPure(op)) {
    // What may fault is not done where the program might not do it.
    is = llvm::all_of(op->getOperands(),
                      [&](Value operand) { return isLaunchValue(operand); });
  }
  // Expressions are shared, so that each is looked at once.
  return launchValues[value] = is;
}

const LaunchValue *IndexBounds::getLaunchValue(unsigned variable) const {
  const Variable &known = variables[variable];
  return known.kind == Variable::Kind::Launch ? &known.launch : nullptr;
}

//===----------------------------------------------------------------------===//
// Forms
//===----------------------------------------------------------------------===//

IndexBounds::Form IndexBounds::makeVariable(Variable::Kind kind,
                                            NumberRange range) {
  unsigned number = variables.size();
  variables.push_back({kind, range});
  Form form;
  form.sum = LinearSum::variable(number);
  form.isCertain = kind != Variable::Kind::Data;
  return form;
}

IndexBounds::Form IndexBounds::makeLaunchForm(LaunchValue launch,
                                              NumberRange range) {
  auto [entry, isNew] =
      launch.array
          ? extentVariables.try_emplace({launch.array, launch.dimension}, 0)
          : std::pair{extentVariables.end(), true};
  if (!isNew) {
    Form form;
    form.sum = LinearSum::variable(entry->second);
    return form;
  }
  Form form = makeVariable(Variable::Kind::Launch, range);
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

IndexBounds::Form IndexBounds::combine(const Form &a, const Form &b,
                                       int64_t scale) const {
  Form form = a;
  form.sum.add(b.sum, scale);
  form.facts.append(b.facts.begin(), b.facts.end());
  form.isCertain &= b.isCertain;
  form.isComplete &= b.isComplete;
  return form;
}

void IndexBounds::assumeFits(Form &form, Type type) const {
  NumberRange most = rangeOfType(type);
  // A product is looked at where it is largest: what wraps there is no index,
  // either.
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

/// The index of a loop. With a step it is the first one and a number of steps.
IndexBounds::Form IndexBounds::makeLoopForm(BlockArgument argument) {
  auto loop = dyn_cast<scf::ForOp>(argument.getOwner()->getParentOp());
  std::optional<int64_t> step =
      loop ? getConstantIntValue(loop.getStep()) : std::nullopt;
  if (!step || *step <= 1)
    return makeVariable(Variable::Kind::Loop, rangeOf(argument));
  Form steps = makeVariable(Variable::Kind::Loop, {0, INT64_MAX});
  return combine(formOf(loop.getLowerBound()), steps, *step);
}

/// Sums, differences, multiples, and casts of them.
std::optional<IndexBounds::Form> IndexBounds::makeLinear(Operation *op) {
  Form form;
  if (auto add = dyn_cast<arith::AddIOp>(op)) {
    form = combine(formOf(add.getLhs()), formOf(add.getRhs()), 1);
  } else if (auto sub = dyn_cast<arith::SubIOp>(op)) {
    form = combine(formOf(sub.getLhs()), formOf(sub.getRhs()), -1);
  } else if (auto mul = dyn_cast<arith::MulIOp>(op)) {
    std::optional<int64_t> left = getConstantIntValue(mul.getLhs());
    std::optional<int64_t> right = getConstantIntValue(mul.getRhs());
    if (!left && !right)
      return makeProduct(op);
    form = combine({}, formOf(left ? mul.getRhs() : mul.getLhs()),
                   left ? *left : *right);
  } else if (isa<arith::IndexCastOp, arith::ExtSIOp, arith::TruncIOp>(op) &&
             !op->getOperand(0).getType().isInteger(1)) {
    form = formOf(op->getOperand(0));
  } else if (isa<arith::ExtUIOp, arith::IndexCastUIOp>(op)) {
    form = formOf(op->getOperand(0));
    // Of the same bits, another number.
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

/// Division by a constant and what is left over: d q <= a <= d q + d - 1.
std::optional<IndexBounds::Form> IndexBounds::makeQuotient(Operation *op) {
  bool isFloor = isa<arith::FloorDivSIOp>(op);
  bool isDivision = isFloor || isa<arith::DivSIOp, arith::DivUIOp>(op);
  if (!isDivision && !isa<arith::RemSIOp, arith::RemUIOp>(op))
    return std::nullopt;
  int64_t d = getConstantIntValue(op->getOperand(1)).value_or(0);
  if (d <= 0 || (!isFloor && rangeOf(op->getOperand(0)).low < 0))
    return std::nullopt;
  Form dividend = formOf(op->getOperand(0));
  // A hash, say, that is to wrap.
  if (hasProduct(dividend.sum))
    return std::nullopt;
  Form quotient = makeVariable(Variable::Kind::Quotient,
                               divideRange(rangeOf(op->getOperand(0)), d));
  Form rest = combine(dividend, quotient, -d);
  SmallVector<LinearSum, 2> facts = dividend.facts;
  facts.push_back(rest.sum);
  facts.push_back(LinearSum::of(d - 1).plus(rest.sum, -1));
  Form form = isDivision ? quotient : rest;
  form.facts = std::move(facts);
  form.isCertain = dividend.isCertain;
  form.isComplete = dividend.isComplete;
  return form;
}

/// Of the smaller of two numbers it is known that it is no larger than both.
/// That proves, but does not show that an iteration goes out of range.
std::optional<IndexBounds::Form> IndexBounds::makeExtreme(Operation *op) {
  if (!isa<arith::MinSIOp, arith::MaxSIOp>(op))
    return std::nullopt;
  int64_t sign = isa<arith::MinSIOp>(op) ? 1 : -1;
  Form a = formOf(op->getOperand(0)), b = formOf(op->getOperand(1));
  Form form = makeVariable(Variable::Kind::Data, rangeOf(op->getResult(0)));
  for (const Form &other : {a, b}) {
    form.facts.append(other.facts.begin(), other.facts.end());
    form.facts.push_back(
        LinearSum().plus(other.sum, sign).plus(form.sum, -sign));
    form.isComplete &= other.isComplete;
  }
  return form;
}

IndexBounds::Form IndexBounds::makeForm(Value value) {
  if (!value.getType().isIntOrIndex())
    return makeVariable(Variable::Kind::Data, {});
  NumberRange range = rangeOf(value);
  if (range.isBounded() && range.low == range.high) {
    Form form;
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
  std::optional<Form> linear;
  if (op && (linear = makeLinear(op)) && linear->isComplete)
    return *linear;
  if (isLaunchValue(value))
    return makeLaunchForm({value, {}, 0}, range);
  if (linear)
    return *linear;
  if (op)
    if (std::optional<Form> form = makeQuotient(op))
      return *form;
  if (op)
    if (std::optional<Form> form = makeExtreme(op))
      return *form;
  return makeVariable(Variable::Kind::Data, range);
}

// By value: what is asked for next may move the table.
IndexBounds::Form IndexBounds::formOf(Value value) {
  if (auto known = forms.find(value); known != forms.end())
    return known->second;
  Form form = makeForm(value);
  forms[value] = form;
  return form;
}

std::optional<LinearSum> IndexBounds::getSum(Value index) {
  Form form = formOf(index);
  if (!form.isCertain)
    return std::nullopt;
  return form.sum;
}
