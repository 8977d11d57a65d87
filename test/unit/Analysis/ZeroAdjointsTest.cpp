//===- ZeroAdjointsTest.cpp - Cells that an adjoint can skip --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/ZeroAdjoints.h"
#include "../Utils/ContextTest.h"
#include "mlir/Parser/Parser.h"
#include "gtest/gtest.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
class ZeroAdjointsTest : public ContextTest {
protected:
  /// The fields whose adjoints must be zero for a loop over cells with this
  /// body to have no effect, as text. The body can use the cell's index %i,
  /// another index %k, the adjoint %g of @y and the value %v of @x in the cell.
  std::string sourcesOf(StringRef body) {
    std::string text = R"(
      tai.tree @t : !tai.root<pointer<[i: 8], {x: f32, x_grad: f32, y: f32, y_grad: f32, p: vector<2xf32>, p_grad: vector<2xf32>}>, {a: f32, a_grad: f32}>
      tai.field @x_grad = @t["x_grad"] : f32, rank 1
      tai.field @y_grad = @t["y_grad"] : f32, rank 1
      tai.field @a_grad = @t["a_grad"] : f32, rank 0
      tai.field @p_grad = @t["p_grad"] : vector<2xf32>, rank 1
      tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
      tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
      tai.field @a = @t["a"] : f32, rank 0, adjoint @a_grad
      tai.field @p = @t["p"] : vector<2xf32>, rank 1, adjoint @p_grad
      tai.kernel @k() {
        tai.return
      }
      tai.kernel @k_grad(%c: i1, %s: f32) {
        %zero = arith.constant 0.0 : f32
        %one = arith.constant 1.0 : f32
        %zeros = arith.constant dense<0.0> : vector<2xf32>
        %c0 = arith.constant 0 : index
        %c1 = arith.constant 1 : index
        %c4 = arith.constant 4 : index
        %local = tai.alloca : !tai.local<f32>
        %stack = tai.stack_create : !tai.stack<f32>
        tai.parallel_for (%i) in @x {
          %k = arith.subi %c4, %i : index
          %g = tai.load @y_grad[%i] : f32
          %v = tai.load @x[%i] : f32
    )" + body.str() + "}\ntai.return\n}";
    module = parseSourceString<ModuleOp>(text, &context);
    if (!module)
      return "no module";
    std::vector<LoopFlags> flags =
        findLoopFlags(module->lookupSymbol<KernelOp>("k"),
                      module->lookupSymbol<KernelOp>("k_grad"));
    if (flags.size() != 1)
      return "no loop";
    sumsUp = flags[0].sumsUp;
    return llvm::join(flags[0].sources, " ");
  }

  OwningOpRef<ModuleOp> module;
  bool sumsUp = false;
};
} // namespace

// Sums of products with the adjoint of the cell vanish with it.
TEST_F(ZeroAdjointsTest, ProductsWithTheAdjointOfTheCell) {
  EXPECT_EQ(sourcesOf(R"(
    %0 = arith.mulf %g, %v : f32
    %1 = arith.mulf %s, %0 : f32
    %2 = arith.addf %0, %1 : f32
    tai.atomic add %2, @x_grad[%i] : f32)"),
            "y_grad");
  EXPECT_FALSE(sumsUp);
  EXPECT_EQ(sourcesOf(R"(
    %0 = arith.divf %g, %v : f32
    %1 = arith.negf %0 : f32
    tai.atomic sub %1, @a_grad[] : f32)"),
            "y_grad");
  EXPECT_TRUE(sumsUp);
  // It is not enough that one summand or the divisor is zero.
  EXPECT_EQ(sourcesOf(R"(
    %0 = arith.addf %g, %v : f32
    tai.atomic add %0, @x_grad[%i] : f32)"),
            "");
  EXPECT_EQ(sourcesOf(R"(
    %0 = arith.divf %v, %g : f32
    tai.atomic add %0, @x_grad[%i] : f32)"),
            "");
  EXPECT_EQ(sourcesOf("tai.atomic add %v, @x_grad[%i] : f32"), "");
  EXPECT_EQ(sourcesOf("tai.atomic max %g, @x_grad[%i] : f32"), "");
}

TEST_F(ZeroAdjointsTest, Constants) {
  EXPECT_EQ(sourcesOf(R"(
    %0 = arith.select %c, %zero, %g : f32
    tai.atomic add %0, @x_grad[%i] : f32)"),
            "y_grad");
  EXPECT_EQ(sourcesOf(R"(
    %0 = arith.select %c, %one, %g : f32
    tai.atomic add %0, @x_grad[%i] : f32)"),
            "");
  EXPECT_EQ(sourcesOf(R"(
    %0 = arith.constant 0.0 : f32
    %1 = arith.addf %0, %g : f32
    tai.atomic add %1, @x_grad[%i] : f32)"),
            "y_grad");
  EXPECT_EQ(sourcesOf(R"(
    %0 = arith.constant 2.0 : f32
    %1 = arith.addf %0, %g : f32
    tai.atomic add %1, @x_grad[%i] : f32)"),
            "");
  EXPECT_EQ(sourcesOf(R"(
    %0 = vector.insert %g, %zeros[1] : f32 into vector<2xf32>
    tai.atomic add %0, @p_grad[%i] : vector<2xf32>)"),
            "y_grad");
}

// A value that a loop carries is zero if its initial and its next value are
// zero.
TEST_F(ZeroAdjointsTest, CarriedValues) {
  auto sum = [&](StringRef begin, StringRef next) {
    return sourcesOf("%r = scf.for %j = %c0 to %c4 step %c1 iter_args(%old = " +
                     begin.str() + R"() -> (f32) {
        %0 = arith.addf %old, %g : f32
        %1 = arith.addf %old, %v : f32
        scf.yield )" +
                     next.str() +
                     R"( : f32
      }
      tai.atomic add %r, @x_grad[%i] : f32)");
  };
  EXPECT_EQ(sum("%zero", "%0"), "y_grad");
  EXPECT_EQ(sum("%g", "%0"), "y_grad");
  EXPECT_EQ(sum("%one", "%0"), "");
  EXPECT_EQ(sum("%one", "%g"), "");
  EXPECT_EQ(sum("%zero", "%1"), "");
}

TEST_F(ZeroAdjointsTest, Branches) {
  auto choice = [&](StringRef yes, StringRef no) {
    return sourcesOf("%r = scf.if %c -> f32 {\nscf.yield " + yes.str() +
                     " : f32\n} else {\nscf.yield " + no.str() +
                     " : f32\n}\ntai.atomic add %r, @x_grad[%i] : f32");
  };
  EXPECT_EQ(choice("%g", "%zero"), "y_grad");
  EXPECT_EQ(choice("%g", "%v"), "");
  EXPECT_EQ(choice("%one", "%g"), "");
}

// A store of zero has no effect if the element was zero, which is known only
// for adjoints of the cell.
TEST_F(ZeroAdjointsTest, Stores) {
  EXPECT_EQ(sourcesOf("tai.store %zero, @y_grad[%i] : f32"), "y_grad");
  EXPECT_EQ(sourcesOf("tai.store %v, @y_grad[%i] : f32"), "");
  EXPECT_EQ(sourcesOf("tai.store %zero, @y_grad[%k] : f32"), "");
  EXPECT_EQ(sourcesOf("tai.store %g, @x_grad[%i] : f32"), "y_grad x_grad");
  EXPECT_EQ(sourcesOf("tai.store %zero, @x_grad[%k] : f32"), "");
  EXPECT_EQ(sourcesOf("tai.store %zero, @x[%i] : f32"), "");
  // An iteration must not change the source of another iteration.
  EXPECT_EQ(sourcesOf("tai.atomic add %g, @y_grad[%k] : f32"), "");
  EXPECT_EQ(sourcesOf("tai.atomic add %g, @x_grad[%k] : f32"), "y_grad");
}

// Updates other than sums, and updates whose results are used, have effects.
TEST_F(ZeroAdjointsTest, Updates) {
  EXPECT_EQ(sourcesOf("tai.atomic mul %g, @x_grad[%i] : f32"), "");
  EXPECT_EQ(sourcesOf("tai.atomic min %g, @a_grad[] : f32"), "");
  EXPECT_TRUE(sumsUp);
  EXPECT_EQ(sourcesOf(R"(
    %old = tai.atomic add %g, @a_grad[] : f32
    tai.print "{}"(%old) : f32)"),
            "");
  EXPECT_EQ(sourcesOf(R"(
    %old = tai.atomic add %g, @a_grad[] : f32
    %0 = arith.mulf %old, %g : f32
    tai.atomic add %0, @x_grad[%i] : f32)"),
            "");
}

// Variables and stacks of an iteration disappear with it; contents of outer
// variables are visible later.
TEST_F(ZeroAdjointsTest, MemoryOfTheIteration) {
  EXPECT_EQ(sourcesOf(R"(
    %own = tai.alloca : !tai.local<f32>
    tai.local_store %v, %own : f32
    %0 = tai.local_load %own : f32
    %1 = arith.mulf %0, %g : f32
    tai.atomic add %1, @x_grad[%i] : f32)"),
            "y_grad");
  EXPECT_EQ(sourcesOf(R"(
    %0 = tai.local_load %local : f32
    %1 = arith.mulf %0, %g : f32
    tai.atomic add %1, @x_grad[%i] : f32)"),
            "y_grad");
  EXPECT_EQ(sourcesOf(R"(
    tai.local_store %v, %local : f32
    tai.atomic add %g, @x_grad[%i] : f32)"),
            "");
  EXPECT_EQ(sourcesOf(R"(
    %own = tai.stack_create : !tai.stack<f32>
    scf.for %j = %c0 to %c4 step %c1 {
      tai.stack_push %v, %own : f32
    }
    %0 = tai.stack_pop %own : f32
    tai.stack_destroy %own : !tai.stack<f32>
    %1 = arith.mulf %0, %g : f32
    tai.atomic add %1, @x_grad[%i] : f32)"),
            "y_grad");
  EXPECT_EQ(sourcesOf(R"(
    tai.stack_push %v, %stack : f32
    tai.atomic add %g, @x_grad[%i] : f32)"),
            "");
}

// Without an adjoint of the cell, no value is zero; nor are indices of loops or
// data.
TEST_F(ZeroAdjointsTest, NothingToSkip) {
  EXPECT_EQ(sourcesOf(R"(
    scf.for %j = %c0 to %c4 step %c1 {
      %0 = arith.index_cast %j : index to i32
      %1 = arith.sitofp %0 : i32 to f32
      tai.atomic add %1, @x_grad[%i] : f32
    })"),
            "");
  EXPECT_EQ(sourcesOf("%0 = tai.load @x_grad[%k] : f32"), "y_grad");
}
