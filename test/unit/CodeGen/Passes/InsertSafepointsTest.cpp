//===- InsertSafepointsTest.cpp - Loops with safepoints -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/InsertSafepoints.h"
#include "../../Utils/LLVMPassUtils.h"
#include "tai/Runtime/Threads/Safepoint.h"
#include "llvm/AsmParser/Parser.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/Instructions.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"
#include "llvm/IR/Verifier.h"
#include "llvm/Support/SourceMgr.h"
#include "gtest/gtest.h"

using namespace llvm;
using namespace mlir::tai;

namespace {
/// The number of polls that the pass adds, or -1 if the text is invalid. Checks
/// that each poll adds a return from the function.
int countPolls(StringRef signature, StringRef body) {
  LLVMContext context;
  SMDiagnostic error;
  std::string text = "declare double @llvm.sin.f64(double)\n"
                     "declare double @libm(double)\n"
                     "define " +
                     signature.str() + " {\n" + body.str() + "}\n";
  std::unique_ptr<Module> module = parseAssemblyString(text, error, context);
  if (!module) {
    ADD_FAILURE() << error.getMessage().str() << "\n" << text;
    return -1;
  }
  Function &function = *module->getFunction("f");
  runPass(function, InsertSafepoints());
  EXPECT_FALSE(verifyFunction(function, &errs()));
  int polls = 0, returns = 0;
  for (Instruction &instruction : instructions(function)) {
    if (auto *call = dyn_cast<CallInst>(&instruction))
      polls += call->getCalledFunction()->getName() == "tai_rt_safepoint";
    returns += isa<ReturnInst>(instruction);
  }
  EXPECT_EQ(returns, polls + 1);
  return polls;
}

/// A loop that stores up to `to`, with `extra` instructions.
std::string loop(StringRef to, StringRef extra = "") {
  return ("entry:\n"
          "  br label %loop\n"
          "loop:\n"
          "  %i = phi i64 [ 0, %entry ], [ %next, %loop ]\n"
          "  %p = getelementptr double, ptr %frame, i64 %i\n" +
          extra +
          "  store double 1.0, ptr %p\n"
          "  %next = add nuw nsw i64 %i, 1\n"
          "  %more = icmp slt i64 %next, " +
          to +
          "\n"
          "  br i1 %more, label %loop, label %end\n"
          "end:\n")
      .str();
}

constexpr StringLiteral body =
    "void @f(ptr %frame, ptr %closure, i64 %first, i64 %last, i64 %part)";
constexpr StringLiteral kernel = "i32 @f(ptr %frame)";

TEST(InsertSafepoints, PollsWhereTheEndIsNotKnown) {
  EXPECT_EQ(countPolls(body, loop("%last") + "  ret void\n"), 1);
}

/// A kernel that calls the body for `count` iterations.
std::string caller(StringRef count) {
  return "}\n"
         "declare void @tai_rt_parallel_for(ptr, ptr, ptr, i64, i64)\n"
         "define void @kernel(ptr %frame, i64 %n) {\n"
         "  call void @tai_rt_parallel_for(ptr %frame, ptr @f, ptr %frame, "
         "i64 " +
         count.str() +
         ", i64 4)\n"
         "  ret void\n";
}

TEST(InsertSafepoints, KnowsTheIterationsOfParallelLoops) {
  std::string text = loop("%last") + "  ret void\n";
  EXPECT_EQ(countPolls(body, text + caller("61")), 0);
  EXPECT_EQ(countPolls(body, text + caller("1000000")), 1);
  EXPECT_EQ(countPolls(body, text + caller("%n")), 1);
}

TEST(InsertSafepoints, TakesNoOtherLoopForTheParallelOne) {
  // The outer loop is missing, as if all of its iterations had been peeled off.
  std::string text = "entry:\n"
                     "  %n = load i64, ptr %closure\n"
                     "  br label %loop\n" +
                     loop("%n").substr(strlen("entry:\n  br label %loop\n")) +
                     "  ret void\n";
  EXPECT_EQ(countPolls(body, text + caller("1")), 1);
  std::string first = loop("%first") + "  ret void\n";
  EXPECT_EQ(countPolls(body, first + caller("1")), 1);
}

TEST(InsertSafepoints, LeavesShortLoopsAlone) {
  EXPECT_EQ(countPolls(body, loop("1000") + "  ret void\n"), 0);
  EXPECT_EQ(countPolls(kernel, loop("1000") + "  ret i32 0\n"), 0);
}

TEST(InsertSafepoints, PollsInLongOnes) {
  EXPECT_EQ(countPolls(kernel, loop("100000000") + "  ret i32 0\n"), 1);
}

TEST(InsertSafepoints, TakesNoCallForShort) {
  EXPECT_EQ(countPolls(kernel, loop("1000", "  %s = call double @libm(double "
                                            "0.0)\n") +
                                   "  ret i32 0\n"),
            1);
  // An intrinsic counts as one instruction.
  EXPECT_EQ(countPolls(kernel, loop("1000", "  %s = call double "
                                            "@llvm.sin.f64(double 0.0)\n") +
                                   "  ret i32 0\n"),
            0);
}

TEST(InsertSafepoints, PollsInLoopsWithoutEnd) {
  EXPECT_EQ(countPolls(kernel, "entry:\n"
                               "  br label %loop\n"
                               "loop:\n"
                               "  %v = load volatile i64, ptr %frame\n"
                               "  %more = icmp eq i64 %v, 0\n"
                               "  br i1 %more, label %loop, label %end\n"
                               "end:\n"
                               "  ret i32 0\n"),
            1);
}

TEST(InsertSafepoints, PollsInEachLoopOfANestThatMayLast) {
  EXPECT_EQ(countPolls(body, "entry:\n"
                             "  br label %outer\n"
                             "outer:\n"
                             "  %i = phi i64 [ 0, %entry ], [ %j, %latch ]\n"
                             "  br label %inner\n"
                             "inner:\n"
                             "  %k = phi i64 [ 0, %outer ], [ %l, %inner ]\n"
                             "  store i64 %k, ptr %closure\n"
                             "  %l = add nuw nsw i64 %k, 1\n"
                             "  %in = icmp slt i64 %l, 8\n"
                             "  br i1 %in, label %inner, label %latch\n"
                             "latch:\n"
                             "  %j = add nuw nsw i64 %i, 1\n"
                             "  %out = icmp slt i64 %j, %last\n"
                             "  br i1 %out, label %outer, label %exit\n"
                             "exit:\n"
                             "  ret void\n"),
            1);
}

/// Only kernels and bodies of parallel loops may return early.
TEST(InsertSafepoints, LeavesOtherFunctionsAlone) {
  std::string endless = loop("%n") + "  ret void\n";
  EXPECT_EQ(countPolls("void @f(ptr %frame, i64 %n)", endless), 0);
  EXPECT_EQ(countPolls("internal i32 @f(ptr %frame)",
                       loop("100000000") + "  ret i32 0\n"),
            0);
}

int asked = 0;

TEST(Safepoint, AsksTheHostOnceATick) {
  using namespace mlir::tai::runtime;
  asked = 0;
  safepoint::setHandler([] { return ++asked < 3 ? 1 : 0; });
  safepoint::Watch watch;
  EXPECT_TRUE(watch.look());
  safepoint::request();
  EXPECT_TRUE(watch.look());
  EXPECT_GE(asked, 1);
  // The watch checks the clock again after a while, so this loop ends.
  while (asked < 2)
    (void)watch.look();
  asked = 2;
  safepoint::request();
  while (asked < 3)
    safepoint::request(), (void)watch.look();
  EXPECT_FALSE(safepoint::look());
  safepoint::setHandler(nullptr);
  EXPECT_TRUE(safepoint::look());
}
} // namespace
