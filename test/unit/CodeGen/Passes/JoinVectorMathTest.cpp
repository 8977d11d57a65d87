//===- JoinVectorMathTest.cpp - Vector functions of twice the lanes -------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "../../Utils/LLVMPassUtils.h"
#include "tai/CodeGen/Passes/VectorMath.h"
#include "llvm/AsmParser/Parser.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/Instructions.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"
#include "llvm/IR/Verifier.h"
#include "llvm/MC/TargetRegistry.h"
#include "llvm/Support/SourceMgr.h"
#include "llvm/Support/TargetSelect.h"
#include "llvm/Target/TargetMachine.h"
#include "gtest/gtest.h"

using namespace llvm;
using namespace mlir::tai;

namespace {
/// The functions that @f calls after the pass, in order.
std::string calls(const std::string &body, const char *cpu = "x86-64-v4") {
  InitializeNativeTarget();
  Triple triple("x86_64-unknown-linux-gnu");
  std::string message;
  const Target *target = TargetRegistry::lookupTarget(triple, message);
  if (!target)
    return message;
  std::unique_ptr<TargetMachine> machine(
      target->createTargetMachine(triple, cpu, "", {}, {}));
  LLVMContext context;
  SMDiagnostic error;
  std::string text =
      "declare <2 x double> @tai_wide_sin_f64_2(<2 x double>)\n"
      "declare <4 x double> @tai_wide_sin_f64_4(<4 x double>)\n"
      "declare <4 x double> @tai_wide_cos_f64_4(<4 x double>)\n"
      "declare <8 x float> @tai_wide_pow_8(<8 x float>, <8 x float>)\n"
      "declare <4 x double> @other(<4 x double>)\n"
      "define void @f(<4 x double> %a, <4 x double> %b, <8 x float> %x, "
      "<8 x float> %y, <2 x double> %s, ptr %p, ptr %q) {\n" +
      body + "  ret void\n}\n";
  std::unique_ptr<Module> module = parseAssemblyString(text, error, context);
  if (!module)
    return error.getMessage().str() + "\n" + text;
  Function &function = *module->getFunction("f");
  VectorMath math(*machine, /*hasSleef=*/true);
  runPass(function, JoinVectorMath(math));
  EXPECT_FALSE(verifyFunction(function, &errs()));
  std::string result;
  for (Instruction &instruction : instructions(function))
    if (auto *call = dyn_cast<CallInst>(&instruction))
      result += (result.empty() ? "" : " ") +
                call->getCalledFunction()->getName().str();
  return result;
}

std::string call(const std::string &result, const std::string &function,
                 const std::string &argument) {
  return "  %" + result + " = call <4 x double> @" + function +
         "(<4 x double> %" + argument + ")\n";
}
std::string store(const std::string &value, const std::string &place) {
  return "  store <4 x double> %" + value + ", ptr %" + place + "\n";
}
const std::string sine = "tai_wide_sin_f64_4";
} // namespace

TEST(JoinVectorMath, TwoCallsBecomeOne) {
  std::string two = call("c", sine, "a") + call("d", sine, "b") +
                    store("c", "p") + store("d", "q");
  EXPECT_EQ(calls(two), "tai_wide_sin_f64_8");
}

TEST(JoinVectorMath, FunctionsOfTwoNumbersAreJoined) {
  std::string pow = " = call <8 x float> @tai_wide_pow_8(<8 x float> ";
  EXPECT_EQ(calls("  %c" + pow + "%x, <8 x float> %y)\n  %d" + pow +
                  "%y, <8 x float> %x)\n  store <8 x float> %c, ptr %p\n"
                  "  store <8 x float> %d, ptr %q\n"),
            "tai_wide_pow_16");
}

TEST(JoinVectorMath, FourCallsBecomeTwo) {
  std::string text;
  for (std::string n : {"1", "2", "3", "4"})
    text += "  %c" + n +
            " = call <2 x double> @tai_wide_sin_f64_2(<2 x double> %s)\n";
  for (std::string n : {"1", "2", "3", "4"})
    text += "  store <2 x double> %c" + n + ", ptr %p\n";
  EXPECT_EQ(calls(text), sine + " " + sine);
}

TEST(JoinVectorMath, CallsOfTwoFunctionsAreJoinedApart) {
  std::string cosine = "tai_wide_cos_f64_4", text;
  text = call("c", sine, "a") + call("d", cosine, "a") + call("e", sine, "b") +
         call("g", cosine, "b");
  for (std::string value : {"c", "d", "e", "g"})
    text += store(value, "p");
  EXPECT_EQ(calls(text), "tai_wide_sin_f64_8 tai_wide_cos_f64_8");
}

TEST(JoinVectorMath, ACallThatNeedsTheOtherStays) {
  EXPECT_EQ(
      calls(call("c", sine, "a") + call("d", sine, "c") + store("d", "p")),
      sine + " " + sine);
}

TEST(JoinVectorMath, ACallWhoseResultIsUsedBeforeTheOtherStays) {
  EXPECT_EQ(calls(call("c", sine, "a") + store("c", "p") +
                  call("d", sine, "b") + store("d", "p")),
            sine + " " + sine);
}

TEST(JoinVectorMath, WithoutALongerFormCallsStay) {
  std::string two = call("c", sine, "a") + call("d", sine, "b") +
                    store("c", "p") + store("d", "q");
  EXPECT_EQ(calls(two, "x86-64-v3"), sine + " " + sine);
  EXPECT_EQ(calls(call("c", "other", "a") + call("d", "other", "b") +
                  store("c", "p") + store("d", "q")),
            "other other");
}
