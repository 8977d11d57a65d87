//===- LibraryCallsTest.cpp - Tests of calls that LLVM makes by itself ----===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Linker.h"
#include "tai/CodeGen/ObjectCompiler.h"
#include "tai/Runtime/Launch/Runtime.h"
#include "llvm/ADT/StringSet.h"
#include "llvm/AsmParser/Parser.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"
#include "llvm/IR/RuntimeLibcalls.h"
#include "llvm/IR/Verifier.h"
#include "llvm/Support/SourceMgr.h"
#include "llvm/TargetParser/Host.h"
#include "llvm/TargetParser/Triple.h"

#include "gtest/gtest.h"

#include <cmath>

using namespace llvm;
using namespace mlir::tai;

namespace {
/// Links a module like kernels are linked; has the address of its function `f`.
template <typename Function> class Code {
public:
  explicit Code(StringRef text) {
    LLVMContext context;
    SMDiagnostic diagnostic;
    std::unique_ptr<Module> module =
        parseAssemblyString(text, diagnostic, context);
    EXPECT_TRUE(module) << diagnostic.getMessage().str();
    EXPECT_FALSE(verifyModule(*module, &errs()));
    auto objects = ObjectCompiler::create(CodegenOptions());
    (*objects)->setTarget(*module);
    auto object = (*objects)->emitObject(*module);
    EXPECT_TRUE(static_cast<bool>(object));
    linker = std::move(*Linker::create(runtime::runtimeSymbols()));
    auto linked = linker->link(*object, {"f"});
    if (!linked) {
      ADD_FAILURE() << toString(linked.takeError());
      return;
    }
    function = reinterpret_cast<Function *>(linked->addresses.front());
  }

  Function *function = nullptr;

private:
  std::unique_ptr<Linker> linker;
};

/// Whether LLVM may call a function of this name in kernels: functions of the
/// math library or of strings, and functions for types without instructions.
/// Kernels have neither long double nor f128. LLVM converts from f16 and bf16
/// by way of f32, and multiplies and shifts 128-bit integers inline.
bool isForKernels(StringRef name) {
  bool isMath = !name.contains('_') && !name.contains("f128");
  if (isMath)
    return !name.ends_with("l") || name == "ceil";
  static const StringRef ours[] = {"__powi", "__trunc", "__div", "__udiv",
                                   "__mod",  "__umod",  "__fix", "__float"};
  if (none_of(ours, [&](StringRef part) { return name.starts_with(part); }))
    return false;
  if (name.contains("tf") || name.contains("xf"))
    return false;
  return name.starts_with("__powi") || name.contains("ti") ||
         (name.starts_with("__trunc") && name != "__truncdfsf2");
}
} // namespace

TEST(LibraryCalls, AreAllThere) {
  RTLIB::RuntimeLibcallsInfo info{Triple(sys::getProcessTriple())};
  std::string declared, table;
  StringSet<> names;
  for (auto call : RTLIB::libcall_impls()) {
    StringRef name = RTLIB::RuntimeLibcallsInfo::getLibcallImplName(call);
    if (call == RTLIB::Unsupported || !info.isAvailable(call) ||
        !isForKernels(name) || !names.insert(name).second)
      continue;
    declared += "declare void @" + name.str() + "()\n";
    table += (table.empty() ? "ptr @" : ", ptr @") + name.str();
  }
  EXPECT_GE(names.size(), 60u);
  std::string text = declared + "@t = global [" + std::to_string(names.size()) +
                     " x ptr] [" + table + "]\n" +
                     "define ptr @f() {\n  ret ptr @t\n}\n";
  Code<void *()> code(text);
  ASSERT_TRUE(code.function);
  EXPECT_NE(code.function(), nullptr);
}

TEST(LibraryCalls, PowersAreRight) {
  Code<float(float, int)> single(R"(
    declare float @llvm.powi.f32.i32(float, i32)
    define float @f(float %x, i32 %n) {
      %r = call float @llvm.powi.f32.i32(float %x, i32 %n)
      ret float %r
    })");
  Code<double(double, int)> wide(R"(
    declare double @llvm.powi.f64.i32(double, i32)
    define double @f(double %x, i32 %n) {
      %r = call double @llvm.powi.f64.i32(double %x, i32 %n)
      ret double %r
    })");
  for (int n : {0, 1, 2, 7, -1, -5, 100, -100, INT_MAX, INT_MIN})
    for (double x : {1.0, -1.0, 0.5, -1.5, 0.0, 1e20, 0.9999999}) {
      EXPECT_FLOAT_EQ(single.function(x, n),
                      static_cast<float>(std::pow(float(x), double(n))))
          << x << " to the " << n;
      EXPECT_DOUBLE_EQ(wide.function(x, n), std::pow(x, n))
          << x << " to the " << n;
    }
}

TEST(LibraryCalls, WideIntegersAreRight) {
  Code<int64_t(int64_t, int64_t, int64_t)> code(R"(
    define i64 @f(i64 %a, i64 %b, i64 %c) {
      %wideA = sext i64 %a to i128
      %wideB = sext i64 %b to i128
      %wideC = sext i64 %c to i128
      %product = mul i128 %wideA, %wideB
      %quotient = sdiv i128 %product, %wideC
      %rest = srem i128 %product, %wideC
      %sum = add i128 %quotient, %rest
      %result = trunc i128 %sum to i64
      ret i64 %result
    })");
  EXPECT_EQ(code.function(INT64_MAX, 1000, 1000), INT64_MAX);
  EXPECT_EQ(code.function(INT64_MAX, -7, 7), -INT64_MAX);
  EXPECT_EQ(code.function(1000000007, 1000000009, 10), 100000001600000006 + 3);
}
