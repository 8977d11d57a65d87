//===- ManyLoopsTest.cpp - Divided chains of loops do the same ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/ManyLoops.h"
#include "tai/CodeGen/Linker.h"
#include "tai/CodeGen/ObjectCompiler.h"
#include "llvm/Analysis/LoopInfo.h"
#include "llvm/AsmParser/Parser.h"
#include "llvm/IR/Dominators.h"
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
std::string number(int n) { return std::to_string(n); }

/// `count` consecutive loops inside another loop. Each uses values of the
/// previous loop, of a loop far before and of the last iteration, and local
/// memory of the function; after every fifth loop there is a branch.
std::string getBody(int count) {
  std::string text = R"(
  %own = alloca i64
  store i64 5, ptr %own
  br label %outer
outer:
  %i = phi i64 [ 0, %entry ], [ %next, %latch ]
  %sum = phi i64 [ 1, %entry ], [ %s)" +
                     number(count) + R"(, %latch ]
  %at = getelementptr i64, ptr %x, i64 %i
  %s0 = load i64, ptr %at
  %f0 = uitofp i64 %sum to double
  br label %exit0
exit0:
  br label %head1
)";
  for (int k = 1; k <= count; ++k) {
    std::string now = number(k), last = number(k - 1), early = number(k / 3);
    text += "head" + now + ":\n";
    text += "  %j" + now + " = phi i64 [ 0, %exit" + last + " ], [ %jn" + now +
            ", %body" + now + " ]\n";
    text += "  %a" + now + " = phi i64 [ %s" + last + ", %exit" + last +
            " ], [ %an" + now + ", %body" + now + " ]\n";
    text += "  %c" + now + " = icmp slt i64 %j" + now + ", %m\n";
    text += "  br i1 %c" + now + ", label %body" + now + ", label %after" +
            now + "\nbody" + now + ":\n";
    text += "  %o" + now + " = load i64, ptr %own\n";
    text += "  %p" + now + " = mul i64 %a" + now + ", 31\n";
    text += "  %q" + now + " = add i64 %p" + now + ", %o" + now + "\n";
    text += "  %an" + now + " = add i64 %q" + now + ", %s" + early + "\n";
    text += "  store i64 %an" + now + ", ptr %own\n";
    text += "  %jn" + now + " = add i64 %j" + now + ", 1\n";
    text += "  br label %head" + now + "\nafter" + now + ":\n";
    text += "  %f" + now + " = fadd double %f" + last + ", %scale\n";
    text += "  %w" + now + " = icmp slt i64 %a" + now + ", %s" + early + "\n";
    std::string end = "%after" + now;
    if (k % 5 == 0) {
      text += "  br i1 %w" + now + ", label %then" + now + ", label %exit" +
              now + "\nthen" + now + ":\n";
      text += "  %t" + now + " = xor i64 %a" + now + ", %sum\n";
      text += "  br label %exit" + now + "\nexit" + now + ":\n";
      text += "  %s" + now + " = phi i64 [ %a" + now + ", %after" + now +
              " ], [ %t" + now + ", %then" + now + " ]\n";
    } else {
      text += "  br label %exit" + now + "\nexit" + now + ":\n";
      text += "  %s" + now + " = xor i64 %a" + now + ", " + now + "\n";
    }
    text +=
        "  br label %" + (k == count ? "latch" : "head" + number(k + 1)) + "\n";
  }
  std::string last = number(count);
  return text + "latch:\n  %g = fptoui double %f" + last + R"( to i64
  store i64 %g, ptr %at
  %next = add i64 %i, 1
  %on = icmp slt i64 %next, %n
  br i1 %on, label %outer, label %exit
exit:
)";
}

std::string getText(int count) {
  return "define i64 @f(ptr %x, i64 %n, i64 %m, double %scale) {\nentry:\n" +
         getBody(count) + "  %result = add i64 %s" + number(count) +
         ", %a3\n  ret i64 %result\n}\n";
}

std::unique_ptr<Module> parse(const std::string &text, LLVMContext &context) {
  SMDiagnostic error;
  std::unique_ptr<Module> module = parseAssemblyString(text, error, context);
  EXPECT_TRUE(module) << error.getMessage().str();
  return module;
}

size_t countLoops(Function &function) {
  DominatorTree dominators(function);
  return LoopInfo(dominators).getLoopsInPreorder().size();
}

ManyLoopsLimits getLimits(unsigned loops, unsigned part) {
  ManyLoopsLimits limits;
  limits.loops = loops;
  limits.part = part;
  return limits;
}

/// The result and the memory contents of the function for several numbers of
/// iterations, divided or not.
std::vector<int64_t> run(int count, unsigned part) {
  LLVMContext context;
  std::unique_ptr<Module> module = parse(getText(count), context);
  auto objects = ObjectCompiler::create(CodegenOptions());
  (*objects)->setTarget(*module);
  EXPECT_EQ(part != 0 && divideManyLoops(*module, getLimits(10, part)),
            part != 0);
  EXPECT_FALSE(verifyModule(*module, &errs()));
  EXPECT_EQ(module->size() > 1, part != 0);
  auto object = (*objects)->emitObject(*module);
  EXPECT_TRUE(static_cast<bool>(object));
  auto linker = Linker::create({});
  auto linked = (*linker)->link(*object, {"f"});
  EXPECT_TRUE(static_cast<bool>(linked));
  auto *function =
      reinterpret_cast<int64_t (*)(int64_t *, int64_t, int64_t, double)>(
          linked->addresses.front());
  std::vector<int64_t> all;
  for (int64_t n : {1, 3})
    for (int64_t m : {0, 1, 4}) {
      std::vector<int64_t> x;
      for (int64_t i = 0; i <= n; ++i)
        x.push_back(7 * i + 3);
      all.push_back(function(x.data(), n, m, 1.25));
      all.insert(all.end(), x.begin(), x.end());
    }
  return all;
}
} // namespace

TEST(ManyLoops, DividedChainsDoTheSame) {
  std::vector<int64_t> whole = run(40, 0);
  for (unsigned part : {1, 3, 8})
    EXPECT_EQ(run(40, part), whole) << part;
}

TEST(ManyLoops, PartsHaveFewLoops) {
  LLVMContext context;
  std::unique_ptr<Module> module = parse(getText(300), context);
  EXPECT_TRUE(divideManyLoops(*module));
  EXPECT_FALSE(verifyModule(*module, &errs()));
  EXPECT_GE(module->size(), 300 / 16u);
  size_t all = 0;
  for (Function &function : *module) {
    EXPECT_LE(countLoops(function), 3 * 16u);
    all += countLoops(function);
  }
  EXPECT_EQ(all, 301u);
}

TEST(ManyLoops, OtherFunctionsStay) {
  LLVMContext context;
  // 199 loops and the one around them: too few to be divided.
  std::unique_ptr<Module> module = parse(getText(199), context);
  EXPECT_FALSE(divideManyLoops(*module));
  EXPECT_EQ(module->size(), 1u);
  // An iteration may end between the loops: the code after each loop then has
  // more than one predecessor.
  std::string text = getText(60);
  for (int k = 1; k <= 60; ++k) {
    std::string from = "  br label %head" + number(k) + "\nafter";
    text.replace(text.find(from), from.size(),
                 "  %early" + number(k) + " = icmp eq i64 %an" + number(k) +
                     ", 77\n  br i1 %early" + number(k) +
                     ", label %stop, label %head" + number(k) + "\nafter");
  }
  text.replace(text.rfind("}"), 1, "stop:\n  ret i64 0\n}");
  module = parse(text, context);
  EXPECT_FALSE(divideManyLoops(*module, getLimits(10, 4)));
  EXPECT_FALSE(verifyModule(*module, &errs()));
  EXPECT_EQ(module->size(), 1u);
}

/// A kernel may return at a poll, and so may its parts; the kernel then returns
/// as well.
TEST(ManyLoops, PartsLookAsWell) {
  LLVMContext context;
  std::string text =
      "define i32 @f(ptr %frame) {\nentry:\n  %x = load ptr, ptr %frame\n"
      "  %n.at = getelementptr i64, ptr %frame, i64 1\n"
      "  %n = load i64, ptr %n.at\n  %m = load i64, ptr %x\n"
      "  %scale = load double, ptr %x\n" +
      getBody(300) + "  ret i32 0\n}\n";
  std::unique_ptr<Module> module = parse(text, context);
  auto objects = ObjectCompiler::create(CodegenOptions());
  EXPECT_FALSE(errorToBool((*objects)->optimize(*module)));
  unsigned parts = 0;
  for (Function &function : *module) {
    if (!function.hasFnAttribute(kLoopPart))
      continue;
    ++parts;
    bool looks = false;
    for (Instruction &instruction : instructions(function)) {
      auto *call = dyn_cast<CallInst>(&instruction);
      if (!call || !call->getCalledFunction() ||
          call->getCalledFunction()->getName() != "tai_rt_safepoint")
        continue;
      looks = true;
      EXPECT_EQ(call->getArgOperand(0), function.getArg(0));
    }
    EXPECT_TRUE(looks) << function.getName().str();
    ASSERT_TRUE(function.hasOneUse());
    auto *call = dyn_cast<CallInst>(*function.user_begin());
    ASSERT_TRUE(call);
    EXPECT_EQ(call->getArgOperand(0), call->getFunction()->getArg(0));
    EXPECT_FALSE(call->use_empty());
  }
  EXPECT_GE(parts, 300 / 16u);
}
