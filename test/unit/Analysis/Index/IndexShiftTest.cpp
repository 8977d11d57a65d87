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
/// Tests the shift of the value that a function of one argument returns.
class IndexShiftTest : public ::testing::Test {
protected:
  IndexShiftTest() {
    context.loadDialect<func::FuncDialect, arith::ArithDialect>();
  }

  /// Parses a function that returns %r; returns %r and the argument %i.
  std::pair<Value, Value> parse(StringRef body) {
    std::string text = "func.func @f(%i: index) -> index {\n" + body.str() +
                       "\nreturn %r : index\n}";
    module = parseSourceString<ModuleOp>(text, &context);
    auto function = *module->getOps<func::FuncOp>().begin();
    Operation *ret = function.getBody().front().getTerminator();
    return {ret->getOperand(0), function.getArgument(0)};
  }

  std::optional<IndexShift> shiftOf(StringRef body, int64_t lower,
                                    int64_t upper) {
    auto [index, variable] = parse(body);
    return getIndexShift(index, variable, lower, upper);
  }

  /// Checks the pieces of [lower, upper) against the values of each iteration.
  void expectPieces(StringRef body, int64_t lower, int64_t upper,
                    size_t count) {
    auto [index, variable] = parse(body);
    auto pieces = getIndexPieces(index, variable, lower, upper);
    ASSERT_TRUE(pieces) << body.str();
    EXPECT_EQ(pieces->size(), count) << body.str();
    int64_t at = lower;
    for (const IndexPiece &piece : *pieces) {
      EXPECT_EQ(piece.lower, at);
      for (; at != piece.upper; ++at)
        ASSERT_EQ(piece.at(at), evaluateIndex(index, variable, at))
            << body.str() << " at " << at;
    }
    EXPECT_EQ(at, upper);
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
  // An i8 overflows after 127: from there on, the sum is no shift.
  StringRef body = R"(
    %c = arith.constant 1 : i8
    %a = arith.index_cast %i : index to i8
    %b = arith.addi %a, %c : i8
    %r = arith.index_cast %b : i8 to index)";
  EXPECT_TRUE(shiftOf(body, 0, 127));
  EXPECT_FALSE(shiftOf(body, 0, 128));
}

TEST_F(IndexShiftTest, PiecesOfAllOperations) {
  struct Case {
    StringRef op;
    size_t count;
  };
  // The operands are i - 20 and 7, for i from 0 to 39.
  for (Case test :
       {Case{"arith.addi", 1}, Case{"arith.subi", 1}, Case{"arith.muli", 1},
        Case{"arith.minsi", 2}, Case{"arith.maxsi", 2}, Case{"arith.divsi", 5},
        Case{"arith.remsi", 5}, Case{"arith.floordivsi", 6}})
    for (StringRef type : {"index", "i32", "i64"}) {
      bool isIndex = type == "index";
      std::string body =
          ("%c20 = arith.constant 20 : " + type +
           "\n%c7 = arith.constant 7 : " + type + "\n" +
           (isIndex ? std::string("%a = arith.subi %i, %c20 : index\n")
                    : ("%j = arith.index_cast %i : index to " + type +
                       "\n%a = arith.subi %j, %c20 : " + type + "\n")
                          .str()) +
           (isIndex ? "%r = " : "%s = ") + test.op + " %a, %c7 : " + type +
           "\n" +
           (isIndex
                ? std::string()
                : ("%r = arith.index_cast %s : " + type + " to index").str()))
              .str();
      expectPieces(body, 0, 40, test.count);
    }
}

TEST_F(IndexShiftTest, PiecesOfComparisons) {
  for (auto [predicate, count] : {std::pair<StringRef, size_t>{"eq", 3},
                                  {"ne", 3},
                                  {"slt", 2},
                                  {"sle", 2},
                                  {"sgt", 2},
                                  {"sge", 2},
                                  {"ult", 3},
                                  {"ule", 3},
                                  {"ugt", 3},
                                  {"uge", 3}}) {
    std::string body = ("%c20 = arith.constant 20 : i32\n"
                        "%c7 = arith.constant 7 : i32\n"
                        "%c5 = arith.constant 5 : index\n"
                        "%j = arith.index_cast %i : index to i32\n"
                        "%a = arith.subi %j, %c20 : i32\n"
                        "%t = arith.cmpi " +
                        predicate +
                        ", %a, %c7 : i32\n"
                        "%r = arith.select %t, %i, %c5 : index")
                           .str();
    expectPieces(body, 0, 40, count);
  }
}

TEST_F(IndexShiftTest, PiecesOfExactMultiples) {
  // 6 i - 15 divided by 3, rounded towards zero: quotient and remainder are
  // linear on either side of zero.
  StringRef body = R"(
    %c6 = arith.constant 6 : index
    %c14 = arith.constant 14 : index
    %c3 = arith.constant 3 : index
    %a = arith.muli %i, %c6 : index
    %b = arith.subi %a, %c14 : index
    %r = arith.divsi %b, %c3 : index)";
  expectPieces(body, 0, 20, 2);
}

TEST_F(IndexShiftTest, PiecesOfArithmeticThatWraps) {
  StringRef body = R"(
    %c = arith.constant 100 : i8
    %a = arith.index_cast %i : index to i8
    %b = arith.addi %a, %c : i8
    %r = arith.index_cast %b : i8 to index)";
  expectPieces(body, 0, 600, 4);
}

TEST_F(IndexShiftTest, LengthDoesNotMatter) {
  for (int64_t length : {int64_t(65536), int64_t(65537), int64_t(1) << 40}) {
    std::string n = std::to_string(length);
    std::string body = "%c = arith.constant 1 : index\n"
                       "%n = arith.constant " +
                       n +
                       " : index\n"
                       "%a = arith.addi %i, %c : index\n"
                       "%r = arith.remsi %a, %n : index";
    std::optional<IndexShift> shift = shiftOf(body, 0, length);
    ASSERT_TRUE(shift) << length;
    EXPECT_EQ(shift->offset, 1);
    EXPECT_TRUE(shift->wraps);
  }
}

TEST_F(IndexShiftTest, ManyPiecesAreNone) {
  auto [index, variable] = parse(R"(
    %c = arith.constant 2 : index
    %r = arith.remsi %i, %c : index)");
  EXPECT_FALSE(getIndexPieces(index, variable, 0, 1000));
}
