//===- GroupLoadsTest.cpp - Loads that pass stores ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/GroupLoads.h"
#include "../../Utils/LLVMPassUtils.h"
#include "llvm/AsmParser/Parser.h"
#include "llvm/IR/IntrinsicInst.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"
#include "llvm/IR/Verifier.h"
#include "llvm/Support/SourceMgr.h"
#include "gtest/gtest.h"

using namespace llvm;
using namespace mlir::tai;

namespace {
/// The loads (L), stores (S), atomics (A) and calls (C) of a function after the
/// pass, in order.
std::string order(StringRef body, StringRef parameters = "") {
  LLVMContext context;
  SMDiagnostic error;
  std::string text = ("declare void @barrier() convergent memory(readwrite)\n"
                      "declare void @stop() memory(readwrite)\n"
                      "declare float @llvm.sqrt.f32(float)\n"
                      "define void @f(ptr noalias %x, ptr noalias %y, i64 %i" +
                      parameters + ") {\n" + body + "  ret void\n}\n")
                         .str();
  std::unique_ptr<Module> module = parseAssemblyString(text, error, context);
  if (!module)
    return error.getMessage().str();
  Function &function = *module->getFunction("f");
  runPass(function, GroupLoads());
  EXPECT_FALSE(verifyFunction(function, &errs()));
  std::string result;
  for (Instruction &instruction : function.getEntryBlock())
    if (isa<LoadInst>(instruction))
      result += 'L';
    else if (isa<StoreInst>(instruction))
      result += 'S';
    else if (isa<AtomicRMWInst>(instruction))
      result += 'A';
    else if (instruction.getOpcode() == Instruction::FDiv ||
             isa<IntrinsicInst>(instruction))
      result += 'D';
    else if (isa<CallInst>(instruction))
      result += 'C';
  return result;
}

/// Code that adds one to an element of x.
std::string increment(int at) {
  std::string n = std::to_string(at);
  return "  %p" + n + " = getelementptr float, ptr %x, i64 " + n + "\n  %v" +
         n + " = load float, ptr %p" + n + "\n  %s" + n + " = fadd float %v" +
         n + ", 1.0\n  store float %s" + n + ", ptr %p" + n + "\n";
}
} // namespace

TEST(GroupLoads, OtherElementsPass) {
  EXPECT_EQ(order(increment(0) + increment(1) + increment(2)), "LLLSSS");
}

TEST(GroupLoads, TheSameElementDoesNot) {
  std::string again = "  %v = load float, ptr %x\n  store float %v, ptr %y\n";
  EXPECT_EQ(order(increment(0) + again), "LSLS");
}

TEST(GroupLoads, UnknownElementsDoNot) {
  std::string unknown = "  %p = getelementptr float, ptr %x, i64 %i\n"
                        "  %v = load float, ptr %p\n"
                        "  store float %v, ptr %y\n";
  EXPECT_EQ(order(increment(0) + unknown), "LSLS");
}

TEST(GroupLoads, AtomicsOfOtherMemoryPass) {
  std::string atomic =
      "  %o = atomicrmw fadd ptr %y, float 1.0 monotonic\n" + increment(1);
  EXPECT_EQ(order(increment(0) + atomic), "LLSAS");
}

TEST(GroupLoads, BarriersAndCallsThatMayNotReturnStay) {
  EXPECT_EQ(order(increment(0) + "  call void @barrier()\n" + increment(1)),
            "LSCLS");
  EXPECT_EQ(order(increment(0) + "  call void @stop()\n" + increment(1)),
            "LSCLS");
}

TEST(GroupLoads, AddressesThatAreLoadedStay) {
  std::string loaded = "  %j = load i64, ptr %y\n"
                       "  %p = getelementptr float, ptr %x, i64 %j\n"
                       "  %v = load float, ptr %p\n"
                       "  store float %v, ptr %y\n";
  // The first of the two loads joins the group; the second depends on it, and
  // may alias the store.
  EXPECT_EQ(order(increment(0) + loaded), "LLSLS");
}

TEST(GroupLoads, DivisionsAndRootsArePassed) {
  // Letters as above, and D for operations that ptxas expands to branches.
  auto divided = [](StringRef how) {
    return order(("  %a = load float, ptr %x\n" + how +
                  "  %p = getelementptr float, ptr %y, i64 %i\n"
                  "  %b = load float, ptr %p\n"
                  "  %s = fadd float %d, %b\n  store float %s, ptr %x\n")
                     .str());
  };
  EXPECT_EQ(divided("  %d = fdiv float 1.0, %a\n"), "LLDS");
  EXPECT_EQ(divided("  %d = call float @llvm.sqrt.f32(float %a)\n"), "LLDS");
  // An approximate division needs no branch: the loads stay where they are.
  EXPECT_EQ(divided("  %d = fdiv afn float 1.0, %a\n"), "LDLS");
  // An address that depends on the quotient cannot be computed earlier.
  EXPECT_EQ(order("  %a = load float, ptr %x\n  %d = fdiv float 1.0, %a\n"
                  "  %n = fptosi float %d to i64\n"
                  "  %p = getelementptr float, ptr %y, i64 %n\n"
                  "  %b = load float, ptr %p\n  store float %b, ptr %x\n"),
            "LDLS");
}

TEST(GroupLoads, GroupsAreBounded) {
  std::string body, expected;
  for (int i = 0; i < 56; ++i)
    body += increment(i);
  EXPECT_EQ(order(body), std::string(48, 'L') + std::string(48, 'S') +
                             std::string(8, 'L') + std::string(8, 'S'));
}
