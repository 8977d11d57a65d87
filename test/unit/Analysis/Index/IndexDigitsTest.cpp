//===- IndexDigitsTest.cpp - Quotients and remainders of indices ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A number's digits determine the number, and a number composed of digits has
// these digits.
//
//===----------------------------------------------------------------------===//

#include "IndexPrograms.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
class IndexDigitsTest : public IndexPrograms {};
} // namespace

// Digits of a number, in i32 as programs write them, distinguish iterations.
TEST_F(IndexDigitsTest, DigitsDetermineTheirNumber) {
  for (bool isConstant : {true, false}) {
    start(0, 24, 0, 5);
    Type i32 = b.getI32Type();
    Value i = arith::IndexCastOp::create(b, i32, loop.getInductionVars()[0]);
    Value j = loop.getInductionVars()[1];
    Value m = isConstant ? constant(7, i32) : arguments[1];
    Value quotient = roundDown(true, i, m), rest = roundDown(false, i, m);
    IndexBuilder builder;
    ValueRange ivs = loop.getInductionVars();
    EXPECT_TRUE(
        isInjectiveOver(builder, builder.get({rest, quotient, j}), ivs));
    EXPECT_FALSE(isInjectiveOver(builder, builder.get({rest, j}), ivs));
    EXPECT_FALSE(isInjectiveOver(builder, builder.get({quotient, j}), ivs));
    Value joined =
        arith::AddIOp::create(b, arith::MulIOp::create(b, quotient, m), rest);
    IndexExpr expr = builder.get(joined);
    EXPECT_EQ(expr.compare(builder.get(i)), 0);
    EXPECT_EQ(expr.isExact(), isConstant);
    SmallVector<Value> places{rest, quotient, j};
    EXPECT_FALSE(mayMeet(loop, {places, {}}, {places, {}}));
    places.pop_back();
    EXPECT_TRUE(mayMeet(loop, {places, {}}, {places, {}}));
  }
}

// Two numbers with the same digits are equal, if all digits are there and
// whether or not the arithmetic of the numbers may wrap.
TEST_F(IndexDigitsTest, DigitsOfTwoNumbers) {
  int apart = 0, together = 0;
  for (int round = 0; round != 1500; ++round) {
    int64_t lower0 = chance(60) ? 0 : pick(-9, 3), lower1 = pick(-1, 1);
    start(lower0, lower0 + pick(2, 11), lower1, lower1 + pick(1, 3));
    Type types[] = {b.getI16Type(), b.getI32Type(), b.getI64Type(),
                    b.getIndexType()};
    Type type = types[pick(0, 3)];
    auto ofLoop = [&](size_t k) {
      Value iv = loop.getInductionVars()[k];
      return type.isIndex() ? iv : arith::IndexCastOp::create(b, type, iv);
    };
    auto multiply = [&](Value value, int64_t factor) -> Value {
      return arith::MulIOp::create(b, value, constant(factor, type));
    };
    Value shared = arith::AddIOp::create(b, multiply(ofLoop(0), pick(-1, 3)),
                                         multiply(ofLoop(1), pick(-2, 3)));
    if (chance(30))
      shared = arith::AddIOp::create(b, shared, castTo(arguments[0], type));
    int64_t distance = chance(40) ? 0 : pick(-3, 3);
    Value numbers[] = {
        shared, arith::AddIOp::create(b, shared, constant(distance, type))};
    Value low =
        chance(70) ? constant(pick(1, 6), type) : castTo(arguments[1], type);
    Value high = constant(pick(1, 4), type);
    bool isFloor = chance(75), isLong = chance(40);
    int64_t dropped = chance(80) ? -1 : pick(0, isLong ? 2 : 1);
    SmallVector<Value> digits[2];
    for (int k = 0; k != 2; ++k) {
      auto divide = [&](bool isQuotient) -> Value {
        if (isFloor)
          return roundDown(isQuotient, numbers[k], low);
        return isQuotient
                   ? arith::DivSIOp::create(b, numbers[k], low).getResult()
                   : arith::RemSIOp::create(b, numbers[k], low).getResult();
      };
      Value quotient = divide(true);
      digits[k] = {divide(false)};
      if (isLong)
        digits[k].push_back(roundDown(false, quotient, high));
      digits[k].push_back(isLong ? roundDown(true, quotient, high) : quotient);
      if (dropped >= 0)
        digits[k].erase(digits[k].begin() + dropped);
    }
    bool isApart = !mayMeet(loop, {digits[0], {}}, {digits[1], {}});
    bool meets = false;
    for (int sample = 0; sample != 3; ++sample) {
      SmallVector<int64_t> values{pick(-4, 9), pick(-5, 5), 0};
      std::vector<Env> envs = enumerate(values);
      for (size_t x = 0; x != envs.size(); ++x)
        for (size_t y = 0; y != envs.size(); ++y) {
          auto isEqual = [&](auto pair) {
            auto [first, second] = pair;
            auto number = numberOf(first, envs[x]);
            return number && number == numberOf(second, envs[y]);
          };
          meets |=
              x != y && llvm::all_of(llvm::zip(digits[0], digits[1]), isEqual);
        }
    }
    ASSERT_FALSE(isApart && meets) << print(*module);
    apart += isApart, together += meets;
  }
  EXPECT_GT(apart, 300);
  EXPECT_GT(together, 300);
}

// A division rounds down if its condition tests that remainder and divisor have
// different signs, in either order; a condition on other numbers makes it a
// different operation.
TEST_F(IndexDigitsTest, ConditionsOfDivisionsThatRoundDown) {
  start(0, 24, 0, 5);
  Type i32 = b.getI32Type();
  Value x = arith::IndexCastOp::create(b, i32, loop.getInductionVars()[0]);
  Value m = arguments[1], zero = constant(0, i32);
  Value other = arith::IndexCastOp::create(b, i32, loop.getInductionVars()[1]);
  Value rest = arith::RemSIOp::create(b, x, m);
  Value restByOther = arith::RemSIOp::create(b, x, other);
  Value restOfOther = arith::RemSIOp::create(b, other, m);
  Value quotient = arith::DivSIOp::create(b, x, m);
  auto differ = [&](Value asked, Value lhs, Value rhs) -> Value {
    return arith::AndIOp::create(
        b, arith::CmpIOp::create(b, arith::CmpIPredicate::ne, asked, zero),
        arith::CmpIOp::create(b, arith::CmpIPredicate::slt,
                              arith::XOrIOp::create(b, lhs, rhs), zero));
  };
  Value conditions[] = {differ(rest, rest, m),
                        differ(rest, m, rest),
                        differ(rest, rest, other),
                        differ(rest, other, rest),
                        differ(rest, m, other),
                        differ(rest, other, m),
                        differ(restByOther, restByOther, m),
                        differ(restOfOther, restOfOther, m)};
  IndexBuilder builder;
  IndexExpr downQuotient = builder.get(roundDown(true, x, m));
  IndexExpr downRest = builder.get(roundDown(false, x, m));
  for (auto [number, condition] : llvm::enumerate(conditions)) {
    Value less = arith::SubIOp::create(b, quotient, constant(1, i32));
    Value more = arith::AddIOp::create(b, rest, m);
    EXPECT_EQ(builder.get(arith::SelectOp::create(b, condition, less,
                                                  quotient)) == downQuotient,
              number < 2)
        << number;
    EXPECT_EQ(builder.get(arith::SelectOp::create(b, condition, more, rest)) ==
                  downRest,
              number < 2)
        << number;
  }
}

TEST_F(IndexDigitsTest, ThreeDigits) {
  start(0, 24, 0, 1);
  Value i = loop.getInductionVars()[0];
  auto number = [&](int64_t value) {
    return constant(value, b.getIndexType());
  };
  Value high = arith::FloorDivSIOp::create(b, i, number(12));
  Value middle = arith::RemSIOp::create(
      b, arith::FloorDivSIOp::create(b, i, number(3)), number(4));
  Value low = arith::RemSIOp::create(b, i, number(3));
  IndexBuilder builder;
  ValueRange ivs = loop.getInductionVars().take_front();
  EXPECT_TRUE(isInjectiveOver(builder, builder.get({high, middle, low}), ivs));
  EXPECT_FALSE(isInjectiveOver(builder, builder.get({middle, low}), ivs));
}

// The digits of a number that was composed of digits are recovered.
TEST_F(IndexDigitsTest, DigitsOfDigits) {
  start(0, 8, 0, 4);
  Value i = loop.getInductionVars()[0], j = loop.getInductionVars()[1];
  Value four = constant(4, b.getIndexType());
  Value number = arith::AddIOp::create(b, arith::MulIOp::create(b, i, four), j);
  IndexBuilder builder;
  EXPECT_EQ(builder.get(arith::DivUIOp::create(b, number, four)),
            builder.get(i));
  EXPECT_EQ(builder.get(arith::RemSIOp::create(b, number, four)),
            builder.get(j));
}

// A multiple of the divisor is moved out of a quotient, so that a number that
// is composed of its high digits and the low digits of a summand is recognised.
TEST_F(IndexDigitsTest, MultiplesOfTheDivisor) {
  start(0, 4, 0, 8);
  for (bool isIndex : {true, false}) {
    Type type = isIndex ? Type(b.getIndexType()) : b.getI32Type();
    auto number = [&](int64_t value) { return constant(value, type); };
    Value i = castTo(loop.getInductionVars()[0], type);
    Value j = castTo(loop.getInductionVars()[1], type);
    Value whole =
        arith::AddIOp::create(b, arith::MulIOp::create(b, i, number(8)), j);
    IndexBuilder builder;
    Value high =
        arith::MulIOp::create(b, roundDown(true, whole, number(4)), number(4));
    Value flat = arith::AddIOp::create(b, high, roundDown(false, j, number(4)));
    EXPECT_EQ(builder.get(flat), builder.get(whole));
    ValueRange ivs = loop.getInductionVars();
    EXPECT_TRUE(isInjectiveOver(builder, builder.get(flat), ivs));
    // Blocks of four that overlap.
    Value mixed =
        arith::AddIOp::create(b, high, roundDown(false, j, number(5)));
    EXPECT_FALSE(isInjectiveOver(builder, builder.get(mixed), ivs));
    // The constant of the dividend is reduced below the divisor.
    Value next = arith::AddIOp::create(b, whole, number(13));
    Value three = arith::AddIOp::create(
        b,
        roundDown(true, arith::AddIOp::create(b, whole, number(1)), number(4)),
        number(3));
    EXPECT_EQ(builder.get(roundDown(true, next, number(4))),
              builder.get(three));
  }
  // A sum with an argument may wrap: its digits are not those of its terms.
  Value n = arguments[1], four = constant(4, n.getType());
  Value i = castTo(loop.getInductionVars()[0], n.getType());
  Value sum = arith::AddIOp::create(b, arith::MulIOp::create(b, i, four), n);
  Value apart = arith::AddIOp::create(b, i, roundDown(true, n, four));
  IndexBuilder builder;
  EXPECT_FALSE(builder.get(roundDown(true, sum, four)) == builder.get(apart));
}

// Masks and shifts yield digits, and the union of a number's digits is the
// number.
TEST_F(IndexDigitsTest, DigitsOfBits) {
  start(0, 24, 0, 4);
  Value i = loop.getInductionVars()[0], j = loop.getInductionVars()[1];
  auto number = [&](int64_t value) {
    return constant(value, b.getIndexType());
  };
  IndexBuilder builder;
  Value high = arith::ShRSIOp::create(b, i, number(2));
  Value low = arith::AndIOp::create(b, i, number(3));
  ValueRange ivs = loop.getInductionVars();
  EXPECT_TRUE(isInjectiveOver(builder, builder.get({high, low, j}), ivs));
  EXPECT_FALSE(isInjectiveOver(builder, builder.get({low, j}), ivs));
  Value joined =
      arith::OrIOp::create(b, low, arith::ShLIOp::create(b, high, number(2)));
  EXPECT_EQ(builder.get(joined), builder.get(i));
  Value both =
      arith::OrIOp::create(b, arith::ShLIOp::create(b, i, number(2)), j);
  EXPECT_TRUE(isInjectiveOver(builder, builder.get(both), ivs));
  // 2 i and j overlap.
  Value mixed =
      arith::OrIOp::create(b, arith::ShLIOp::create(b, i, number(1)), j);
  EXPECT_FALSE(isInjectiveOver(builder, builder.get(mixed), ivs));
  EXPECT_EQ(builder.get(arith::AndIOp::create(b, both, number(-4))),
            builder.get(arith::ShLIOp::create(b, i, number(2))));
}

// A complement counts down: of all bits, or of the bits of a digit.
TEST_F(IndexDigitsTest, ComplementsOfBits) {
  start(0, 24, 0, 4);
  Value i = loop.getInductionVars()[0], j = loop.getInductionVars()[1];
  auto number = [&](int64_t value) {
    return constant(value, b.getIndexType());
  };
  IndexBuilder builder;
  auto without = [&](int64_t from, Value value) {
    return builder.get(
        arith::SubIOp::create(b, number(from), value).getResult());
  };
  auto flip = [&](Value value, int64_t mask) {
    return builder.get(
        arith::XOrIOp::create(b, value, number(mask)).getResult());
  };
  EXPECT_EQ(flip(i, -1), without(-1, i));
  EXPECT_EQ(flip(i, 31), without(31, i));
  EXPECT_EQ(flip(j, 3), without(3, j));
  ValueRange ivs = loop.getInductionVars();
  EXPECT_TRUE(isInjectiveOver(builder, {flip(i, 31), flip(j, 3)}, ivs));
  // Numbers from 16 on have bits outside the mask 15; 5 is no mask of low bits.
  EXPECT_FALSE(flip(i, 15) == without(15, i));
  EXPECT_FALSE(flip(j, 5) == without(5, j));
}

// Flipping bits, as in the steps of an FFT, maps different numbers to different
// numbers, and flipping them twice restores the number. Any bits may be
// flipped, also in negative numbers.
TEST_F(IndexDigitsTest, FlippedBits) {
  start(-7, 24, 0, 8);
  Value i = loop.getInductionVars()[0], j = loop.getInductionVars()[1];
  ValueRange ivs = loop.getInductionVars();
  IndexBuilder builder;
  auto flip = [&](Value value, int64_t mask) -> Value {
    return arith::XOrIOp::create(b, value, constant(mask, value.getType()));
  };
  for (int64_t mask : {1, 2, 5, 8, 10, 15, 21, -2, -6, -9}) {
    Value flipped = flip(i, mask);
    EXPECT_TRUE(isInjectiveOver(builder, builder.get({flipped, j}), ivs))
        << mask;
    EXPECT_FALSE(isInjectiveOver(builder, builder.get(flipped), ivs)) << mask;
    EXPECT_EQ(builder.get(flip(flipped, mask)), builder.get(i)) << mask;
    EXPECT_FALSE(builder.get(flipped) == builder.get(i)) << mask;
  }
  EXPECT_EQ(builder.get(flip(flip(j, 5), 2)), builder.get(flip(j, 7)));
  // The same in i32, also for a sum of two numbers.
  Value narrow = arith::IndexCastOp::create(b, b.getI32Type(), i);
  Value sum = arith::AddIOp::create(
      b, narrow, arith::IndexCastOp::create(b, b.getI32Type(), j));
  EXPECT_TRUE(isInjectiveOver(builder, builder.get({flip(narrow, 6), j}), ivs));
  EXPECT_FALSE(isInjectiveOver(builder, builder.get(flip(sum, 6)), ivs));
  // Dropping the lowest bit makes 22 and 23 equal.
  Value dropped = arith::AndIOp::create(b, i, constant(-2, i.getType()));
  EXPECT_FALSE(
      isInjectiveOver(builder, builder.get({flip(dropped, 6), j}), ivs));
}

// Digits that count down are recognised like digits that count up.
TEST_F(IndexDigitsTest, DigitsThatCountDown) {
  start(0, 6, 0, 8);
  ValueRange ivs = loop.getInductionVars();
  IndexBuilder builder;
  auto flat = [&](int64_t first, int64_t second, int64_t constant) {
    IndexExpr expr(constant);
    return expr.add(IndexExpr(ivs[0]), first).add(IndexExpr(ivs[1]), second);
  };
  for (auto [first, second] :
       {std::pair{8, 1}, {8, -1}, {-8, 1}, {-8, -1}, {-9, 1}, {1, -6}})
    EXPECT_TRUE(isInjectiveOver(builder, flat(first, second, 47), ivs))
        << first << ' ' << second;
  for (auto [first, second] :
       {std::pair{7, 1}, {7, -1}, {-7, 1}, {-7, -1}, {1, -5}})
    EXPECT_FALSE(isInjectiveOver(builder, flat(first, second, 47), ivs))
        << first << ' ' << second;
}

// A row of run-time length around a ring of run-time size: the element alone
// does not distinguish iterations, since the size may be one. Equal expressions
// are recognised, and element and number of rounds determine the place.
TEST_F(IndexDigitsTest, RowsAroundARing) {
  start(0, 5, 0, 4);
  ValueRange ivs = loop.getInductionVars();
  Type i64 = b.getI64Type();
  Value i = arith::IndexCastOp::create(b, i64, ivs[0]);
  Value j = arith::IndexCastOp::create(b, i64, ivs[1]);
  Value k = arith::ExtSIOp::create(b, i64, arguments[0]);
  Value n = arith::ExtSIOp::create(b, i64, arguments[1]);
  auto place = [&](bool isSwapped) -> Value {
    Value row = isSwapped ? arith::MulIOp::create(b, k, i).getResult()
                          : arith::MulIOp::create(b, i, k);
    return isSwapped ? arith::AddIOp::create(b, j, row).getResult()
                     : arith::AddIOp::create(b, row, j);
  };
  IndexBuilder builder;
  Value element = roundDown(false, place(false), n);
  Value rounds = roundDown(true, place(false), n);
  EXPECT_EQ(builder.get(element),
            builder.get(roundDown(false, place(true), n)));
  EXPECT_FALSE(isInjectiveOver(builder, builder.get({element, j}), ivs));
  EXPECT_TRUE(
      isInjectiveOver(builder, builder.get({element, rounds, j, i}), ivs));
  IterationEquations equations(builder, loop);
  equations.add(ValueRange{element, rounds}, ValueRange{element, rounds});
  EXPECT_FALSE(equations.solve(ivs));
  IndexExpr flat = builder.get(place(true));
  EXPECT_TRUE(llvm::is_contained(equations.get(), std::pair(flat, flat)));
}

// Two indices that differ in any two iterations, by all pairs of iterations.
TEST_F(IndexDigitsTest, DistinctOverIterations) {
  int distinct = 0;
  for (int round = 0; round != 400; ++round) {
    int64_t lower = pick(-3, 3), upper = lower + pick(1, 9);
    start(lower, upper, 0, 1);
    Value i = loop.getInductionVars()[0], n = arguments[0];
    int64_t factors[] = {pick(-4, 4), pick(-4, 4)};
    int64_t constants[] = {pick(-9, 9), pick(-9, 9)};
    bool hasArgument[] = {chance(40), chance(40)};
    IndexBuilder builder;
    IndexExpr sides[2];
    for (int k : {0, 1}) {
      sides[k] = IndexExpr(constants[k]);
      sides[k].add(IndexExpr(i), factors[k]);
      if (hasArgument[k])
        sides[k].add(IndexExpr(n), 2);
    }
    bool found = areDistinctOver(sides[0], sides[1], loop);
    distinct += found;
    for (int64_t a = lower; a != upper; ++a)
      for (int64_t b = lower; b != upper; ++b)
        for (int64_t value = -4; value != 5; ++value) {
          int64_t x =
              constants[0] + factors[0] * a + 2 * value * hasArgument[0];
          int64_t y =
              constants[1] + factors[1] * b + 2 * value * hasArgument[1];
          if (found)
            ASSERT_NE(x, y);
        }
  }
  EXPECT_GT(distinct, 30);
}
