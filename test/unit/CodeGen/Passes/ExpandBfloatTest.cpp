//===- ExpandBfloatTest.cpp - Rounding to bf16 by integers ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/ExpandBfloat.h"
#include "llvm/AsmParser/Parser.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/Instructions.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"
#include "llvm/IR/Verifier.h"
#include "llvm/Support/SourceMgr.h"
#include "gtest/gtest.h"

using namespace llvm;

/// The number of operations that round to bf16, before and after the pass.
static std::pair<int, int> countRoundings(StringRef text) {
  LLVMContext context;
  SMDiagnostic error;
  std::unique_ptr<Module> module = parseAssemblyString(text, error, context);
  EXPECT_TRUE(module) << error.getMessage().str();
  auto count = [&] {
    int found = 0;
    for (Function &function : *module)
      for (Instruction &instruction : instructions(function))
        found += instruction.getType()->getScalarType()->isBFloatTy() &&
                 (isa<FPTruncInst, CallInst>(instruction) ||
                  isa<BinaryOperator>(instruction));
    return found;
  };
  int before = count();
  mlir::tai::expandBfloat(*module);
  EXPECT_FALSE(verifyModule(*module, &errs()));
  return {before, count()};
}

TEST(ExpandBfloat, ScalarsAndVectors) {
  auto [before, after] = countRoundings(R"(
declare bfloat @llvm.fma.bf16(bfloat, bfloat, bfloat)
declare <8 x bfloat> @llvm.sqrt.v8bf16(<8 x bfloat>)
define bfloat @scalars(float %x, bfloat %y) {
  %a = fptrunc float %x to bfloat
  %b = fadd bfloat %a, %y
  %c = fdiv bfloat %b, %y
  %d = call bfloat @llvm.fma.bf16(bfloat %a, bfloat %b, bfloat %c)
  ret bfloat %d
}
define <8 x bfloat> @vectors(<8 x float> %x) {
  %a = fptrunc <8 x float> %x to <8 x bfloat>
  %b = fmul <8 x bfloat> %a, %a
  %c = call <8 x bfloat> @llvm.sqrt.v8bf16(<8 x bfloat> %b)
  ret <8 x bfloat> %c
}
)");
  EXPECT_EQ(before, 7);
  EXPECT_EQ(after, 0);
}

/// Extrema and functions that return whole numbers round as well: a minimum of
/// denormals was flushed to zero.
TEST(ExpandBfloat, ExtremaAndWholeNumbers) {
  auto [before, after] = countRoundings(R"(
declare bfloat @llvm.minnum.bf16(bfloat, bfloat)
declare bfloat @llvm.maximum.bf16(bfloat, bfloat)
declare <4 x bfloat> @llvm.ceil.v4bf16(<4 x bfloat>)
declare <4 x bfloat> @llvm.roundeven.v4bf16(<4 x bfloat>)
define bfloat @extrema(bfloat %x, bfloat %y) {
  %a = call bfloat @llvm.minnum.bf16(bfloat %x, bfloat %y)
  %b = call bfloat @llvm.maximum.bf16(bfloat %a, bfloat %y)
  ret bfloat %b
}
define <4 x bfloat> @whole(<4 x bfloat> %x) {
  %a = call <4 x bfloat> @llvm.ceil.v4bf16(<4 x bfloat> %x)
  %b = call <4 x bfloat> @llvm.roundeven.v4bf16(<4 x bfloat> %a)
  ret <4 x bfloat> %b
}
)");
  EXPECT_EQ(before, 4);
  EXPECT_EQ(after, 0);
}

/// Functions that copy bits round nothing.
TEST(ExpandBfloat, SignsStay) {
  auto [before, after] = countRoundings(R"(
declare bfloat @llvm.fabs.bf16(bfloat)
declare bfloat @llvm.copysign.bf16(bfloat, bfloat)
define bfloat @signs(bfloat %x, bfloat %y) {
  %a = call bfloat @llvm.fabs.bf16(bfloat %x)
  %b = call bfloat @llvm.copysign.bf16(bfloat %a, bfloat %y)
  ret bfloat %b
}
)");
  EXPECT_EQ(before, 2);
  EXPECT_EQ(after, 2);
}

/// A function of the runtime rounds f64; other types are not changed.
TEST(ExpandBfloat, OthersStay) {
  auto [before, after] = countRoundings(R"(
define half @halves(float %x, half %y) {
  %a = fptrunc float %x to half
  %b = fadd half %a, %y
  ret half %b
}
define bfloat @doubles(double %x) {
  %a = fptrunc double %x to bfloat
  ret bfloat %a
}
)");
  EXPECT_EQ(before, 1);
  EXPECT_EQ(after, 1);
}
