//===- IndexShiftTest.cpp - Recognition of shifted indices ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Index/IndexShift.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/IR/BuiltinOps.h"
#include "mlir/Parser/Parser.h"
#include "gtest/gtest.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// The shift of the value that a one-argument function returns.
class IndexShiftTest : public ::testing::Test {
protected:
  IndexShiftTest() {
    context.loadDialect<func::FuncDialect, arith::ArithDialect>();
  }

  std::optional<IndexShift> shiftOf(StringRef body, int64_t lower,
                                    int64_t upper) {
    std::string text = "func.func @f(%i: index) -> index {\n" + body.str() +
                       "\nreturn %r : index\n}";
    module = parseSourceString<ModuleOp>(text, &context);
    auto function = *module->getOps<func::FuncOp>().begin();
    Operation *ret = function.getBody().front().getTerminator();
    return getIndexShift(ret->getOperand(0), function.getArgument(0), lower,
                         upper);
  }

  MLIRContext context;
  OwningOpRef<ModuleOp> module;
};
} // namespace

TEST_F(IndexShiftTest, PlainShift) {
  std::optional<IndexShift> shift = shiftOf(R"(
    %c = arith.constant 3 : index
    %r = arith.subi %i, %c : index)",
                                            0, 10);
  ASSERT_TRUE(shift);
  EXPECT_EQ(shift->offset, -3);
  EXPECT_FALSE(shift->wraps);
}

TEST_F(IndexShiftTest, WrapsAroundEitherEnd) {
  for (int64_t offset : {-4, -1, 1, 5}) {
    std::string body =
        "%c = arith.constant " + std::to_string(offset) + R"( : i32
      %n = arith.constant 11 : i32
      %i32 = arith.index_cast %i : index to i32
      %a = arith.addi %i32, %c : i32
      %q = arith.floordivsi %a, %n : i32
      %m = arith.muli %q, %n : i32
      %s = arith.subi %a, %m : i32
      %r = arith.index_cast %s : i32 to index)";
    std::optional<IndexShift> shift = shiftOf(body, 0, 11);
    ASSERT_TRUE(shift) << offset;
    EXPECT_EQ(shift->offset, offset);
    EXPECT_TRUE(shift->wraps);
  }
}

TEST_F(IndexShiftTest, ClampIsNoShift) {
  EXPECT_FALSE(shiftOf(R"(
    %c = arith.constant 1 : index
    %z = arith.constant 9 : index
    %a = arith.addi %i, %c : index
    %r = arith.minsi %a, %z : index)",
                       0, 10));
}

TEST_F(IndexShiftTest, WrapByAnotherLengthIsNoShift) {
  EXPECT_FALSE(shiftOf(R"(
    %c = arith.constant 1 : index
    %n = arith.constant 7 : index
    %a = arith.addi %i, %c : index
    %r = arith.remui %a, %n : index)",
                       0, 10));
}

TEST_F(IndexShiftTest, ProductsAndDivisionsAreNoShifts) {
  EXPECT_FALSE(shiftOf(R"(
    %c = arith.constant 2 : index
    %r = arith.muli %i, %c : index)",
                       0, 10));
  EXPECT_FALSE(shiftOf(R"(
    %c = arith.constant 0 : index
    %r = arith.divsi %i, %c : index)",
                       0, 10));
}

TEST_F(IndexShiftTest, NarrowArithmeticWrapsInItsWidth) {
  // i8 overflows at 127: from there the sum is no shift.
  StringRef body = R"(
    %c = arith.constant 1 : i8
    %a = arith.index_cast %i : index to i8
    %b = arith.addi %a, %c : i8
    %r = arith.index_cast %b : i8 to index)";
  EXPECT_TRUE(shiftOf(body, 0, 127));
  EXPECT_FALSE(shiftOf(body, 0, 128));
}
