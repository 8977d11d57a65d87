//===- DiagnosticsTest.cpp - Errors of several threads --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Threads that compile in one context each get only their own errors.
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Diagnostics.h"
#include "../Utils/ContextTest.h"
#include "mlir/Parser/Parser.h"
#include "mlir/Pass/PassManager.h"
#include "tai/AD/Passes.h"
#include "tai/Support/SilencedDiagnostics.h"
#include "gtest/gtest.h"
#include <atomic>
#include <optional>
#include <thread>

using namespace mlir;
using namespace mlir::tai;

namespace {
using DiagnosticsTest = ContextTest;

TEST_F(DiagnosticsTest, SilenceDropsWhatItsThreadSays) {
  DiagnosticCollector collector(&context);
  {
    SilencedDiagnostics silence(&context);
    emitError(UnknownLoc::get(&context), "an attempt");
  }
  EXPECT_FALSE(collector.hasErrors());
  emitError(UnknownLoc::get(&context), "the result");
  EXPECT_EQ(collector.take(FailureKind::Internal).message, "the result");
}

TEST_F(DiagnosticsTest, SilenceLeavesOtherThreads) {
  SilencedDiagnostics silence(&context);
  std::string message;
  std::thread other([&] {
    // As in a thread that was working before: diagnostics are silenced first.
    DiagnosticCollector collector(&context);
    std::optional<SilencedDiagnostics> inner;
    std::thread third([&] { inner.emplace(&context); });
    third.join();
    emitError(UnknownLoc::get(&context), "of the other");
    inner.reset();
    message = collector.take(FailureKind::Internal, "lost").message;
  });
  other.join();
  EXPECT_EQ(message, "of the other");
}

TEST_F(DiagnosticsTest, DifferentiatingLosesNoErrorOfAnotherThread) {
  constexpr StringLiteral text = R"(
    !t = !tai.root<dense<[i: 16], {x: f32, gx: f32, y: f32, gy: f32}>>
    tai.tree @t : !t
    tai.field @gx = @t["gx"] : f32, rank 1
    tai.field @gy = @t["gy"] : f32, rank 1
    tai.field @x = @t["x"] : f32, rank 1, adjoint @gx
    tai.field @y = @t["y"] : f32, rank 1, adjoint @gy
    tai.kernel @k() {
      tai.parallel_for (%i) in @x {
        %v = tai.load @x[%i] : f32
        %s = math.exp %v : f32
        tai.store %s, @y[%i] : f32
      }
      tai.return
    })";
  std::atomic<bool> done = false;
  std::atomic<int> emitted = 0, lost = 0;
  std::thread other([&] {
    while (!done) {
      DiagnosticCollector collector(&context);
      emitError(UnknownLoc::get(&context), "of the other");
      lost += !collector.hasErrors();
      ++emitted;
    }
  });
  // Without activity analysis, adjoints of all values are tried first.
  PassManager manager(&context);
  MakeAdjointOptions options;
  options.skip = SkipSet::none();
  manager.addPass(createMakeAdjoint(options));
  bool passed = true;
  for (int round = 0; passed && (round < 50 || emitted < 1000); ++round) {
    OwningOpRef<ModuleOp> module = parseSourceString<ModuleOp>(text, &context);
    passed = module && succeeded(manager.run(*module));
  }
  done = true;
  other.join();
  EXPECT_TRUE(passed);
  EXPECT_EQ(lost, 0) << "of " << emitted;
}
} // namespace
