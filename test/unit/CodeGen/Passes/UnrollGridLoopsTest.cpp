//===- UnrollGridLoopsTest.cpp - Unrolled loops do the same ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Runs a kernel on the CPU, one thread after another, with its loop unrolled
// and not.
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/UnrollGridLoops.h"
#include "../../Utils/LLVMPassUtils.h"
#include "tai/CodeGen/Linker.h"
#include "tai/CodeGen/ObjectCompiler.h"
#include "llvm/AsmParser/Parser.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"
#include "llvm/IR/Verifier.h"
#include "llvm/Support/SourceMgr.h"
#include "gtest/gtest.h"

using namespace llvm;
using namespace mlir::tai;

namespace {
constexpr int blocks = 2, threads = 4;

/// The values of the special registers.
int32_t places[3];
int32_t getThread() { return places[0]; }
int32_t getBlock() { return places[1]; }
int32_t getThreads() { return threads; }
int32_t getBlocks() { return blocks; }

// y[i] = (y[i] + x[i]) * 3, then z[i] = y[i], which is loaded again; and for
// each thread, the sum of x and the last index.
constexpr char kernelText[] = R"(
declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.nctaid.x()

define ptx_kernel void @kernel(ptr %x, ptr %y, ptr %z, ptr %ends, i32 %n) {
  %thread = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
  %block = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
  %threads = call i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
  %blocks = call i32 @llvm.nvvm.read.ptx.sreg.nctaid.x()
  %begin = mul nsw i32 %block, %threads
  %first = add nsw i32 %begin, %thread
  %stride = mul nsw i32 %blocks, %threads
  %any = icmp slt i32 %first, %n
  br i1 %any, label %loop, label %exit
loop:
  %i = phi i32 [ %first, %0 ], [ %next, %loop ]
  %sum = phi i32 [ 0, %0 ], [ %more, %loop ]
  %before = phi i32 [ -1, %0 ], [ %i, %loop ]
  %at = sext i32 %i to i64
  %xi = getelementptr inbounds i32, ptr %x, i64 %at
  %yi = getelementptr inbounds i32, ptr %y, i64 %at
  %zi = getelementptr inbounds i32, ptr %z, i64 %at
  %vx = load i32, ptr %xi, align 4, !invariant.load !0
  %vy = load i32, ptr %yi, align 4
  %both = add i32 %vx, %vy
  %three = mul i32 %both, 3
  store i32 %three, ptr %yi, align 4
  %again = load i32, ptr %yi, align 4
  %mixed = add i32 %again, %before
  store i32 %mixed, ptr %zi, align 4
  %more = add i32 %sum, CARRIED
  %next = add i32 %i, %stride
  %on = icmp slt i32 %next, %n
  br i1 %on, label %loop, label %exit
exit:
  %total = phi i32 [ 0, %0 ], [ %more, %loop ]
  %last = phi i32 [ -1, %0 ], [ %i, %loop ]
  %two = mul i32 %first, 2
  %slot = getelementptr i32, ptr %ends, i32 %two
  store i32 %total, ptr %slot
  %slot2 = getelementptr i32, ptr %slot, i32 1
  store i32 %last, ptr %slot2
  ret void
}
!0 = !{}
)";

using Kernel = void (*)(int32_t *x, int32_t *y, int32_t *z, int32_t *ends,
                        int32_t n);

class UnrollGridLoops : public testing::Test {
protected:
  /// Compiles the kernel for the CPU. `carried` is the term of the sum.
  Kernel compile(const std::string &carried, bool unrolls, size_t &blockCount) {
    LLVMContext context;
    std::string text = kernelText;
    text.replace(text.find("CARRIED"), 7, carried);
    SMDiagnostic diagnostic;
    auto module = parseAssemblyString(text, diagnostic, context);
    EXPECT_TRUE(module) << diagnostic.getMessage().str();
    Function *kernel = module->getFunction("kernel");
    if (unrolls) {
      mlir::tai::runPass(*kernel, mlir::tai::UnrollGridLoops());
    }
    blockCount = kernel->size();
    EXPECT_FALSE(verifyFunction(*kernel, &errs()));
    // The registers become functions.
    for (StringRef name : {"tid.x", "ctaid.x", "ntid.x", "nctaid.x"}) {
      Function *read =
          module->getFunction(("llvm.nvvm.read.ptx.sreg." + name).str());
      auto callee = module->getOrInsertFunction(("get." + name).str(),
                                                read->getFunctionType());
      read->replaceAllUsesWith(callee.getCallee());
      read->eraseFromParent();
    }
    kernel->setCallingConv(CallingConv::C);
    auto objects = ObjectCompiler::create(CodegenOptions());
    EXPECT_FALSE((*objects)->optimize(*module));
    auto object = (*objects)->emitObject(*module);
    EXPECT_TRUE(static_cast<bool>(object));
    if (!linker)
      linker = std::move(*Linker::create(
          {{"get.tid.x", reinterpret_cast<void *>(&getThread)},
           {"get.ctaid.x", reinterpret_cast<void *>(&getBlock)},
           {"get.ntid.x", reinterpret_cast<void *>(&getThreads)},
           {"get.nctaid.x", reinterpret_cast<void *>(&getBlocks)}}));
    auto linked = linker->link(*object, {"kernel"});
    EXPECT_TRUE(static_cast<bool>(linked));
    return reinterpret_cast<Kernel>(linked->addresses.front());
  }

  std::vector<int32_t> run(Kernel kernel, int32_t n) {
    std::vector<int32_t> x(100), y(100), z(100, -7), ends(16, -9);
    for (int32_t i = 0; i < 100; ++i) {
      x[i] = 1 + 7 * i;
      y[i] = 5 - i * i;
    }
    for (places[1] = 0; places[1] < blocks; ++places[1])
      for (places[0] = 0; places[0] < threads; ++places[0])
        kernel(x.data(), y.data(), z.data(), ends.data(), n);
    for (const auto *more : {&z, &ends})
      y.insert(y.end(), more->begin(), more->end());
    return y;
  }

  std::unique_ptr<Linker> linker;
};

TEST_F(UnrollGridLoops, DoTheSame) {
  // A sum of values that are loaded early, and a sum of values loaded after a
  // store, which keeps the iterations in order.
  for (const char *carried : {"%vx", "%again"}) {
    size_t plainBlocks, unrolledBlocks;
    Kernel plain = compile(carried, false, plainBlocks);
    Kernel unrolled = compile(carried, true, unrolledBlocks);
    EXPECT_GT(unrolledBlocks, plainBlocks);
    for (int32_t n : {-3, 0, 1, 7, 8, 9, 24, 25, 31, 32, 33, 40, 63, 64, 100})
      EXPECT_EQ(run(plain, n), run(unrolled, n)) << carried << ", n = " << n;
  }
  // Check expected values: thread 1 has the indices 1, 9, 17, ..., 97.
  size_t count;
  std::vector<int32_t> result = run(compile("%vx", true, count), 100);
  EXPECT_EQ(result[9], 3 * ((5 - 81) + (1 + 63)));
  EXPECT_EQ(result[200 + 2], 13 + 7 * (13 * 49));
  EXPECT_EQ(result[200 + 3], 97);
}
} // namespace
