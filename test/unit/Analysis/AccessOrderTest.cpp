//===- AccessOrderTest.cpp - Accesses in loops and branches ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Structures that the random kernels of IterationsTest.cpp lack: adjacent
// loops, switches, blocks, nested loops, and updates of arrays.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/AccessOrder.h"
#include "../Utils/ContextTest.h"
#include "mlir/Parser/Parser.h"
#include "tai/Analysis/IterationOrder.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "gtest/gtest.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
class AccessOrderTest : public ContextTest {
protected:
  /// The accesses to `@x` in a function with this body.
  Accesses parse(StringRef body) {
    std::string text = R"(
      tai.tree @t : !tai.root<dense<[i: 16], {x: f32}>, dense<[i: 16], {p: i32}>>
      tai.field @x = @t["x"] : f32, rank 1
      tai.field @p = @t["p"] : i32, rank 1
      func.func @f(%c: i1, %n: index, %m: index, %k: i32, %s: f32) {
        %c0 = arith.constant 0 : index
        %c1 = arith.constant 1 : index
        %c2 = arith.constant 2 : index
        %c8 = arith.constant 8 : index
    )" + body.str() + "\nreturn\n}";
    module = parseSourceString<ModuleOp>(text, &context);
    Accesses accesses;
    if (module)
      module->walk([&](DifferentiableAccessInterface access) {
        accesses.push_back(access);
      });
    return accesses;
  }

  OwningOpRef<ModuleOp> module;
};
} // namespace

// Adjacent loops correspond if they have the same range.
TEST_F(AccessOrderTest, LoopsBesideEachOther) {
  auto reach = [&](StringRef first, StringRef second, StringRef at = "%i") {
    Accesses accesses =
        parse(first.str() + "tai.store %s, @x[%i] : f32\n}\n" + second.str() +
              "%v = tai.load @x[" + at.str() + "] : f32\n}");
    EXPECT_EQ(accesses.size(), 2u);
    if (accesses.size() != 2)
      return false;
    EXPECT_TRUE(mayReachLater(accesses[0], accesses[1]));
    EXPECT_FALSE(mayReachLater(accesses[1], accesses[0]));
    return runsAfter(accesses[0], accesses[1]) &&
           reachSameElement(accesses[0], accesses[1]);
  };
  const char *range = "scf.for %i = %c0 to %n step %c1 {\n";
  const char *longer = "scf.for %i = %c0 to %m step %c1 {\n";
  const char *later = "scf.for %i = %c1 to %n step %c1 {\n";
  const char *even = "scf.for %i = %c0 to %n step %c2 {\n";
  const char *parallel = "tai.parallel_for (%i) = (%c0) to (%n) {\n";
  const char *other = "tai.parallel_for (%i) = (%c0) to (%m) {\n";
  const char *moved = "tai.parallel_for (%i) = (%c1) to (%n) {\n";
  const char *ofField = "tai.parallel_for (%i) in @x {\n";
  const char *ofOther = "tai.parallel_for (%i) in @p {\n";
  EXPECT_TRUE(reach(range, range));
  EXPECT_FALSE(reach(range, longer));
  EXPECT_FALSE(reach(range, later));
  EXPECT_FALSE(reach(range, even));
  EXPECT_FALSE(reach(range, parallel));
  EXPECT_TRUE(reach(parallel, parallel));
  EXPECT_FALSE(reach(parallel, other));
  EXPECT_FALSE(reach(parallel, moved));
  EXPECT_TRUE(reach(ofField, ofField));
  EXPECT_FALSE(reach(ofField, ofOther));
  EXPECT_FALSE(reach(ofField, parallel));
  EXPECT_FALSE(reach(range, range, "%c1"));
  // A loop whose range is not known to be the same, around which another loop
  // corresponds.
  const char *whileLoop =
      "scf.while (%i = %c0) : (index) -> index {\nscf.condition(%c) %i : "
      "index\n} do {\n^bb0(%j: index):\nscf.yield %j : index\n}\n"
      "scf.for %i = %c0 to %n step %c1 {\n";
  EXPECT_TRUE(reach(range, whileLoop));
}

// Only one of two arms runs; both of two blocks in a region may run.
TEST_F(AccessOrderTest, Arms) {
  Accesses arms = parse(R"(
    scf.index_switch %n
    case 1 {
      tai.store %s, @x[%c0] : f32
      scf.yield
    }
    default {
      %v = tai.load @x[%c0] : f32
      scf.yield
    })");
  ASSERT_EQ(arms.size(), 2u);
  EXPECT_FALSE(runsAfter(arms[0], arms[1]));
  EXPECT_TRUE(mayReachLater(arms[0], arms[1]));
  Accesses branches = parse(R"(
    scf.if %c {
      tai.store %s, @x[%c0] : f32
    } else {
      %v = tai.load @x[%c0] : f32
    })");
  ASSERT_EQ(branches.size(), 2u);
  EXPECT_FALSE(mayReachLater(branches[0], branches[1]));
  EXPECT_FALSE(mayReachLater(branches[0], branches[0]));
  Accesses blocks = parse(R"(
    scf.execute_region {
      cf.cond_br %c, ^a, ^b
    ^a:
      tai.store %s, @x[%c0] : f32
      cf.br ^b
    ^b:
      %v = tai.load @x[%c0] : f32
      scf.yield
    })");
  ASSERT_EQ(blocks.size(), 2u);
  EXPECT_FALSE(runsAfter(blocks[0], blocks[1]));
  EXPECT_TRUE(mayReachLater(blocks[0], blocks[1]));
}

// The order of the blocks of a function is unknown.
TEST_F(AccessOrderTest, BlocksOfAFunction) {
  Accesses accesses = parse(R"(
    tai.store %s, @x[%c0] : f32
    cf.cond_br %c, ^a, ^b
  ^a:
    tai.store %s, @x[%c0] : f32
    cf.br ^b
  ^b:
    %v = tai.load @x[%c0] : f32)");
  ASSERT_EQ(accesses.size(), 3u);
  for (DifferentiableAccessInterface a : accesses)
    for (DifferentiableAccessInterface b : accesses) {
      EXPECT_EQ(runsAfter(a, b), false);
      EXPECT_EQ(reachSameElement(a, b), a == b);
      EXPECT_EQ(mayReachLater(a, b), a != b);
    }
}

// A counter is followed through a few loops around it; with more loops, it may
// have any value.
TEST_F(AccessOrderTest, CountersOfLoopsInLoops) {
  for (int depth : {1, 3, 6}) {
    std::string body, ends, at = "%c0";
    for (int d = 0; d != depth; ++d) {
      std::string number = std::to_string(d);
      body += "scf.while (%i" + number + " = " + at +
              ") : (index) -> index {\n%more" + number +
              " = arith.cmpi slt, %i" + number + ", %c8 : index\n" +
              "scf.condition(%more" + number + ") %i" + number +
              " : index\n} do {\n^bb0(%j" + number + ": index):\n";
      at = "%j" + number;
      ends = "%next" + number + " = arith.addi %j" + number +
             ", %c1 : index\nscf.yield %next" + number + " : index\n}\n" + ends;
    }
    body += "%old = tai.load @x[" + at + "] : f32\n%next = arith.addi " + at +
            ", %c1 : index\ntai.store %old, @x[%next] : f32\n" + ends;
    Accesses accesses = parse(body);
    ASSERT_EQ(accesses.size(), 2u);
    // The next iteration reads elements that this iteration stores.
    EXPECT_TRUE(mayReachLater(accesses[1], accesses[0])) << depth;
    if (depth == 1)
      EXPECT_FALSE(mayReachLater(accesses[0], accesses[1]));
  }
}

TEST_F(AccessOrderTest, UpdatesThatCommute) {
  auto depends = [&](StringRef body) {
    std::string text = "%shared = memref.alloc() : memref<16xf32>\n"
                       "%count = memref.alloc() : memref<16xi32>\n"
                       "%local = tai.alloca : !tai.local<f32>\n"
                       "tai.parallel_for (%i) = (%c0) to (%c8) {\n";
    parse(text + body.str() + "\n}");
    bool result = false;
    EXPECT_TRUE(module) << body.str();
    if (module)
      module->walk([&](ParallelForOp loop) { result = dependsOnOrder(loop); });
    return result;
  };
  auto update = [&](StringRef kind, StringRef value, StringRef array,
                    StringRef type) {
    return "%" + kind.str() + " = memref.atomic_rmw " + kind.str() + " " +
           value.str() + ", " + array.str() + "[%c0] : (" + type.str() +
           ", memref<16x" + type.str() + ">) -> " + type.str() + "\n";
  };
  for (StringRef kind :
       {"addf", "mulf", "maximumf", "maxnumf", "minimumf", "minnumf"})
    EXPECT_FALSE(depends(update(kind, "%s", "%shared", "f32"))) << kind.str();
  for (StringRef kind : {"addi", "muli", "maxs", "mins"})
    EXPECT_FALSE(depends(update(kind, "%k", "%count", "i32"))) << kind.str();
  EXPECT_TRUE(depends(update("assign", "%s", "%shared", "f32")));
  EXPECT_TRUE(depends(update("addf", "%s", "%shared", "f32") +
                      update("mulf", "%s", "%shared", "f32")));
  EXPECT_FALSE(depends(update("maximumf", "%s", "%shared", "f32") +
                       update("maxnumf", "%s", "%shared", "f32")));
  // If results of updates are used, their order matters.
  EXPECT_TRUE(depends("%old = tai.atomic add %s, @x[%c0] : f32\n"
                      "tai.print \"{}\"(%old) : f32"));
  EXPECT_TRUE(depends("tai.atomic add %s, @x[%c0] : f32\n"
                      "%old = tai.atomic add %s, @x[%c0] : f32\n"
                      "tai.print \"{}\"(%old) : f32"));
  EXPECT_FALSE(depends("tai.atomic add %s, @x[%c0] : f32\n"
                       "tai.atomic sub %s, @x[%c0] : f32"));
  // Variables of an iteration, and variables outside the loop.
  EXPECT_FALSE(depends("%own = tai.alloca : !tai.local<f32>\n"
                       "tai.local_store %s, %own : f32\n"
                       "%v = tai.local_load %own : f32\n"
                       "tai.store %v, @x[%i] : f32"));
  EXPECT_TRUE(depends("%v = tai.local_load %local : f32\n"
                      "%w = arith.addf %v, %s : f32\n"
                      "tai.local_store %w, %local : f32"));
  // Iterations that store different values to an element, or the same value.
  EXPECT_TRUE(depends("%v = arith.index_cast %i : index to i32\n"
                      "%w = arith.sitofp %v : i32 to f32\n"
                      "tai.store %w, @x[%c0] : f32"));
  EXPECT_FALSE(depends("tai.store %s, @x[%c0] : f32"));
  // An unknown op may have any effect.
  EXPECT_TRUE(depends("func.call @f(%c, %i, %i, %k, %s) : (i1, index, index, "
                      "i32, f32) -> ()"));
}
