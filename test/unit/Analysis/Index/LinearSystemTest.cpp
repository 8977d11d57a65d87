//===- LinearSystemTest.cpp - Systems of linear inequalities --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Tests both shadows of random systems against all points of a box.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Index/LinearSystem.h"
#include "gtest/gtest.h"
#include <random>

using namespace mlir;
using namespace mlir::tai;

using Shadow = LinearSystem::Shadow;

/// a x + b y + c >= 0
static LinearSum sumOf(int64_t a, int64_t b, int64_t c) {
  return LinearSum()
      .plus(LinearSum::variable(0), a)
      .plus(LinearSum::variable(1), b)
      .plus(c);
}

static bool holds(const LinearSystem &system, int64_t x, int64_t y) {
  return !system.isContradictory() &&
         llvm::all_of(system.getRows(), [&](const LinearSum &row) {
           return row.getFactor(0) * x + row.getFactor(1) * y + row.constant >=
                  0;
         });
}

TEST(LinearSystem, KeepsTheStrongestRow) {
  LinearSystem system;
  system.require(sumOf(2, 0, -3)); // x >= 1.5
  system.require(sumOf(1, 0, -1));
  ASSERT_EQ(system.getRows().size(), 1u);
  EXPECT_EQ(system.getRows()[0], sumOf(1, 0, -2));
  EXPECT_FALSE(system.isContradictory());
  system.require(sumOf(-1, 0, 1)); // x <= 1
  EXPECT_TRUE(system.isContradictory());
}

TEST(LinearSystem, SaysWhereNumbersDoNotFit) {
  LinearSum large = sumOf(INT64_MAX, 0, INT64_MAX);
  EXPECT_TRUE(large.plus(large).hasOverflow);
  LinearSystem system;
  system.require(large.plus(large, 3));
  EXPECT_TRUE(system.isUnknown());
}

// 2 <= 3 x <= 2 y: the dark shadow excludes values of y that might have no x.
TEST(LinearSystem, ShadowsHoldAllAndOnlySolutions) {
  std::mt19937 random(1);
  auto pick = [&](int64_t most) {
    return std::uniform_int_distribution<int64_t>(-most, most)(random);
  };
  unsigned inexact = 0;
  for (int trial = 0; trial != 2000; ++trial) {
    LinearSystem system;
    // Bounds, so that all points can be tried.
    for (int64_t sign : {-1, 1}) {
      system.require(sumOf(sign, 0, 9));
      system.require(sumOf(0, sign, 9));
    }
    for (int row = 0; row != 3; ++row)
      system.require(sumOf(pick(4), pick(4), pick(12)));
    bool isExact = true;
    LinearSystem real = system.eliminate(0, Shadow::Real, isExact);
    LinearSystem dark = system.eliminate(0, Shadow::Dark, isExact);
    inexact += !isExact;
    for (int64_t y = -9; y <= 9; ++y) {
      bool isSolvable = false;
      for (int64_t x = -9; x <= 9; ++x)
        isSolvable |= holds(system, x, y);
      EXPECT_TRUE(!isSolvable || holds(real, 0, y));
      EXPECT_TRUE(isSolvable || !holds(dark, 0, y));
      if (isExact)
        EXPECT_EQ(isSolvable, holds(real, 0, y));
    }
  }
  EXPECT_GT(inexact, 100u);
  EXPECT_LT(inexact, 1900u);
}
