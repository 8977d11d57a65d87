//===- DeviceProgramsTest.cpp - Kernels that become one -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ABI/DeviceAbi.h"
#include "tai/CodeGen/Device/DeviceCompiler.h"
#include "tai/Runtime/Queue/DeviceQueue.h"
#include "llvm/AsmParser/Parser.h"
#include "llvm/Bitcode/BitcodeWriter.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"
#include "llvm/Support/SourceMgr.h"
#include "llvm/Support/raw_ostream.h"
#include "gtest/gtest.h"

using namespace mlir::tai;

namespace {
/// The bitcode of a kernel with `size` multiplications.
std::string getKernel(int size) {
  std::string text =
      "target datalayout = \"e-p6:32:32-i64:64-i128:128-i256:256-"
      "v16:16-v32:32-n16:32:64\"\n"
      "define void @f(ptr %p) {\n"
      "  %v0 = load i32, ptr %p\n";
  for (int k = 1; k <= size; ++k)
    text += "  %v" + std::to_string(k) + " = mul i32 %v" +
            std::to_string(k - 1) + ", %v0\n";
  text += "  store i32 %v" + std::to_string(size) + ", ptr %p\n  ret void\n}\n";
  llvm::LLVMContext context;
  llvm::SMDiagnostic error;
  std::unique_ptr<llvm::Module> module =
      llvm::parseAssemblyString(text, error, context);
  EXPECT_TRUE(module) << error.getMessage().str();
  std::string bytes;
  llvm::raw_string_ostream stream(bytes);
  llvm::WriteBitcodeToFile(*module, stream);
  return bytes;
}

/// The error for a program of `kernels` kernels; empty if it can be made.
std::string makeProgramOf(int kernels, int size) {
  auto compiler = DeviceCompiler::create({runtime::DeviceKind::Cuda, "sm_90"},
                                         CodegenOptions());
  EXPECT_TRUE(static_cast<bool>(compiler));
  auto kernel = std::make_shared<const std::string>(getKernel(size));
  runtime::ProgramPlan plan;
  for (int k = 0; k < kernels; ++k)
    plan.parts.push_back({kernel, "f"});
  plan.scope = TAI_SCOPE_BLOCK;
  plan.threads = 32;
  auto image = makeProgram(**compiler, plan);
  return image ? "" : llvm::toString(image.takeError());
}

TEST(DevicePrograms, ThoseThatPtxasTakesMinutesForAreRefused) {
  EXPECT_EQ(makeProgramOf(1, 100), "");
  EXPECT_EQ(makeProgramOf(4, 2900), "");
  EXPECT_EQ(makeProgramOf(4, 3000),
            "its kernels have 12012 instructions, and a program of more than "
            "12000 is compiled for too long");
  EXPECT_NE(makeProgramOf(1, 12000), "");
}
} // namespace
