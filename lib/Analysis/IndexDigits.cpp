//===- IndexDigits.cpp - Indices that are digits of a number --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// For constant divisors, `i // k % m` is the digit of i from the weight k to
// the weight k * m, and `i // k` all digits from k on. Digits without a gap
// from the weight 1 on determine i. For other divisors, the quotient and the
// remainder of one division do.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/IndexDigits.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/IR/Matchers.h"
#include "llvm/ADT/MapVector.h"

using namespace mlir;
using namespace mlir::tai;

static std::optional<int64_t> getConstant(Value value) {
  APInt constant;
  if (!matchPattern(value, m_ConstantInt(&constant)) ||
      constant.getSignificantBits() > 64)
    return std::nullopt;
  return constant.getSExtValue();
}

static Value stripCasts(Value value) {
  while (Operation *cast = value.getDefiningOp()) {
    if (!isa<arith::IndexCastOp, arith::ExtSIOp>(cast))
      break;
    value = cast->getOperand(0);
  }
  return value;
}

namespace {
/// A quotient, or a remainder.
struct Division {
  Value dividend, divisor;
  bool isRemainder = false;
  /// Rounded down, as in Python, and not towards zero.
  bool isFloor = false;

  bool isOf(const Division &other) const {
    return dividend == other.dividend && divisor == other.divisor;
  }
};
} // namespace

static std::optional<Division> matchPlain(Value value) {
  Operation *op = value.getDefiningOp();
  if (isa_and_present<arith::DivSIOp, arith::RemSIOp, arith::FloorDivSIOp>(op))
    return Division{op->getOperand(0), op->getOperand(1),
                    isa<arith::RemSIOp>(op), isa<arith::FloorDivSIOp>(op)};
  return std::nullopt;
}

/// True if the condition is that the remainder and the divisor have different
/// signs: then the quotient is rounded down by subtracting one.
static bool isRoundedUp(Value condition, const Division &division) {
  auto isRemainder = [&](Value value) {
    auto plain = matchPlain(value);
    return plain && plain->isRemainder && plain->isOf(division);
  };
  auto isLess = [&](Value value, auto isLeft) {
    auto compare = value.getDefiningOp<arith::CmpIOp>();
    return compare && compare.getPredicate() == arith::CmpIPredicate::slt &&
           matchPattern(compare.getRhs(), m_Zero()) && isLeft(compare.getLhs());
  };
  if (isLess(condition, isRemainder))
    return getConstant(division.divisor).value_or(0) > 0;
  auto both = condition.getDefiningOp<arith::AndIOp>();
  if (!both)
    return false;
  auto isNonZero = [&](Value value) {
    auto compare = value.getDefiningOp<arith::CmpIOp>();
    return compare && compare.getPredicate() == arith::CmpIPredicate::ne &&
           matchPattern(compare.getRhs(), m_Zero()) &&
           isRemainder(compare.getLhs());
  };
  auto haveOtherSigns = [&](Value value) {
    return isLess(value, [&](Value signs) {
      auto either = signs.getDefiningOp<arith::XOrIOp>();
      return either && ((isRemainder(either.getLhs()) &&
                         either.getRhs() == division.divisor) ||
                        (isRemainder(either.getRhs()) &&
                         either.getLhs() == division.divisor));
    });
  };
  return (isNonZero(both.getLhs()) && haveOtherSigns(both.getRhs())) ||
         (isNonZero(both.getRhs()) && haveOtherSigns(both.getLhs()));
}

static std::optional<Division> matchDivision(Value value) {
  value = stripCasts(value);
  if (auto plain = matchPlain(value))
    return plain;
  auto select = value.getDefiningOp<arith::SelectOp>();
  auto plain = select ? matchPlain(select.getFalseValue()) : std::nullopt;
  if (!plain || plain->isFloor || !isRoundedUp(select.getCondition(), *plain))
    return std::nullopt;
  Operation *corrected = select.getTrueValue().getDefiningOp();
  if (!corrected || corrected->getNumOperands() != 2)
    return std::nullopt;
  auto base = matchPlain(corrected->getOperand(0));
  Value by = corrected->getOperand(1);
  if (!base || !base->isOf(*plain) || base->isRemainder != plain->isRemainder)
    return std::nullopt;
  bool isCorrect =
      plain->isRemainder
          ? isa<arith::AddIOp>(corrected) && by == plain->divisor
          : (isa<arith::SubIOp>(corrected) && getConstant(by) == 1) ||
                (isa<arith::AddIOp>(corrected) && getConstant(by) == -1);
  if (!isCorrect)
    return std::nullopt;
  plain->isFloor = true;
  return plain;
}

namespace {
/// The digits of a number from one weight on, and below another one.
struct Digits {
  Value number;
  int64_t from = 1;
  std::optional<int64_t> to = std::nullopt;
};

/// How an index is made of a number: by constants, or by one division.
struct Part {
  unsigned position;
  int64_t from = 0, to = 0;
  Value divisor;
  bool isRemainder = false, isFloor = false;

  bool operator==(const Part &other) const {
    return position == other.position && from == other.from && to == other.to &&
           divisor == other.divisor && isRemainder == other.isRemainder &&
           isFloor == other.isFloor;
  }
};

/// A number that a list of indices determines.
struct Number {
  Value value;
  SmallVector<Part> parts;
};
} // namespace

static Digits getDigits(Value value, unsigned depth = 4) {
  value = stripCasts(value);
  Digits whole{value};
  std::optional<Division> division = matchDivision(value);
  if (!division || !division->isFloor || depth == 0)
    return whole;
  int64_t divisor = getConstant(division->divisor).value_or(0);
  if (divisor <= 0)
    return whole;
  auto divide = [&](Digits digits) -> std::optional<Digits> {
    int64_t middle;
    if (llvm::MulOverflow(digits.from, divisor, middle) ||
        (digits.to && *digits.to % middle != 0))
      return std::nullopt;
    if (division->isRemainder)
      digits.to = middle;
    else
      digits.from = middle;
    return digits;
  };
  if (auto inner = divide(getDigits(division->dividend, depth - 1)))
    return *inner;
  return *divide({stripCasts(division->dividend)});
}

static SmallVector<Number> findNumbers(ValueRange indices, Operation *loop) {
  SmallVector<Number> numbers;
  llvm::MapVector<Value, SmallVector<Part>> byNumber;
  for (auto [i, index] : llvm::enumerate(indices)) {
    unsigned position = i;
    Digits digits = getDigits(index);
    if (digits.from != 1 || digits.to)
      byNumber[digits.number].push_back(
          {position, digits.from, digits.to.value_or(0)});
  }
  for (auto &[value, parts] : byNumber) {
    Number number{value, {}};
    int64_t next = 1;
    bool isWhole = false;
    for (size_t round = 0; round != parts.size() && !isWhole; ++round) {
      auto *it =
          llvm::find_if(parts, [&](Part &part) { return part.from == next; });
      if (it == parts.end())
        break;
      number.parts.push_back(*it);
      next = it->to;
      isWhole = next == 0;
    }
    if (isWhole)
      numbers.push_back(std::move(number));
  }
  for (auto [i, index] : llvm::enumerate(indices)) {
    std::optional<Division> quotient = matchDivision(index);
    if (!quotient || quotient->isRemainder)
      continue;
    Value divisor = quotient->divisor;
    if (!matchPattern(divisor, m_Constant()) &&
        loop->isAncestor(divisor.getParentBlock()->getParentOp()))
      continue; // another one in each iteration
    for (auto [j, other] : llvm::enumerate(indices)) {
      std::optional<Division> rest = matchDivision(other);
      if (!rest || !rest->isRemainder || !rest->isOf(*quotient) ||
          rest->isFloor != quotient->isFloor)
        continue;
      auto part = [&](size_t position, const Division &division) {
        return Part{static_cast<unsigned>(position),
                    0,
                    0,
                    divisor,
                    division.isRemainder,
                    division.isFloor};
      };
      numbers.push_back(
          {stripCasts(rest->dividend), {part(i, *quotient), part(j, *rest)}});
    }
  }
  return numbers;
}

SmallVector<std::pair<Value, Value>>
mlir::tai::findNumbersOfDigits(ValueRange first, ValueRange second,
                               Operation *loop) {
  SmallVector<std::pair<Value, Value>> pairs;
  if (first.size() != second.size())
    return pairs;
  SmallVector<Number> others = findNumbers(second, loop);
  for (const Number &number : findNumbers(first, loop))
    for (const Number &other : others)
      if (number.parts == other.parts)
        pairs.emplace_back(number.value, other.value);
  return pairs;
}
