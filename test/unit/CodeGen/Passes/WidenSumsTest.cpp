//===- WidenSumsTest.cpp - Sums that are kept in f64 ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/WidenSums.h"
#include "../../Utils/LLVMPassUtils.h"
#include "llvm/AsmParser/Parser.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/IntrinsicInst.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"
#include "llvm/IR/Verifier.h"
#include "llvm/Support/SourceMgr.h"
#include "gtest/gtest.h"

using namespace llvm;
using namespace mlir::tai;

namespace {
/// Counts in a function after the pass: phis of f32 and of f64, additions of
/// f32 and of f64, and roundings to f32.
struct Counts {
  int phis32 = 0, phis64 = 0, sums32 = 0, sums64 = 0, roundings = 0;
  std::string text;
};

Counts widen(const std::string &function) {
  LLVMContext context;
  SMDiagnostic error;
  std::string text =
      "declare float @llvm.vector.reduce.fadd.v8f32(float, <8 x float>)\n"
      "declare void @see(<8 x float>)\n" +
      function;
  std::unique_ptr<Module> module = parseAssemblyString(text, error, context);
  Counts counts;
  if (!module) {
    ADD_FAILURE() << error.getMessage().str() << "\n" << text;
    return counts;
  }
  Function &made = *module->getFunction("f");
  runPass(made, WidenSums());
  EXPECT_FALSE(verifyFunction(made, &errs()));
  raw_string_ostream(counts.text) << made;
  for (Instruction &instruction : instructions(made)) {
    bool wide = instruction.getType()->getScalarType()->isDoubleTy();
    if (!wide && !instruction.getType()->getScalarType()->isFloatTy())
      continue;
    if (isa<PHINode>(instruction))
      ++(wide ? counts.phis64 : counts.phis32);
    if (instruction.getOpcode() == Instruction::FAdd)
      ++(wide ? counts.sums64 : counts.sums32);
    counts.roundings += isa<FPTruncInst>(instruction);
  }
  return counts;
}

/// A loop with two vectors of partial sums, and code that adds them up after
/// it.
std::string lanes(const std::string &flags, const std::string &in = "",
                  const std::string &behind = "") {
  return "define double @f(ptr %x, i64 %n, double %before) \"tai.free_sums\" "
         "{\n"
         "entry:\n  br label %loop\n"
         "loop:\n"
         "  %i = phi i64 [ 0, %entry ], [ %j, %loop ]\n"
         "  %a = phi <8 x float> [ splat (float -0.0), %entry ], "
         "[ %c, %loop ]\n"
         "  %b = phi <8 x float> [ splat (float -0.0), %entry ], "
         "[ %d, %loop ]\n"
         "  %p = getelementptr float, ptr %x, i64 %i\n"
         "  %q = getelementptr float, ptr %p, i64 8\n"
         "  %u = load <8 x float>, ptr %p\n"
         "  %v = load <8 x float>, ptr %q\n"
         "  %c = fadd " +
         flags + " <8 x float> %a, %u\n  %d = fadd " + flags +
         " <8 x float> %v, %b\n" + in +
         "  %j = add i64 %i, 16\n"
         "  %more = icmp slt i64 %j, %n\n"
         "  br i1 %more, label %loop, label %exit\n"
         "exit:\n" +
         behind + "  %e = fadd " + flags +
         " <8 x float> %c, %d\n"
         "  %r = call reassoc float @llvm.vector.reduce.fadd.v8f32("
         "float 0.0, <8 x float> %e)\n"
         "  %w = fpext float %r to double\n"
         "  %s = fadd double %before, %w\n"
         "  ret double %s\n}\n";
}

/// A loop with a scalar sum.
std::string scalar(const std::string &sum, const std::string &in = "") {
  return "define float @f(ptr %x, i64 %n) \"tai.free_sums\" {\n"
         "entry:\n  br label %loop\n"
         "loop:\n"
         "  %i = phi i64 [ 0, %entry ], [ %j, %loop ]\n"
         "  %a = phi float [ 0.0, %entry ], [ %b, %loop ]\n"
         "  %p = getelementptr float, ptr %x, i64 %i\n"
         "  %u = load float, ptr %p\n"
         "  %b = " +
         sum + "\n" + in +
         "  %j = add i64 %i, 1\n"
         "  %more = icmp slt i64 %j, %n\n"
         "  br i1 %more, label %loop, label %exit\n"
         "exit:\n  ret float %b\n}\n";
}

TEST(WidenSumsTest, LanesAreOneVectorOfF64) {
  Counts counts = widen(lanes("reassoc"));
  EXPECT_EQ(counts.phis32, 0) << counts.text;
  EXPECT_EQ(counts.phis64, 1) << counts.text;
  // The two terms of an iteration are added in f32.
  EXPECT_EQ(counts.sums32, 1) << counts.text;
  // The sum is used in f64, so that it is not rounded.
  EXPECT_EQ(counts.roundings, 0) << counts.text;
}

TEST(WidenSumsTest, OrderThatIsFixedStays) {
  Counts counts = widen(lanes("nsz"));
  EXPECT_EQ(counts.phis32, 2) << counts.text;
  EXPECT_EQ(counts.phis64, 0) << counts.text;
}

TEST(WidenSumsTest, SumsThatThePlanDoesNotKnowStay) {
  std::string program = lanes("reassoc");
  const std::string mark = " \"tai.free_sums\"";
  program.erase(program.find(mark), mark.size());
  Counts counts = widen(program);
  EXPECT_EQ(counts.phis32, 2) << counts.text;
  EXPECT_EQ(counts.phis64, 0) << counts.text;
}

TEST(WidenSumsTest, LanesThatAreSeenStay) {
  EXPECT_EQ(
      widen(lanes("reassoc", "  call void @see(<8 x float> %c)\n")).phis32, 2);
  EXPECT_EQ(
      widen(lanes("reassoc", "", "  call void @see(<8 x float> %c)\n")).phis32,
      2);
}

TEST(WidenSumsTest, SingleNumbersAreAddedInF64) {
  Counts counts = widen(scalar("fadd reassoc float %a, %u"));
  EXPECT_EQ(counts.phis32, 0) << counts.text;
  EXPECT_EQ(counts.phis64, 1) << counts.text;
  EXPECT_EQ(counts.sums64, 1) << counts.text;
  EXPECT_EQ(counts.roundings, 1) << counts.text;
}

/// A loop that forms `count` sums of f32.
std::string sums(int count) {
  std::string phis, adds;
  for (int k = 0; k < count; ++k) {
    std::string n = std::to_string(k);
    phis +=
        "  %a" + n + " = phi float [ 0.0, %entry ], [ %b" + n + ", %loop ]\n";
    adds += "  %b" + n + " = fadd reassoc float %a" + n + ", %u\n";
  }
  return "define float @f(ptr %x, i64 %n) \"tai.free_sums\" {\n"
         "entry:\n  br label %loop\n"
         "loop:\n"
         "  %i = phi i64 [ 0, %entry ], [ %j, %loop ]\n" +
         phis +
         "  %p = getelementptr float, ptr %x, i64 %i\n"
         "  %u = load float, ptr %p\n" +
         adds +
         "  %j = add i64 %i, 1\n"
         "  %more = icmp slt i64 %j, %n\n"
         "  br i1 %more, label %loop, label %exit\n"
         "exit:\n  ret float %b0\n}\n";
}

/// For more sums in f64 there would be no registers.
TEST(WidenSumsTest, ManySumsAtOnceStay) {
  EXPECT_EQ(widen(sums(8)).phis64, 1);
  EXPECT_EQ(widen(sums(9)).phis64, 0);
}

TEST(WidenSumsTest, DifferencesToo) {
  Counts counts = widen(scalar("fsub reassoc float %a, %u"));
  EXPECT_EQ(counts.phis64, 1) << counts.text;
  EXPECT_NE(counts.text.find("fneg"), std::string::npos) << counts.text;
  // This also changes the sign of the sum.
  EXPECT_EQ(widen(scalar("fsub reassoc float %u, %a")).phis64, 0);
}

TEST(WidenSumsTest, SumsOfFastProgramsAndUsedOnesStay) {
  EXPECT_EQ(widen(scalar("fadd reassoc afn float %a, %u")).phis64, 0);
  EXPECT_EQ(widen(scalar("fadd float %a, %u")).phis64, 0);
  EXPECT_EQ(
      widen(scalar("fadd reassoc float %a, %u", "  store float %b, ptr %p\n"))
          .phis64,
      0);
}
} // namespace
