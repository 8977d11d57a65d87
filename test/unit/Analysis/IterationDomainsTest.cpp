//===- IterationDomainsTest.cpp - Indices and when blocks run -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/IterationDomains.h"
#include "../Utils/ContextTest.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Parser/Parser.h"
#include "gtest/gtest.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// A kernel of `%n: i32` with a loop `%i` from 0 to 10 around the body, in
/// which a `tai.print` marks the place to test.
class IterationDomainsTest : public ContextTest {
protected:
  void parse(StringRef body) {
    std::string text = R"(
      tai.kernel @k(%n: i32) {
        %c0 = arith.constant 0 : index
        %c2 = arith.constant 2 : index
        %c3 = arith.constant 3 : index
        %c10 = arith.constant 10 : index
        tai.parallel_for (%i) = (%c0) to (%c10) {
    )" + body.str() + "}\ntai.return\n}";
    module = parseSourceString<ModuleOp>(text, &context);
    ASSERT_TRUE(module);
    kernel = module->lookupSymbol<KernelOp>("k");
    kernel->walk([&](PrintOp op) { print = op; });
    forms = std::make_unique<IndexForms>(kernel);
  }

  /// The form of the printed value.
  LinearForm formOf() { return forms->formOf(print.getArgs().front()); }
  IterationDomain domainOf() {
    return IterationDomains(kernel, *forms).domainOf(print->getBlock());
  }

  /// The numbers from -2 to 11 that are in the domain of the printed block;
  /// each sum must be a sum of `%i` alone.
  std::vector<int64_t> pointsOf() {
    std::vector<int64_t> points;
    IterationDomain domain = domainOf();
    for (int64_t i = -2; i != 12; ++i)
      if (llvm::any_of(domain.pieces, [&](ArrayRef<LinearSum> rows) {
            return llvm::all_of(rows, [&](const LinearSum &row) {
              int64_t value = row.constant;
              for (auto [variable, factor] : row.terms) {
                EXPECT_EQ(variable, domain.loops.front());
                value += factor * i;
              }
              return value >= 0;
            });
          }))
        points.push_back(i);
    return points;
  }

  OwningOpRef<ModuleOp> module;
  KernelOp kernel;
  PrintOp print;
  std::unique_ptr<IndexForms> forms;
};
} // namespace

TEST_F(IterationDomainsTest, SumsOfLoopIndices) {
  parse(R"(
    %a = arith.muli %i, %c2 : index
    %b = arith.addi %a, %c3 : index
    tai.print "{}"(%b) : index)");
  LinearForm form = formOf();
  EXPECT_TRUE(form.isCertain);
  EXPECT_TRUE(form.isComplete);
  ASSERT_EQ(form.sum.terms.size(), 1u);
  EXPECT_EQ(form.sum.terms.front().second, 2);
  EXPECT_EQ(form.sum.constant, 3);
  EXPECT_EQ(forms->getKind(form.sum.terms.front().first),
            IndexForms::Kind::Loop);
  NumberRange range = forms->rangeOf(print.getArgs().front());
  EXPECT_EQ(range.low, 3);
  EXPECT_EQ(range.high, 21);
}

// A number that the launch passes may have any value: it is an assumption that
// the sum does not wrap.
TEST_F(IterationDomainsTest, SumsOfArgumentsAreAssumedNotToWrap) {
  parse(R"(
    %j = arith.index_cast %i : index to i32
    %b = arith.addi %j, %n : i32
    tai.print "{}"(%b) : i32)");
  LinearForm form = formOf();
  EXPECT_TRUE(form.isCertain);
  EXPECT_FALSE(form.isComplete);
  EXPECT_FALSE(form.facts.empty());
  EXPECT_TRUE(forms->isLaunchValue(kernel.getArgument(0)));
  EXPECT_FALSE(forms->isLaunchValue(print.getArgs().front()));
}

TEST_F(IterationDomainsTest, ProductsOfLoopsAndArguments) {
  parse(R"(
    %m = arith.index_cast %n : i32 to index
    %b = arith.muli %i, %m : index
    tai.print "{}"(%b) : index)");
  LinearForm form = formOf();
  EXPECT_TRUE(forms->hasProduct(form.sum));
  EXPECT_FALSE(forms->isOfLaunch(form.sum));
  ArrayRef<LinearSum> factors = forms->getFactors(form.sum.terms.front().first);
  ASSERT_EQ(factors.size(), 2u);
  EXPECT_TRUE(forms->isOfLaunch(factors[0]));
  EXPECT_FALSE(forms->isOfLaunch(factors[1]));
}

TEST_F(IterationDomainsTest, LoopsBound) {
  parse(R"(
    tai.print "{}"(%i) : index)");
  IterationDomain domain = domainOf();
  EXPECT_EQ(domain.loops.size(), 1u);
  ASSERT_EQ(domain.pieces.size(), 1u);
  // i >= 0 and i <= 9.
  EXPECT_EQ(domain.pieces.front().size(), 2u);
  EXPECT_TRUE(domain.isCertain);
  EXPECT_TRUE(domain.isComplete);
}

// A condition a != b makes two pieces, a < b and a > b; a false condition makes
// none.
TEST_F(IterationDomainsTest, ConditionsAreUnions) {
  parse(R"(
    %ne = arith.cmpi ne, %i, %c3 : index
    scf.if %ne {
      tai.print "{}"(%i) : index
    })");
  EXPECT_EQ(domainOf().pieces.size(), 2u);
  parse(R"(
    %never = arith.constant false
    scf.if %never {
      tai.print "{}"(%i) : index
    })");
  EXPECT_TRUE(domainOf().pieces.empty());
}

// Under a condition on data, a statement may or may not run.
TEST_F(IterationDomainsTest, DataMakesUncertain) {
  parse(R"(
    %r = tai.random stream 0 : i1
    scf.if %r {
      tai.print "{}"(%i) : index
    })");
  IterationDomain domain = domainOf();
  EXPECT_FALSE(domain.isCertain);
  EXPECT_TRUE(domain.isComplete);
  EXPECT_EQ(domain.pieces.size(), 1u);
}

// The points of a domain are the iterations in which its block runs.
TEST_F(IterationDomainsTest, ConditionsOfOneIndex) {
  struct Case {
    const char *condition;
    bool (*holds)(int64_t i);
  };
  const Case cases[] = {
      {"%if = arith.cmpi slt, %i, %c3 : index",
       [](int64_t i) { return i < 3; }},
      {"%if = arith.cmpi sle, %i, %c3 : index",
       [](int64_t i) { return i <= 3; }},
      {"%if = arith.cmpi sgt, %i, %c3 : index",
       [](int64_t i) { return i > 3; }},
      {"%if = arith.cmpi sge, %i, %c3 : index",
       [](int64_t i) { return i >= 3; }},
      {"%if = arith.cmpi eq, %i, %c3 : index",
       [](int64_t i) { return i == 3; }},
      {"%if = arith.cmpi ne, %i, %c3 : index",
       [](int64_t i) { return i != 3; }},
      {"%if = arith.cmpi ult, %i, %c3 : index",
       [](int64_t i) { return i < 3; }},
      {"%if = arith.cmpi ule, %i, %c3 : index",
       [](int64_t i) { return i <= 3; }},
      {"%if = arith.cmpi ugt, %i, %c3 : index",
       [](int64_t i) { return i > 3; }},
      {"%if = arith.cmpi uge, %i, %c3 : index",
       [](int64_t i) { return i >= 3; }},
      {"%a = arith.cmpi sge, %i, %c2 : index\n"
       "%b = arith.cmpi sle, %i, %c3 : index\n"
       "%if = arith.andi %a, %b : i1",
       [](int64_t i) { return i >= 2 && i <= 3; }},
      {"%a = arith.cmpi slt, %i, %c2 : index\n"
       "%b = arith.cmpi sgt, %i, %c3 : index\n"
       "%if = arith.ori %a, %b : i1",
       [](int64_t i) { return i < 2 || i > 3; }},
      {"%a = arith.cmpi slt, %i, %c2 : index\n"
       "%true = arith.constant true\n"
       "%if = arith.xori %a, %true : i1",
       [](int64_t i) { return i >= 2; }},
      {"%a = arith.cmpi sge, %i, %c2 : index\n"
       "%b = arith.cmpi sle, %i, %c3 : index\n"
       "%false = arith.constant false\n"
       "%if = arith.select %a, %b, %false : i1",
       [](int64_t i) { return i >= 2 && i <= 3; }},
      {"%a = arith.cmpi slt, %i, %c2 : index\n"
       "%b = arith.cmpi sgt, %i, %c3 : index\n"
       "%true = arith.constant true\n"
       "%if = arith.select %a, %true, %b : i1",
       [](int64_t i) { return i < 2 || i > 3; }},
  };
  for (const Case &one : cases)
    for (bool holds : {true, false}) {
      SCOPED_TRACE((holds ? "" : "not ") + std::string(one.condition));
      std::string body = one.condition;
      body += "\nscf.if %if {\n";
      if (!holds)
        body += "} else {\n";
      body += "tai.print \"{}\"(%i) : index\n}";
      parse(body);
      std::vector<int64_t> expected;
      for (int64_t i = 0; i != 10; ++i)
        if (one.holds(i) == holds)
          expected.push_back(i);
      EXPECT_EQ(pointsOf(), expected);
      EXPECT_TRUE(domainOf().isCertain);
      EXPECT_TRUE(domainOf().isComplete);
    }
}

// Both ends of the type of a sum are assumptions, and a minimum of two sums has
// the assumptions of both.
TEST_F(IterationDomainsTest, AssumptionsNameBothEndsOfTheType) {
  parse(R"(
    %j = arith.index_cast %i : index to i32
    %b = arith.addi %j, %n : i32
    tai.print "{}"(%b) : i32)");
  LinearForm sum = formOf();
  ASSERT_EQ(sum.facts.size(), 2u);
  EXPECT_EQ(sum.facts[0], sum.sum.plus(int64_t(1) << 31));
  EXPECT_EQ(sum.facts[1],
            LinearSum::of((int64_t(1) << 31) - 1).plus(sum.sum, -1));
  for (const char *operands : {"%b, %n", "%n, %b", "%n, %n"}) {
    parse(R"(
      %j = arith.index_cast %i : index to i32
      %b = arith.addi %j, %n : i32
      %least = arith.minsi )" +
          std::string(operands) + R"( : i32
      tai.print "{}"(%least) : i32)");
    bool hasSum = StringRef(operands).contains("%b");
    LinearForm least = formOf();
    EXPECT_EQ(least.isComplete, !hasSum) << operands;
    EXPECT_EQ(least.facts.size(), hasSum ? 4u : 0u) << operands;
  }
}

// A factor that may be large is assumed to be small in magnitude.
TEST_F(IterationDomainsTest, FactorsAreAssumedToBeSmall) {
  parse(R"(
    tai.print "{}"(%n) : i32)");
  LinearSum small =
      forms->makeLaunchForm({kernel.getArgument(0), {}}, {0, 9}).sum;
  SmallVector<LinearSum> facts;
  EXPECT_EQ(forms->multiply(small, LinearSum::of(3), facts),
            LinearSum().plus(small, 3));
  EXPECT_TRUE(facts.empty());
  LinearSum large =
      forms->makeLaunchForm({kernel.getArgument(0), {}}, {0, int64_t(1) << 40})
          .sum;
  int64_t most = int64_t(1) << 31;
  SmallVector<LinearSum> expected{large.plus(most),
                                  LinearSum::of(most).plus(large, -1)};
  EXPECT_EQ(forms->multiply(LinearSum::of(3), large, facts),
            LinearSum().plus(large, 3));
  EXPECT_EQ(facts, expected);
}
