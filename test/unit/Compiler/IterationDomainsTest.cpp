//===- IterationDomainsTest.cpp - Indices and when blocks run -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/IterationDomains.h"
#include "ContextTest.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Parser/Parser.h"
#include "gtest/gtest.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// A kernel of `%n: i32` with a loop `%i` from 0 to 10 around the body, in
/// which one `tai.print` stands where the test looks.
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

// A number of the launch can be anything: that the sum does not wrap around is
// an assumption.
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

// "a < b or a > b" is two pieces, and nothing in one that contradicts itself.
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

// A statement that depends on data may or may not run.
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
