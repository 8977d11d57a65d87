//===- ExtremeAtomicsTest.cpp - Tests before atomic extremes --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/ExtremeAtomics.h"
#include "llvm/AsmParser/Parser.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/Instructions.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"
#include "llvm/IR/Verifier.h"
#include "llvm/Support/SourceMgr.h"
#include "gtest/gtest.h"

using namespace llvm;

/// The comparisons that guard the atomic operations of the text; "none" for an
/// operation without a guard.
static SmallVector<StringRef> findTests(StringRef text) {
  LLVMContext context;
  SMDiagnostic error;
  std::unique_ptr<Module> module = parseAssemblyString(text, error, context);
  EXPECT_TRUE(module) << error.getMessage().str();
  mlir::tai::testExtremeAtomics(*module);
  EXPECT_FALSE(verifyModule(*module, &errs()));
  SmallVector<StringRef> found;
  for (Function &function : *module)
    for (Instruction &instruction : instructions(function)) {
      if (!isa<AtomicRMWInst>(instruction))
        continue;
      BasicBlock *before = instruction.getParent()->getSinglePredecessor();
      StringRef name = "none";
      if (before)
        for (Instruction &other : *before)
          if (auto *compare = dyn_cast<CmpInst>(&other);
              compare && isa<LoadInst>(compare->getOperand(0)) &&
              cast<LoadInst>(compare->getOperand(0))->isAtomic())
            name = CmpInst::getPredicateName(compare->getPredicate());
      found.push_back(name);
    }
  return found;
}

TEST(ExtremeAtomics, AreBehindATest) {
  EXPECT_EQ(findTests(R"(
define void @all(ptr %p, i32 %i, float %x, half %h) {
  %a = atomicrmw max ptr %p, i32 %i monotonic
  %b = atomicrmw min ptr %p, i32 %i monotonic
  %c = atomicrmw umax ptr %p, i32 %i monotonic
  %d = atomicrmw umin ptr %p, i32 %i monotonic
  %e = atomicrmw fmaximum ptr %p, float %x monotonic
  %f = atomicrmw fminimum ptr %p, half %h monotonic
  ret void
}
)"),
            (SmallVector<StringRef>{"sge", "sle", "uge", "ule", "ogt", "olt"}));
}

/// If nothing is exchanged, the old value is the loaded value.
TEST(ExtremeAtomics, WhoseResultIsUsed) {
  EXPECT_EQ(findTests(R"(
define double @used(ptr %p, double %x) {
  %a = atomicrmw fmaximum ptr %p, double %x monotonic
  %b = fadd double %a, %x
  ret double %b
}
)"),
            SmallVector<StringRef>{"ogt"});
}

/// Sums always change the element, and stronger memory orders than a load's
/// must be kept.
TEST(ExtremeAtomics, OthersStay) {
  EXPECT_EQ(findTests(R"(
define void @others(ptr %p, i32 %i, float %x) {
  %a = atomicrmw add ptr %p, i32 %i monotonic
  %b = atomicrmw fadd ptr %p, float %x monotonic
  %c = atomicrmw max ptr %p, i32 %i seq_cst
  %d = atomicrmw volatile max ptr %p, i32 %i monotonic
  ret void
}
)"),
            (SmallVector<StringRef>{"none", "none", "none", "none"}));
}
