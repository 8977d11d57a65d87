//===- EngineCacheTest.cpp - Compiled code between contexts ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "EngineTestUtil.h"
#include "mlir/Parser/Parser.h"
#include "tai/ExecutionEngine/CompiledObject.h"
#include "tai/ExecutionEngine/Session.h"
#include "llvm/Support/MemoryBuffer.h"
#include "llvm/Support/raw_ostream.h"

using namespace tai_test;
using namespace mlir;
using namespace mlir::tai;

namespace {

const char *sumText = R"(
  tai.tree @t : !tai.root<dense<[i: 4], {x: f64, gx: f64}>, {y: f64, gy: f64}>
  tai.field @gx = @t["gx"] : f64, rank 1
  tai.field @x = @t["x"] : f64, rank 1, adjoint @gx
  tai.field @gy = @t["gy"] : f64, rank 0
  tai.field @y = @t["y"] : f64, rank 0, adjoint @gy
)";

/// A context that keeps its code in a folder, and the sum of squares in it.
struct Program {
  explicit Program(llvm::StringRef folder, const std::string &factor = "1.0") {
    EXPECT_TRUE(succeeded(session.setOption("cache_dir", folder)));
    ParserConfig config(session.getContext());
    module = parseSourceString<ModuleOp>(sumText + squares(factor), config);
    for (TreeOp tree : module->getOps<TreeOp>())
      EXPECT_TRUE(succeeded(session.addTree(tree)));
    for (FieldOp field : module->getOps<FieldOp>())
      EXPECT_TRUE(succeeded(session.addField(field)));
    auto made = session.createKernel(module.release(), "squares");
    EXPECT_TRUE(succeeded(made)) << session.getFailure().text;
    kernel = *made;
  }

  /// y and its gradient by x[2] for x = 3.
  std::pair<double, double> run() {
    runtime::Runtime &rt = session.getRuntime();
    EXPECT_TRUE(rt.fillF64(*rt.findField("x"), 3).ok());
    EXPECT_TRUE(rt.fillF64(*rt.findField("y"), 0).ok());
    std::unique_ptr<runtime::Tape> tape;
    EXPECT_TRUE(rt.beginTape(rt.findField("y"), true, tape).ok());
    EXPECT_TRUE(succeeded(session.launch(*kernel, nullptr, 0, nullptr)))
        << session.getFailure().text;
    EXPECT_TRUE(tape->backward().ok());
    double y = 0, g = 0;
    int64_t index = 2;
    EXPECT_TRUE(rt.findField("y")->readF64(nullptr, 0, y).ok());
    EXPECT_TRUE(rt.findField("gx")->readF64(&index, 0, g).ok());
    return {y, g};
  }

  unsigned hits() {
    unsigned count = 0;
    for (const Compiler::Function &function : kernel->code->functions)
      count += function.fromCache;
    return count;
  }

  Session session;
  OwningOpRef<ModuleOp> module;
  SessionKernel *kernel = nullptr;
};

std::vector<std::string> filesIn(llvm::StringRef folder) {
  std::vector<std::string> files;
  std::error_code error;
  for (llvm::sys::fs::recursive_directory_iterator i(folder, error), end;
       i != end && !error; i.increment(error))
    if (llvm::sys::fs::is_regular_file(i->path()))
      files.push_back(i->path());
  return files;
}

TEST(EngineCache, SecondContextRunsNoPass) {
  TemporaryFolder folder;
  Program first(folder.path);
  EXPECT_EQ(first.run(), std::make_pair(36.0, 6.0));
  EXPECT_EQ(first.hits(), 0u);
  Program second(folder.path);
  EXPECT_EQ(second.run(), std::make_pair(36.0, 6.0));
  EXPECT_EQ(second.hits(), 2u);
  PhaseTimes times = second.session.getCompiler().getTotals();
  for (Phase phase : {Phase::Autodiff, Phase::Lower, Phase::Optimize})
    EXPECT_EQ(times[static_cast<unsigned>(phase)], 0.0);
}

TEST(EngineCache, OtherProgramsAndOptionsMiss) {
  TemporaryFolder folder;
  Program(folder.path).run();
  Program other(folder.path, "2.0");
  EXPECT_EQ(other.run(), std::make_pair(72.0, 12.0));
  EXPECT_EQ(other.hits(), 0u);
  // An option holds for kernels created afterwards.
  Program debug(folder.path);
  EXPECT_TRUE(succeeded(debug.session.setOption("debug", "true")));
  auto again = debug.session.createKernel(debug.kernel->code->module->clone(),
                                          "squares");
  ASSERT_TRUE(succeeded(again));
  debug.kernel = *again;
  debug.run();
  EXPECT_EQ(debug.hits(), 0u);
}

TEST(EngineCache, DamagedEntriesAreCompiledAnew) {
  TemporaryFolder folder;
  Program(folder.path).run();
  std::vector<std::string> files = filesIn(folder.path);
  ASSERT_GE(files.size(), 2u);
  for (const std::string &file : files) {
    auto buffer = llvm::MemoryBuffer::getFile(file);
    ASSERT_TRUE(static_cast<bool>(buffer));
    std::string bytes = (*buffer)->getBuffer().str();
    bytes[bytes.size() / 2] ^= 0x40;
    std::error_code error;
    llvm::raw_fd_ostream stream(file, error);
    stream << bytes;
  }
  testing::internal::CaptureStderr();
  Program second(folder.path);
  EXPECT_EQ(second.run(), std::make_pair(36.0, 6.0));
  EXPECT_EQ(second.hits(), 0u);
  std::string warned = testing::internal::GetCapturedStderr();
  // One warning, however many entries.
  EXPECT_NE(warned.find("cache"), std::string::npos) << warned;
  EXPECT_EQ(std::count(warned.begin(), warned.end(), '\n'), 1) << warned;
  // The entries are whole again.
  Program third(folder.path);
  EXPECT_EQ(third.run(), std::make_pair(36.0, 6.0));
  EXPECT_EQ(third.hits(), 2u);
}

TEST(EngineCache, FailuresAreNotKept) {
  TemporaryFolder folder;
  {
    Context context;
    context.set("cache_dir", folder.path.c_str());
    context.addFields();
    // A function that is declared and nowhere defined cannot be linked.
    TaiKernel kernel = nullptr;
    context.ok(context.create("k", R"(
      func.func private @tai_no_such_function()
      tai.kernel @k() {
        func.call @tai_no_such_function() : () -> ()
        tai.return
      })",
                              kernel));
    EXPECT_NE(taiKernelLaunch(kernel, nullptr, 0, nullptr), TAI_OK);
    EXPECT_FALSE(context.message().empty());
  }
  EXPECT_TRUE(filesIn(folder.path).empty());
}

TEST(EngineCache, ObjectsSurviveSerialization) {
  CompiledObject object;
  object.symbol = "k";
  object.code = {'a', '\0', 'b'};
  object.needs = "n";
  object.skipped[1] = 7;
  object.loopLevels = {0, 2};
  object.trees = {"t", ""};
  std::string bytes = object.serialize();
  std::optional<CompiledObject> read = CompiledObject::deserialize(bytes);
  ASSERT_TRUE(read);
  EXPECT_EQ(read->symbol, object.symbol);
  EXPECT_EQ(read->code, object.code);
  EXPECT_EQ(read->needs, object.needs);
  EXPECT_EQ(read->skipped, object.skipped);
  EXPECT_EQ(read->loopLevels, object.loopLevels);
  EXPECT_EQ(read->trees, object.trees);
  for (size_t length = 0; length < bytes.size(); ++length) {
    std::optional<CompiledObject> cut =
        CompiledObject::deserialize(llvm::StringRef(bytes).take_front(length));
    // Cut at the end of a tree, the bytes are those of an object with fewer.
    if (cut)
      EXPECT_LT(cut->trees.size(), object.trees.size());
  }
}

} // namespace
