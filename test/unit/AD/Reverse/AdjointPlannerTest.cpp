//===- AdjointPlannerTest.cpp - Plans of adjoints -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A plan is data: the tests create a plan and compare it with the demands of an
// adjoint on the primal, without creating the adjoint.
//
//===----------------------------------------------------------------------===//

#include "tai/AD/Reverse/AdjointPlanner.h"
#include "../../Utils/ContextTest.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/IR/Diagnostics.h"
#include "mlir/Parser/Parser.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "gtest/gtest.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
constexpr llvm::StringLiteral kFields = R"(
  !t = !tai.root<dense<[i: 16], {x: f32, gx: f32, y: f32, gy: f32, p: f32}>>
  tai.tree @t : !t
  tai.field @gx = @t["gx"] : f32, rank 1
  tai.field @gy = @t["gy"] : f32, rank 1
  tai.field @x = @t["x"] : f32, rank 1, adjoint @gx
  tai.field @y = @t["y"] : f32, rank 1, adjoint @gy
  tai.field @p = @t["p"] : f32, rank 1
)";

class AdjointPlannerTest : public ContextTest {
protected:
  /// Plans the adjoint of a kernel with the body `body`.
  AdjointPlanner plan(StringRef body, AdjointOptions options = {}) {
    std::string text =
        (kFields + "tai.kernel @k() {\n" + body + "\ntai.return\n}").str();
    module = parseSourceString<ModuleOp>(text, &context);
    kernel = module->lookupSymbol<KernelOp>("k");
    ops.clear();
    kernel->walk<WalkOrder::PreOrder>([&](Operation *op) {
      if (isa<LoadOp, StoreOp, RandomOp>(op))
        ops.push_back(op);
    });
    auto adjointOf = [this](Storage storage) -> Storage {
      FieldOp field =
          storage.field ? lookupField(kernel, storage.field) : FieldOp();
      return field && field.getAdjointAttr() ? Storage(field.getAdjointAttr())
                                             : Storage();
    };
    return AdjointPlanner(kernel, adjointOf, {}, options);
  }

  /// The result of planner.settle(), without its diagnostics.
  FailureOr<bool> settle(AdjointPlanner &planner,
                         const PrimalDemands &demands) {
    ScopedDiagnosticHandler silence(&context,
                                    [](Diagnostic &) { return success(); });
    return planner.settle(demands);
  }

  static std::vector<std::string> getFieldsBefore(const AdjointPlanner &p) {
    std::vector<std::string> names;
    for (Attribute name : p.getFieldsBefore())
      names.push_back(cast<FlatSymbolRefAttr>(name).getValue().str());
    return names;
  }

  OwningOpRef<ModuleOp> module;
  KernelOp kernel;
  /// The loads, stores and draws, in program order.
  SmallVector<Operation *> ops;
};

using Names = std::vector<std::string>;
} // namespace

// Only the adjoint of the second store's element, which was read earlier, must
// be zeroed: the adjoint of the earlier read must not see it.
constexpr llvm::StringLiteral kUpdate = R"(
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @y[%i] : f32
    tai.store %1, @x[%i] : f32
  })";

TEST_F(AdjointPlannerTest, ZeroesWhatWasUsedBefore) {
  AdjointPlanner planner = plan(kUpdate);
  const AdjointZeroing &zeroing = planner.getPlan().zeroing;
  EXPECT_FALSE(zeroing.isZeroedBy(ops[1]));
  EXPECT_TRUE(zeroing.isZeroedBy(ops[2]));
  EXPECT_TRUE(zeroing.isHeldBy(ops[2]->getParentOp()));
  EXPECT_FALSE(zeroing.isHeldBy(kernel));
}

TEST_F(AdjointPlannerTest, ZeroesAllIfAsked) {
  AdjointOptions options;
  options.zeroesAll = true;
  AdjointPlanner planner = plan(kUpdate, options);
  EXPECT_TRUE(planner.getPlan().zeroing.isZeroedBy(ops[1]));
  EXPECT_TRUE(planner.getPlan().zeroing.isZeroedBy(ops[2]));
}

TEST_F(AdjointPlannerTest, AccumulatesIntoAdjointsOfActiveReads) {
  AdjointPlanner planner = plan(kUpdate);
  auto isAccumulated = [&](StringRef name) {
    return planner.getPlan().accumulated.contains(
        FlatSymbolRefAttr::get(&context, name).getAsOpaquePointer());
  };
  EXPECT_TRUE(isAccumulated("gx"));
  EXPECT_FALSE(isAccumulated("gy"));
}

// An overwritten element is read from the version before the kernel; other
// elements have their values after it.
TEST_F(AdjointPlannerTest, ChoosesTheVersionThatHoldsTheValue) {
  AdjointPlanner planner = plan(kUpdate);
  PrimalDemands demands;
  FailureOr<bool> fits = settle(planner, demands);
  ASSERT_TRUE(succeeded(fits));
  EXPECT_TRUE(*fits);
  EXPECT_EQ(getFieldsBefore(planner), Names());
  demands.reads.insert(ops[0]);
  fits = settle(planner, demands);
  ASSERT_TRUE(succeeded(fits));
  EXPECT_TRUE(*fits);
  EXPECT_EQ(getFieldsBefore(planner), Names({"x"}));
  planner.annotate(kernel);
  EXPECT_TRUE(kernel->hasAttr("reads_before"));
  EXPECT_FALSE(kernel->hasAttr("reexecutes"));
}

// One iteration needs two versions: the plan is extended once, and then fits.
TEST_F(AdjointPlannerTest, ExecutesAgainWhatNoVersionHolds) {
  AdjointPlanner planner = plan(R"(
    tai.parallel_for (%i) in @x {
      %0 = tai.load @x[%i] : f32
      %1 = math.sin %0 : f32
      tai.store %1, @x[%i] : f32
      %2 = tai.load @x[%i] : f32
      %3 = math.sin %2 : f32
      tai.store %3, @x[%i] : f32
    })");
  Operation *first = ops[0], *second = ops[2];
  PrimalDemands demands;
  demands.reads.insert(first);
  demands.reads.insert(second);
  FailureOr<bool> fits = settle(planner, demands);
  ASSERT_TRUE(succeeded(fits));
  EXPECT_FALSE(*fits);
  const ReexecutionPlan &again = planner.getPlan().reexecution;
  EXPECT_TRUE(again.isRecorded(first));
  EXPECT_TRUE(again.isRecorded(first->getResult(0)));
  EXPECT_TRUE(again.isRecorded(second));
  EXPECT_FALSE(again.holdsRecorded(first->getParentOp()));
  EXPECT_TRUE(again.isReexecuted(first->getBlock()));
  EXPECT_FALSE(again.isReexecuted(&kernel.getBody().front()));
  EXPECT_TRUE(again.hasRewritten());
  fits = settle(planner, demands);
  ASSERT_TRUE(succeeded(fits));
  EXPECT_TRUE(*fits);
  EXPECT_EQ(getFieldsBefore(planner), Names({"x"}));
  planner.annotate(kernel);
  EXPECT_TRUE(kernel->hasAttr("reexecutes"));
}

// Serial loops that carry a recorded value forward it; their counter is not
// recorded.
TEST_F(AdjointPlannerTest, RecordsDraws) {
  AdjointPlanner planner = plan(R"(
    %c0 = arith.constant 0 : index
    %c1 = arith.constant 1 : index
    %c4 = arith.constant 4 : index
    %f = arith.constant 0.0 : f32
    tai.parallel_for (%i) in @x {
      %s = scf.for %n = %c0 to %c4 step %c1 iter_args(%a = %f) -> (f32) {
        %r = tai.random stream 0 : f32
        %b = arith.addf %a, %r : f32
        scf.yield %b : f32
      }
      tai.store %s, @y[%i] : f32
    })");
  PrimalDemands demands;
  demands.draws.insert(ops[0]);
  FailureOr<bool> fits = settle(planner, demands);
  ASSERT_TRUE(succeeded(fits));
  EXPECT_FALSE(*fits);
  auto loop = cast<scf::ForOp>(ops[0]->getParentOp());
  const ReexecutionPlan &again = planner.getPlan().reexecution;
  EXPECT_TRUE(again.holdsRecorded(loop));
  EXPECT_TRUE(again.isRecorded(Value(loop.getRegionIterArg(0))));
  EXPECT_FALSE(again.isRecorded(Value(loop.getInductionVar())));
  // The plan stores each recorded value only once.
  EXPECT_FALSE(again.hasRewritten());
  fits = settle(planner, demands);
  ASSERT_TRUE(succeeded(fits));
  EXPECT_TRUE(*fits);
}

// Versions between two loops exist only if the loops are separate kernels.
TEST_F(AdjointPlannerTest, AsksForPartsBetweenLoops) {
  AdjointPlanner planner = plan(R"(
    tai.parallel_for (%i) in @x {
      %0 = tai.load @x[%i] : f32
      %1 = math.sin %0 : f32
      tai.store %1, @x[%i] : f32
    }
    tai.parallel_for (%i) in @x {
      %0 = tai.load @x[%i] : f32
      %1 = math.sin %0 : f32
      tai.store %1, @x[%i] : f32
    })");
  PrimalDemands demands;
  demands.reads.insert(ops[0]);
  demands.reads.insert(ops[2]);
  EXPECT_TRUE(failed(settle(planner, demands)));
  EXPECT_TRUE(planner.needsParts());
  // The first loop alone needs one version only.
  demands.reads.remove(ops[2]);
  EXPECT_TRUE(succeeded(settle(planner, demands)));
  EXPECT_FALSE(planner.needsParts());
}

// A stored value is in memory, unless the adjoint runs on the version before
// the kernel. A field cannot have the version before the kernel and the version
// after it at once.
TEST_F(AdjointPlannerTest, AsksForPartsBetweenVersions) {
  AdjointPlanner planner = plan(R"(
    tai.parallel_for (%i) in @x {
      %0 = tai.load @y[%i] : f32
      %1 = tai.load @x[%i] : f32
      tai.store %1, @y[%i] : f32
      %2 = tai.load @y[%i] : f32
    })");
  PrimalDemands demands;
  demands.reads.insert(ops[0]);
  demands.reads.insert(ops[3]);
  demands.before.insert(ops[0]);
  EXPECT_TRUE(failed(settle(planner, demands)));
  EXPECT_TRUE(planner.needsParts());
  demands.reads.remove(ops[3]);
  EXPECT_TRUE(succeeded(settle(planner, demands)));
  EXPECT_FALSE(planner.needsParts());
}

TEST_F(AdjointPlannerTest, FindsWhatWasStored) {
  AdjointPlanner planner = plan(kUpdate);
  PrimalDemands demands;
  ASSERT_TRUE(succeeded(settle(planner, demands)));
  EXPECT_FALSE(planner.findsStored({}));
  EXPECT_TRUE(planner.findsStored(ops[1]));
  EXPECT_TRUE(planner.findsStored(ops[2]));
  demands.before.insert(ops[0]);
  ASSERT_TRUE(succeeded(settle(planner, demands)));
  EXPECT_TRUE(planner.findsStored(ops[1]));
  EXPECT_FALSE(planner.findsStored(ops[2]));
}

TEST_F(AdjointPlannerTest, RefusesDerivativesThatAreLost) {
  AdjointPlanner good = plan(kUpdate);
  EXPECT_TRUE(succeeded(verifyReversible(good.getPlan())));
  AdjointPlanner bad = plan(R"(
    %a = memref.alloca() : memref<f32>
    tai.parallel_for (%i) in @x {
      %0 = tai.load @x[%i] : f32
      memref.store %0, %a[] : memref<f32>
    })");
  std::string error;
  ScopedDiagnosticHandler handler(&context, [&](Diagnostic &diagnostic) {
    error += diagnostic.str();
    return success();
  });
  EXPECT_TRUE(failed(verifyReversible(bad.getPlan())));
  EXPECT_NE(error.find("array that the function makes for itself"),
            std::string::npos);
}
