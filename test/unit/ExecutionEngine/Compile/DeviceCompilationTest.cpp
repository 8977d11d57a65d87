//===- DeviceCompilationTest.cpp - Compiling for a device -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Compiles a lowered module to the host's function and an image, which is run
// here without a runtime.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/GPU/IR/GPUDialect.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Parser/Parser.h"
#include "tai/CodeGen/Device/DeviceCompiler.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/ExecutionEngine/Compile/Compiler.h"
#include "gtest/gtest.h"
#include <cstring>
#include <map>

using namespace mlir;
using namespace mlir::tai;
using runtime::DeviceKind;

namespace {
int32_t getThree() { return 3; }

class EngineDevice : public testing::Test {
protected:
  EngineDevice() {
    DialectRegistry registry;
    registry.insert<LLVM::LLVMDialect, TaiDialect>();
    registerDeviceTranslations(registry);
    context.appendDialectRegistry(registry);
    context.loadAllAvailableDialects();
    // The kernel is lowered already.
    pipelines.toDevice = [](OpPassManager &, const CompileOptions &) {};
    emulated.device = DeviceKind::Emulated;
    cuda.device = DeviceKind::Cuda;
    cuda.deviceTarget = "sm_80";
    parse(R"(
      llvm.func @k(%frame: !llvm.ptr) -> i32 {
        %c = llvm.mlir.constant(7 : i32) : i32
        llvm.return %c : i32
      }
      gpu.module @kernels {
        llvm.func @tai_dev_thread_id() -> i32
        llvm.func @tai_dev_reduce_add_f64(!llvm.ptr, f64)
        llvm.func @later(%p: !llvm.ptr) attributes {gpu.kernel} {
          llvm.return
        }
        llvm.func @helper(%x: f64) -> f64 {
          llvm.return %x : f64
        }
        llvm.func @early(%p: !llvm.ptr, %on: i1, %k: i32, %x: f64)
            attributes {gpu.kernel, passthrough = [["tai.block_size", "96"]]} {
          llvm.cond_br %on, ^add, ^done
        ^add:
          %thread = llvm.call @tai_dev_thread_id() : () -> i32
          %sum = llvm.add %thread, %k : i32
          %float = llvm.sitofp %sum : i32 to f64
          %same = llvm.call @helper(%x) : (f64) -> f64
          %value = llvm.fadd %float, %same : f64
          llvm.call @tai_dev_reduce_add_f64(%p, %value) : (!llvm.ptr, f64) -> ()
          llvm.br ^done
        ^done:
          llvm.return
        }
      })");
  }

  void parse(StringRef text) {
    module = parseSourceString<ModuleOp>(text, &context, "k.mlir");
    ASSERT_TRUE(module);
  }
  CompileRequest request() {
    return {*module, "k", CompileRequest::Goal::Primal};
  }
  std::optional<Compiler::Function> compile(Compiler &compiler,
                                            const CompileOptions &options) {
    Failure failure;
    auto function = compiler.compile(request(), options, failure);
    EXPECT_TRUE(function) << failure.message;
    return function;
  }
  Failure fail(const CompileOptions &options) {
    Compiler compiler(&context, pipelines, {});
    Failure failure;
    EXPECT_FALSE(compiler.compile(request(), options, failure));
    return failure;
  }

  MLIRContext context;
  OwningOpRef<ModuleOp> module;
  Compiler::Pipelines pipelines;
  CompileOptions emulated, cuda;
};

TEST_F(EngineDevice, EmulatedImageRuns) {
  Compiler compiler(&context, pipelines, {});
  auto function = compile(compiler, emulated);
  ASSERT_TRUE(function && function->image);
  EXPECT_EQ(reinterpret_cast<int32_t (*)(void *)>(function->address)(nullptr),
            7);
  EXPECT_EQ(function->image->kind, DeviceKind::Emulated);
  EXPECT_EQ(function->image->functions,
            (std::vector<std::string>{"later", "early"}));

  auto linker = Linker::create(
      {{"tai_emu_thread_id", reinterpret_cast<void *>(&getThree)}});
  ASSERT_TRUE(static_cast<bool>(linker));
  const std::string &bytes = function->image->bytes;
  auto linked = (*linker)->link(bytes, {"early.slots", "later.slots"});
  ASSERT_TRUE(static_cast<bool>(linked));
  double target = 0.5;
  uint64_t slots[4];
  // In a slot, the bytes after a small parameter are undefined.
  std::memset(slots, 0xff, sizeof(slots));
  double *pointer = &target, x = 0.25;
  bool on = true;
  int32_t k = -10;
  std::memcpy(&slots[0], &pointer, sizeof(pointer));
  std::memcpy(&slots[1], &on, sizeof(on));
  std::memcpy(&slots[2], &k, sizeof(k));
  std::memcpy(&slots[3], &x, sizeof(x));
  auto early =
      reinterpret_cast<void (*)(const uint64_t *)>(linked->addresses.front());
  early(slots);
  EXPECT_EQ(target, 0.5 + (3 - 10 + 0.25));
  on = false;
  std::memcpy(&slots[1], &on, sizeof(on));
  early(slots);
  EXPECT_EQ(target, 0.5 + (3 - 10 + 0.25));
  // Other functions cannot be called by name.
  auto hidden = (*linker)->link(bytes, {"helper"});
  EXPECT_FALSE(static_cast<bool>(hidden));
  llvm::consumeError(hidden.takeError());
}

TEST_F(EngineDevice, ImagesAreCached) {
  std::map<std::string, std::string> store;
  auto compileOnce = [&](const CompileOptions &options) {
    Compiler compiler(&context, pipelines, {});
    compiler.setCache({[&](StringRef key) -> std::optional<std::string> {
                         auto found = store.find(key.str());
                         if (found == store.end())
                           return std::nullopt;
                         return found->second;
                       },
                       [&](StringRef key, StringRef bytes) {
                         store[key.str()] = bytes.str();
                       }});
    auto function = compile(compiler, options);
    function->library = nullptr;
    return *function;
  };
  Compiler::Function made = compileOnce(cuda), kept = compileOnce(cuda);
  EXPECT_FALSE(made.fromCache);
  EXPECT_TRUE(kept.fromCache);
  ASSERT_TRUE(made.image && kept.image);
  EXPECT_EQ(made.image->kind, DeviceKind::Cuda);
  EXPECT_EQ(kept.image->kind, DeviceKind::Cuda);
  EXPECT_EQ(made.image->bytes, kept.image->bytes);
  EXPECT_EQ(made.image->functions, kept.image->functions);
  EXPECT_EQ(made.image->blockSizes, std::vector<int64_t>({0, 96}));
  EXPECT_EQ(kept.image->blockSizes, made.image->blockSizes);
  EXPECT_FALSE(made.image->key.empty());
  EXPECT_EQ(made.image->key, kept.image->key);
  EXPECT_NE(made.image->bytes.find(".target sm_80"), std::string::npos);
  // Each kind of device and each target has a separate entry of the cache.
  EXPECT_FALSE(compileOnce(emulated).fromCache);
  cuda.deviceTarget = "sm_90";
  EXPECT_FALSE(compileOnce(cuda).fromCache);
  // An entry that is cut off anywhere is not accepted.
  for (const auto &[key, bytes] : store) {
    ASSERT_TRUE(CompiledObject::deserialize(bytes));
    size_t image = bytes.size() / 2;
    for (size_t size = 0; size < bytes.size(); size += image / 50 + 1)
      EXPECT_FALSE(CompiledObject::deserialize(bytes.substr(0, size)));
  }
}

TEST_F(EngineDevice, KernelsMayHaveNoDeviceCode) {
  parse(R"(llvm.func @k(%frame: !llvm.ptr) -> i32 {
             %c = llvm.mlir.constant(0 : i32) : i32
             llvm.return %c : i32
           }
           gpu.module @kernels {
           })");
  Compiler compiler(&context, pipelines, {});
  auto function = compile(compiler, cuda);
  ASSERT_TRUE(function);
  EXPECT_FALSE(function->image);
}

TEST_F(EngineDevice, Stages) {
  Compiler compiler(&context, pipelines, {});
  auto print = [&](StringRef stage, const CompileOptions &options) {
    Failure failure;
    auto text = compiler.print(request(), stage, options, failure);
    return text ? *text : "error: " + failure.message;
  };
  auto has = [](const std::string &text, const char *part) {
    return text.find(part) != std::string::npos;
  };
  std::string nvvm = print("nvvm", cuda), ptx = print("ptx", cuda);
  EXPECT_EQ(nvvm.find("gpu.module @kernels"), 0u);
  EXPECT_FALSE(has(nvvm, "@k("));
  EXPECT_TRUE(has(ptx, ".visible .entry early"));
  std::string host = print("llvmir", cuda);
  EXPECT_TRUE(has(host, "@k("));
  EXPECT_FALSE(has(host, "@early"));
  EXPECT_EQ(print("ptx", emulated), "error: the emulated device has no PTX");
  EXPECT_EQ(print("nvvm", CompileOptions()),
            "error: stage 'nvvm' is there for kernels of a GPU alone");
}

TEST_F(EngineDevice, Failures) {
  cuda.deviceTarget = "sm_20";
  Failure failure = fail(cuda);
  EXPECT_EQ(failure.kind, FailureKind::Usage);
  EXPECT_EQ(failure.message,
            "unknown GPU 'sm_20': code is made for sm_70 and later");
  pipelines.toDevice = nullptr;
  EXPECT_EQ(fail(emulated).message,
            "this build cannot compile kernels for a GPU");
}

TEST_F(EngineDevice, FatalErrorsOfLLVM) {
  parse(R"(llvm.func @k(%frame: !llvm.ptr) -> i32 {
             %c = llvm.mlir.constant(0 : i32) : i32
             llvm.return %c : i32
           }
           gpu.module @kernels {
             llvm.func @f(%p: !llvm.ptr, %x: f64) attributes {gpu.kernel} {
               %0 = llvm.intr.cos(%x) : (f64) -> f64
               llvm.store %0, %p : f64, !llvm.ptr
               llvm.return
             }
           })");
  Compiler compiler(&context, pipelines, {});
  // The second time, the tools are new ones, without the error.
  for (int repeat = 0; repeat < 2; ++repeat) {
    Failure failure;
    EXPECT_FALSE(compiler.compile(request(), cuda, failure));
    EXPECT_EQ(failure.kind, FailureKind::Internal);
    EXPECT_EQ(failure.message.find("code generation failed: "), 0u)
        << failure.message;
  }
}
} // namespace
