//===- CompilerTest.cpp - The compiler by itself --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Compile/Compiler.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Parser/Parser.h"
#include "mlir/Pass/Pass.h"
#include "mlir/Target/LLVMIR/Dialect/Builtin/BuiltinToLLVMIRTranslation.h"
#include "mlir/Target/LLVMIR/Dialect/LLVMIR/LLVMToLLVMIRTranslation.h"
#include "tai/Conversion/Passes.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/ExecutionEngine/Compile/Background.h"
#include "llvm/Support/FileSystem.h"
#include "llvm/Support/MemoryBuffer.h"
#include "gtest/gtest.h"
#include <atomic>

using namespace mlir;
using namespace mlir::tai;

namespace {

/// Fails without a diagnostic.
struct SilentFailure : PassWrapper<SilentFailure, OperationPass<ModuleOp>> {
  MLIR_DEFINE_EXPLICIT_INTERNAL_INLINE_TYPE_ID(SilentFailure)
  StringRef getArgument() const override { return "test-silent-failure"; }
  void runOnOperation() override { signalPassFailure(); }
};

/// Succeeds, but leaves functions that return fewer values than they declare.
struct BrokenReturns : PassWrapper<BrokenReturns, OperationPass<ModuleOp>> {
  MLIR_DEFINE_EXPLICIT_INTERNAL_INLINE_TYPE_ID(BrokenReturns)
  void runOnOperation() override {
    getOperation().walk([](LLVM::ReturnOp op) { op->eraseOperand(0); });
  }
};

/// Leaves a cast behind, as incomplete conversions do.
struct LeftCast : PassWrapper<LeftCast, OperationPass<ModuleOp>> {
  MLIR_DEFINE_EXPLICIT_INTERNAL_INLINE_TYPE_ID(LeftCast)
  StringRef getArgument() const override { return "test-left-cast"; }
  void runOnOperation() override {
    auto function = *getOperation().getOps<LLVM::LLVMFuncOp>().begin();
    OpBuilder builder(&function.getBody().front().front());
    UnrealizedConversionCastOp::create(builder, function.getLoc(),
                                       builder.getIndexType(),
                                       ValueRange(function.getArgument(0)));
  }
};

/// Fails with two errors and a note.
struct LoudFailure : PassWrapper<LoudFailure, OperationPass<ModuleOp>> {
  MLIR_DEFINE_EXPLICIT_INTERNAL_INLINE_TYPE_ID(LoudFailure)
  void runOnOperation() override {
    Operation &first = getOperation().getBody()->front();
    InFlightDiagnostic error = first.emitError("the first");
    error.attachNote() << "a note";
    error.report();
    first.emitError("the second");
    signalPassFailure();
  }
};

class EngineCompiler : public testing::Test {
protected:
  EngineCompiler() {
    DialectRegistry registry;
    registry.insert<LLVM::LLVMDialect, TaiDialect>();
    registerBuiltinDialectTranslation(registry);
    registerLLVMDialectTranslation(registry);
    context.appendDialectRegistry(registry);
    context.loadAllAvailableDialects();
    module = parseSourceString<ModuleOp>(R"(
      llvm.func @helper(%x: i32) -> i32 {
        %c = llvm.mlir.constant(41 : i32) : i32
        %r = llvm.add %x, %c : i32
        llvm.return %r : i32
      }
      llvm.func @k(%frame: !llvm.ptr) -> i32 {
        %c = llvm.mlir.constant(1 : i32) : i32
        %r = llvm.call @helper(%c) : (i32) -> i32
        llvm.return %r : i32
      })",
                                         &context, "k.mlir");
  }

  template <typename PassTy> Failure compileWith() {
    Compiler::Pipelines pipelines;
    pipelines.toLLVM = [](OpPassManager &manager, const CompileOptions &) {
      manager.addPass(std::make_unique<PassTy>());
    };
    Compiler compiler(&context, pipelines, {});
    Failure failure;
    EXPECT_FALSE(compiler.compile({*module, "k", CompileRequest::Goal::Primal},
                                  CompileOptions(), failure));
    return failure;
  }

  MLIRContext context;
  OwningOpRef<ModuleOp> module;
};

TEST_F(EngineCompiler, CompilesAndLinks) {
  Compiler compiler(&context, {}, {});
  for (unsigned level = 0; level <= 3; ++level) {
    CompileOptions options;
    options.codegen.optLevel = level;
    Failure failure;
    auto function = compiler.compile(
        {*module, "k", CompileRequest::Goal::Primal}, options, failure);
    ASSERT_TRUE(function) << failure.text;
    EXPECT_EQ(reinterpret_cast<int32_t (*)(void *)>(function->address)(nullptr),
              42);
    compiler.unload(*function);
  }
}

TEST_F(EngineCompiler, SilentFailuresLeaveAReproducer) {
  Failure failure = compileWith<SilentFailure>();
  EXPECT_EQ(failure.kind, FailureKind::Internal);
  StringRef message = failure.message;
  size_t at = message.find("reproducer: ");
  ASSERT_NE(at, StringRef::npos) << failure.message;
  StringRef path = message.drop_front(at + strlen("reproducer: "));
  auto file = llvm::MemoryBuffer::getFile(path);
  ASSERT_TRUE(static_cast<bool>(file)) << path.str();
  EXPECT_TRUE((*file)->getBuffer().contains("llvm.func @helper"));
  EXPECT_TRUE((*file)->getBuffer().contains("test-silent-failure"));
  // The file can be read with --run-reproducer.
  EXPECT_TRUE(parseSourceString<ModuleOp>((*file)->getBuffer(), &context));
  llvm::sys::fs::remove(path);
}

/// Sets an environment variable during its lifetime.
struct Environment {
  Environment(const char *name, const char *value) : name(name) {
    if (const char *given = std::getenv(name))
      before = given;
    ::setenv(name, value, /*overwrite=*/1);
  }
  ~Environment() {
    if (before)
      ::setenv(name, before->c_str(), /*overwrite=*/1);
    else
      ::unsetenv(name);
  }
  const char *name;
  std::optional<std::string> before;
};

/// Reads and removes the file that a failure names; empty if there is none.
std::string takeReproducer(const Failure &failure) {
  StringRef path = StringRef(failure.message).split("; reproducer: ").second;
  auto file = llvm::MemoryBuffer::getFile(path);
  if (!file)
    return "";
  llvm::sys::fs::remove(path);
  return (*file)->getBuffer().str();
}

// The verifier's error is not about the program.
TEST_F(EngineCompiler, ModulesThatAreNotValidLeaveAReproducer) {
  Environment verify("TAI_VERIFY_EACH", "1");
  Failure failure = compileWith<BrokenReturns>();
  EXPECT_EQ(failure.kind, FailureKind::Internal);
  EXPECT_TRUE(StringRef(failure.message)
                  .starts_with("lowering of 'k' failed inside the compiler: "
                               "in or after '"))
      << failure.message;
  EXPECT_TRUE(StringRef(failure.text).contains("; reproducer: "));
  EXPECT_TRUE(StringRef(takeReproducer(failure)).contains("llvm.func @helper"));
}

// An operation that no pass has lowered is not the program's fault.
TEST_F(EngineCompiler, OperationsThatAreLeftLeaveAReproducer) {
  Compiler::Pipelines pipelines;
  pipelines.toLLVM = [](OpPassManager &manager, const CompileOptions &) {
    manager.addPass(std::make_unique<LeftCast>());
    VerifyLLVMOptions all;
    all.all = true;
    manager.addPass(createVerifyLLVM(all));
  };
  Compiler compiler(&context, pipelines, {});
  Failure failure;
  EXPECT_FALSE(compiler.compile({*module, "k", CompileRequest::Goal::Primal},
                                CompileOptions(), failure));
  EXPECT_EQ(failure.kind, FailureKind::Internal);
  EXPECT_EQ(failure.line, 2);
  EXPECT_TRUE(StringRef(failure.message).contains("was not lowered"));
  EXPECT_TRUE(StringRef(takeReproducer(failure)).contains("tai-verify-llvm"));
}

TEST_F(EngineCompiler, ErrorsOfProgramsLeaveNoReproducer) {
  Failure failure = compileWith<LoudFailure>();
  EXPECT_FALSE(StringRef(failure.text).contains("reproducer"));
}

TEST_F(EngineCompiler, FailuresOfLLVMLeaveAReproducer) {
  for (const char *place : {"translate", "optimize", "emit", "link"}) {
    Environment inject("TAI_INJECT_FAILURE", place);
    Compiler compiler(&context, {}, {});
    Failure failure;
    EXPECT_FALSE(compiler.compile({*module, "k", CompileRequest::Goal::Primal},
                                  CompileOptions(), failure));
    EXPECT_EQ(failure.kind, FailureKind::Internal) << place;
    std::string file = takeReproducer(failure);
    EXPECT_TRUE(StringRef(file).contains("a failure was asked for")) << place;
    EXPECT_TRUE(StringRef(file).contains("| tai-translate --mlir-to-llvmir"))
        << place;
    EXPECT_TRUE(parseSourceString<ModuleOp>(file, &context)) << place;
  }
}

// Prints the stages of a kernel whose compilation fails.
TEST_F(EngineCompiler, PrintingLeavesAReproducer) {
  Compiler::Pipelines pipelines;
  pipelines.toLLVM = [](OpPassManager &manager, const CompileOptions &) {
    manager.addPass(std::make_unique<SilentFailure>());
  };
  Compiler compiler(&context, pipelines, {});
  Failure failure;
  EXPECT_FALSE(compiler.print({*module, "k", CompileRequest::Goal::Primal},
                              "llvm", CompileOptions(), failure));
  EXPECT_TRUE(
      StringRef(takeReproducer(failure)).contains("test-silent-failure"));
}

// Repeats a launch that fails.
TEST_F(EngineCompiler, AFailureLeavesOneFile) {
  Failure first = compileWith<SilentFailure>();
  Failure second = compileWith<SilentFailure>();
  EXPECT_EQ(first.message, second.message);
  EXPECT_NE(takeReproducer(first), "");
}

TEST_F(EngineCompiler, TestsVerifyAfterEachPass) {
  const char *given = std::getenv("TAI_VERIFY_EACH");
  std::string before = given ? given : "";
  ::setenv("TAI_VERIFY_EACH", "1", /*overwrite=*/1);
  Failure failure = compileWith<BrokenReturns>();
  ::setenv("TAI_VERIFY_EACH", before.c_str(), /*overwrite=*/1);
  EXPECT_TRUE(StringRef(failure.message).contains("expected 1 operand"))
      << failure.message;
}

TEST_F(EngineCompiler, KeepsAllDiagnostics) {
  Failure failure = compileWith<LoudFailure>();
  EXPECT_EQ(failure.kind, FailureKind::Type);
  EXPECT_EQ(failure.message, "the first");
  EXPECT_EQ(failure.file, "k.mlir");
  EXPECT_EQ(failure.line, 2);
  EXPECT_EQ(failure.column, 7);
  StringRef text = failure.text;
  EXPECT_TRUE(text.contains("k.mlir:2:7: error: the first\n"));
  EXPECT_TRUE(text.contains("k.mlir:2:7: note: a note\n"));
  EXPECT_TRUE(text.contains("k.mlir:2:7: error: the second\n"));
}

TEST(Background, RunsTakesOverAndCancels) {
  std::atomic<int> ran{0};
  auto count = [&] { ++ran; };
  {
    // Without threads, a job runs only when its result is needed.
    Background none(0);
    auto wanted = none.start(count), dropped = none.start(count);
    EXPECT_EQ(ran, 0);
    none.finish(*wanted);
    none.finish(*wanted);
    EXPECT_EQ(ran, 1);
    none.cancel(*dropped);
    none.finish(*dropped);
    EXPECT_EQ(ran, 1);
  }
  Background some(2);
  std::vector<Background::JobPtr> jobs;
  for (int round = 0; round < 50; ++round) {
    for (int i = 0; i < 8; ++i)
      jobs.push_back(some.start(count));
    for (auto &job : jobs)
      some.finish(*job);
    jobs.clear();
  }
  EXPECT_EQ(ran, 401);
}

} // namespace
