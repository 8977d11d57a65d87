//===- HugeBodiesTest.cpp - Divided blocks do the same --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/HugeBodies.h"
#include "../../Utils/LLVMPassUtils.h"
#include "tai/CodeGen/Linker.h"
#include "tai/CodeGen/ObjectCompiler.h"
#include "llvm/Analysis/LoopInfo.h"
#include "llvm/AsmParser/Parser.h"
#include "llvm/IR/Dominators.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"
#include "llvm/IR/Verifier.h"
#include "llvm/MC/TargetRegistry.h"
#include "llvm/Support/SourceMgr.h"
#include "llvm/Target/TargetMachine.h"
#include "llvm/TargetParser/Triple.h"
#include "gtest/gtest.h"

using namespace llvm;
using namespace mlir::tai;

namespace {
std::string number(int n) { return std::to_string(n); }

/// A loop whose body is a chain of `steps` steps. Values of several types are
/// used nearby, far away, in the next iteration and after the loop; local
/// memory of the function is used in between.
std::string getLoopText(int steps) {
  std::string text = R"(
define i64 @f(ptr %x, i64 %n, double %scale) {
entry:
  %own = alloca i64
  store i64 5, ptr %own
  br label %loop
loop:
  %i = phi i64 [ 0, %entry ], [ %next, %loop ]
  %sum = phi i64 [ 1, %entry ], [ %c)" +
                     number(steps) + R"(, %loop ]
  %at = getelementptr i64, ptr %x, i64 %i
  %a0 = load i64, ptr %at
  %f0 = uitofp i64 %a0 to double
  %b0 = trunc i64 %sum to i8
  %c0 = add i64 %sum, %a0
)";
  for (int k = 1; k <= steps; ++k) {
    std::string now = number(k), last = number(k - 1), early = number(k / 3);
    text += "  %m" + now + " = mul i64 %c" + last + ", 31\n";
    text += "  %o" + now + " = load i64, ptr %own\n";
    text += "  %s" + now + " = add i64 %m" + now + ", %o" + now + "\n";
    text += "  store i64 %s" + now + ", ptr %own\n";
    text += "  %f" + now + " = fadd double %f" + last + ", %scale\n";
    text +=
        "  %b" + now + " = xor i8 %b" + last + ", " + number(k % 100) + "\n";
    text += "  %l" + now + " = icmp slt i8 %b" + now + ", %b" + early + "\n";
    text += "  %c" + now + " = select i1 %l" + now + ", i64 %s" + now +
            ", i64 %c" + early + "\n";
  }
  std::string last = number(steps);
  return text + "  %g = fptoui double %f" + last + R"( to i64
  store i64 %g, ptr %at
  %next = add i64 %i, 1
  %on = icmp slt i64 %next, %n
  br i1 %on, label %loop, label %exit
exit:
  %wide = sext i8 %b)" +
         last + R"( to i64
  %result = add i64 %c)" +
         last + R"(, %wide
  ret i64 %result
}
)";
}

std::unique_ptr<Module> parse(const std::string &text, LLVMContext &context) {
  SMDiagnostic error;
  std::unique_ptr<Module> module = parseAssemblyString(text, error, context);
  EXPECT_TRUE(module) << error.getMessage().str();
  return module;
}

size_t getLargestBlock(const Module &module) {
  size_t largest = 0;
  for (const Function &function : module)
    for (const BasicBlock &block : function)
      largest = std::max(largest, block.size());
  return largest;
}

HugeBodyLimits getLimits(unsigned block, unsigned part,
                         uint64_t pairs = UINT64_MAX) {
  HugeBodyLimits limits;
  limits.block = block;
  limits.part = part;
  limits.pairs = pairs;
  return limits;
}

/// The result and the memory contents of the function, divided or not.
std::vector<int64_t> run(int steps, unsigned part, int64_t n) {
  LLVMContext context;
  std::unique_ptr<Module> module = parse(getLoopText(steps), context);
  if (part > 0)
    divideHugeBlocks(*module, nullptr, getLimits(part, part));
  EXPECT_FALSE(verifyModule(*module, &errs()));
  EXPECT_EQ(module->size() > 1, part > 0);
  auto objects = ObjectCompiler::create(CodegenOptions());
  (*objects)->setTarget(*module);
  auto object = (*objects)->emitObject(*module);
  EXPECT_TRUE(static_cast<bool>(object));
  auto linker = Linker::create({});
  auto linked = (*linker)->link(*object, {"f"});
  EXPECT_TRUE(static_cast<bool>(linked));
  auto *function = reinterpret_cast<int64_t (*)(int64_t *, int64_t, double)>(
      linked->addresses.front());
  std::vector<int64_t> x(n + 1);
  for (int64_t i = 0; i <= n; ++i)
    x[i] = 7 * i + 3;
  x.push_back(function(x.data(), n, 1.25));
  return x;
}
} // namespace

TEST(HugeBodies, DividedBlocksDoTheSame) {
  for (int64_t n : {1, 2, 9})
    for (unsigned part : {1, 7, 50, 150})
      EXPECT_EQ(run(40, 0, n), run(40, part, n)) << part << ", n = " << n;
}

TEST(HugeBodies, PartsGrowWithTheBodyAndNoFaster) {
  LLVMContext context;
  auto divide = [&](int steps) {
    std::unique_ptr<Module> module = parse(getLoopText(steps), context);
    divideHugeBlocks(*module, nullptr, getLimits(100, 100));
    EXPECT_FALSE(verifyModule(*module, &errs()));
    size_t count = 0;
    for (Function &function : *module)
      count += function.getInstructionCount();
    // A part has its own instructions, and two for each value that it shares.
    for (Function &function : drop_begin(*module))
      EXPECT_LE(function.getInstructionCount(), 500u);
    return std::make_pair(module->size(), count);
  };
  auto [parts, count] = divide(100);
  auto [moreParts, moreCount] = divide(1000);
  EXPECT_GE(parts, 8u);
  EXPECT_LE(moreParts, 10 * parts + 1);
  EXPECT_LE(moreCount, 10 * count);
}

TEST(HugeBodies, OtherBlocksStay) {
  LLVMContext context;
  std::unique_ptr<Module> module = parse(getLoopText(100), context);
  size_t largest = getLargestBlock(*module);
  EXPECT_GT(largest, 800u);
  divideHugeBlocks(*module);
  divideHugeBlocks(*module, nullptr, getLimits(largest, 10));
  EXPECT_EQ(module->size(), 1u);
  EXPECT_EQ(getLargestBlock(*module), largest);
  // The block of the loop has 101 of 102 writes and 202 of 203 accesses.
  divideHugeBlocks(*module, nullptr, getLimits(largest, 10, 101 * 202));
  EXPECT_EQ(module->size(), 1u);
  divideHugeBlocks(*module, nullptr, getLimits(largest, 10, 101 * 202 - 1));
  EXPECT_GT(module->size(), 1u);
}

namespace {
std::unique_ptr<TargetMachine> makeMachine() {
  const TargetCpu &host = TargetCpu::getHost();
  Triple triple(host.triple);
  std::string message;
  const Target *target = TargetRegistry::lookupTarget(triple, message);
  return std::unique_ptr<TargetMachine>(target->createTargetMachine(
      triple, host.name, host.features, {}, Reloc::PIC_));
}

/// Whether a loop over `calls` calls of `callee` may be vectorised.
bool staysVectorizable(const std::string &callee, int calls,
                       unsigned vectorized) {
  std::string text = "declare float @" + callee + "(float)\n" + R"(
define void @f(ptr %x, i64 %n) {
entry:
  br label %loop
loop:
  %i = phi i64 [ 0, %entry ], [ %next, %loop ]
  %at = getelementptr float, ptr %x, i64 %i
  %v0 = load float, ptr %at
)";
  for (int k = 1; k <= calls; ++k)
    text += "  %v" + number(k) + " = call float @" + callee + "(float %v" +
            number(k - 1) + ")\n";
  text += "  store float %v" + number(calls) + R"(, ptr %at
  %next = add i64 %i, 1
  %on = icmp slt i64 %next, %n
  br i1 %on, label %loop, label %exit
exit:
  ret void
}
)";
  LLVMContext context;
  std::unique_ptr<Module> module = parse(text, context);
  Function &function = *module->getFunction("f");
  HugeBodyLimits limits;
  limits.vectorized = vectorized;
  std::unique_ptr<TargetMachine> machine = makeMachine();
  module->setDataLayout(machine->createDataLayout());
  runPass(function, KeepHugeLoopsScalar(limits), machine.get());
  DominatorTree dominators(function);
  LoopInfo loops(dominators);
  MDNode *id = (*loops.begin())->getLoopID();
  if (!id)
    return true;
  for (const MDOperand &operand : drop_begin(id->operands())) {
    auto *node = cast<MDNode>(operand);
    if (cast<MDString>(node->getOperand(0))->getString() ==
        "llvm.loop.vectorize.enable")
      return false;
  }
  return true;
}
} // namespace

TEST(HugeBodies, LoopsThatWouldBeHugeStayScalar) {
  // A call becomes eight calls with moves around them, or one instruction.
  EXPECT_TRUE(staysVectorizable("llvm.sin.f32", 10, 1000));
  EXPECT_FALSE(staysVectorizable("llvm.sin.f32", 100, 1000));
  EXPECT_TRUE(staysVectorizable("llvm.fabs.f32", 100, 1000));
  EXPECT_FALSE(staysVectorizable("llvm.fabs.f32", 1000, 1000));
}

TEST(HugeBodies, LoopsOfManyPairsAreLeftAloneByWhatComparesThem) {
  LLVMContext context;
  std::unique_ptr<Module> module = parse(getLoopText(100), context);
  Function &function = *module->getFunction("f");
  HugeBodyLimits limits;
  const auto *ir = static_cast<const Function *>(&function);
  runPass(function, KeepHugeLoopsScalar(limits));
  EXPECT_TRUE(KeepHugeLoopsScalar::canRun("LoopLoadEliminationPass", Any(ir)));
  limits.loopPairs = 10000;
  runPass(function, KeepHugeLoopsScalar(limits));
  EXPECT_FALSE(KeepHugeLoopsScalar::canRun("LoopLoadEliminationPass", Any(ir)));
  EXPECT_TRUE(KeepHugeLoopsScalar::canRun("GVNPass", Any(ir)));
}

TEST(HugeBodies, StatementsOfHugeBlocksAreNoVectors) {
  for (int calls : {100, 9000}) {
    std::string text = "define i32 @f(i32 %v0) {\n";
    for (int k = 1; k <= calls; ++k)
      text += "  %v" + number(k) + " = mul i32 %v" + number(k - 1) + ", 3\n";
    text += "  ret i32 %v" + number(calls) + "\n}\n";
    LLVMContext context;
    std::unique_ptr<Module> module = parse(text, context);
    const auto *ir = static_cast<const Function *>(module->getFunction("f"));
    EXPECT_EQ(KeepHugeLoopsScalar::canRun("SLPVectorizerPass", Any(ir)),
              calls == 100);
    EXPECT_TRUE(KeepHugeLoopsScalar::canRun("GVNPass", Any(ir)));
  }
}

namespace {
/// A function with `calls` calls of a library function of 20 instructions.
std::string getCalls(int calls, const std::string &name) {
  std::string text = "define i32 @" + name + "(i32 %v0) alwaysinline {\n";
  for (int k = 1; k < 20; ++k)
    text += "  %v" + number(k) + " = mul i32 %v" + number(k - 1) + ", 3\n";
  text += "  ret i32 %v19\n}\ndefine i32 @f(i32 %v0) {\n";
  for (int k = 1; k <= calls; ++k)
    text += "  %v" + number(k) + " = call i32 @" + name + "(i32 %v" +
            number(k - 1) + ")\n";
  return text + "  ret i32 %v" + number(calls) + "\n}\n";
}

/// The number of calls that are kept out of `calls`.
int countKept(int calls, const std::string &name, uint64_t inlined) {
  LLVMContext context;
  std::unique_ptr<Module> module = parse(getCalls(calls, name), context);
  HugeBodyLimits limits;
  limits.inlined = inlined;
  keepCallsInHugeFunctions(*module, "__nv_", limits);
  int kept = 0;
  for (Instruction &instruction : module->getFunction("f")->getEntryBlock())
    if (auto *call = dyn_cast<CallInst>(&instruction))
      kept += call->isNoInline();
  return kept;
}
} // namespace

TEST(HugeBodies, FunctionsThatWouldBeHugeCallTheLibrary) {
  EXPECT_EQ(countKept(50, "__nv_sinf", 1000), 0);
  EXPECT_EQ(countKept(51, "__nv_sinf", 1000), 51);
  EXPECT_EQ(countKept(51, "own", 1000), 0);
}

TEST(HugeBodies, BlocksOfCallsAreDividedForADevice) {
  for (bool keeps : {false, true}) {
    LLVMContext context;
    std::unique_ptr<Module> module = parse(getCalls(500, "__nv_sinf"), context);
    HugeBodyLimits limits = HugeBodyLimits::ofDevice();
    limits.inlined = keeps ? 1000 : 100000;
    keepCallsInHugeFunctions(*module, "__nv_", limits);
    divideHugeBlocks(*module, nullptr, limits);
    EXPECT_FALSE(verifyModule(*module, &errs()));
    EXPECT_EQ(module->size(), keeps ? 5u : 2u);
  }
}
