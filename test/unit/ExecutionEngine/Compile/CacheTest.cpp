//===- CacheTest.cpp - Compiled code between contexts ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "../../../../lib/ExecutionEngine/Compile/BuildId.h"
#include "../../Utils/EngineTestUtil.h"
#include "mlir/IR/Verifier.h"
#include "mlir/Parser/Parser.h"
#include "tai/CodeGen/CompiledObject.h"
#include "tai/ExecutionEngine/Session/Session.h"
#include "tai/Runtime/Cache/CacheStore.h"
#include "tai/Runtime/Tape/Tape.h"
#include "llvm/Object/BuildID.h"
#include "llvm/Object/ObjectFile.h"
#include "llvm/Support/Endian.h"
#include "llvm/Support/MemoryBuffer.h"
#include "llvm/Support/Process.h"
#include "llvm/Support/raw_ostream.h"
#include "llvm/TargetParser/Host.h"
#include <dlfcn.h>
#include <sys/wait.h>
#include <unistd.h>

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

/// A context that caches code in a folder, with the sum of squares as kernel.
struct Program {
  explicit Program(llvm::StringRef folder, const std::string &factor = "1.0",
                   const char *arch = "cpu") {
    EXPECT_TRUE(succeeded(session.setOption("cache_dir", folder)));
    EXPECT_TRUE(succeeded(session.setOption("arch", arch)));
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

  /// Returns y and its gradient with respect to x[2], for x = 3.
  std::pair<double, double> run() {
    runtime::Runtime &rt = session.getRuntime();
    EXPECT_TRUE(rt.writes().fillF64(*rt.store().findField("x"), 3).ok());
    EXPECT_TRUE(rt.writes().fillF64(*rt.store().findField("y"), 0).ok());
    std::unique_ptr<runtime::Tape> tape;
    EXPECT_TRUE(rt.beginTape(rt.store().findField("y"), true, tape).ok());
    EXPECT_TRUE(succeeded(session.launch(*kernel, nullptr, 0, nullptr)))
        << session.getFailure().text;
    EXPECT_TRUE(tape->backward().ok());
    double y = 0, g = 0;
    int64_t index = 2;
    EXPECT_TRUE(rt.store().findField("y")->readF64(nullptr, 0, y).ok());
    EXPECT_TRUE(rt.store().findField("gx")->readF64(&index, 0, g).ok());
    return {y, g};
  }

  unsigned hits() {
    unsigned count = 0;
    for (const Compiler::Function &function : kernel->code->getFunctions())
      count += function.fromCache;
    return count;
  }

  Session session;
  OwningOpRef<ModuleOp> module;
  SessionKernel *kernel = nullptr;
};

/// The file names of the entries in a cache.
std::vector<std::string> filesIn(llvm::StringRef folder) {
  std::vector<std::string> files;
  std::error_code error;
  for (llvm::sys::fs::recursive_directory_iterator i(folder, error), end;
       i != end && !error; i.increment(error))
    if (llvm::StringRef(i->path()).ends_with(".tai"))
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
  // An option applies to kernels that are created afterwards.
  Program debug(folder.path);
  EXPECT_TRUE(succeeded(debug.session.setOption("debug", "true")));
  auto again = debug.session.createKernel(
      debug.kernel->code->getModule().clone(), "squares");
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
  // One warning, however many entries are damaged.
  EXPECT_NE(warned.find("cache"), std::string::npos) << warned;
  EXPECT_EQ(llvm::count(warned, '\n'), 1) << warned;
  // The entries have been replaced by intact ones.
  Program third(folder.path);
  EXPECT_EQ(third.run(), std::make_pair(36.0, 6.0));
  EXPECT_EQ(third.hits(), 2u);
}

/// Replaces the object in each entry of a folder.
void replaceObjects(llvm::StringRef folder,
                    llvm::function_ref<void(CompiledObject &)> change) {
  runtime::CacheStore store(folder.str());
  for (const std::string &file : filesIn(folder)) {
    auto buffer = llvm::MemoryBuffer::getFile(file);
    ASSERT_TRUE(static_cast<bool>(buffer));
    // An entry has a header of 40 bytes, with the size of the key at 16, and
    // the key.
    llvm::StringRef bytes = (*buffer)->getBuffer();
    uint64_t size = llvm::support::endian::read64le(bytes.data() + 16);
    std::string key = bytes.substr(40, size).str();
    auto object = CompiledObject::deserialize(bytes.drop_front(40 + size));
    ASSERT_TRUE(object);
    change(*object);
    ASSERT_TRUE(store.put(key, object->serialize()));
  }
}

// The entries are intact, but this process cannot link their objects.
TEST(EngineCache, ObjectsThatDoNotLinkAreCompiledAnew) {
  TemporaryFolder folder;
  Program(folder.path).run();
  auto expectAnew = [&](llvm::function_ref<void(CompiledObject &)> change) {
    replaceObjects(folder.path, change);
    Program second(folder.path);
    EXPECT_EQ(second.run(), std::make_pair(36.0, 6.0));
    EXPECT_EQ(second.hits(), 0u);
    // The new entry can be linked.
    Program third(folder.path);
    EXPECT_EQ(third.run(), std::make_pair(36.0, 6.0));
    EXPECT_EQ(third.hits(), 2u);
  };
  expectAnew([](CompiledObject &object) { object.symbol += "_of_another"; });
  expectAnew([](CompiledObject &object) { object.code.assign(100, 'x'); });
  expectAnew([](CompiledObject &object) {
    object.code.truncate(object.code.size() / 2);
  });
}

// The entries are intact, but the device rejects their code.
TEST(EngineCache, ImagesThatAreRefusedAreCompiledAnew) {
  std::optional<std::string> before =
      llvm::sys::Process::GetEnv("TAI_CUDA_EMULATION");
  setenv("TAI_CUDA_EMULATION", "1", 1);
  TemporaryFolder folder;
  Program(folder.path, "1.0", "cuda").run();
  auto expectAnew = [&](llvm::function_ref<void(std::string &)> change) {
    std::vector<std::string> good;
    replaceObjects(folder.path, [&](CompiledObject &object) {
      ASSERT_TRUE(object.image);
      good.push_back(object.image->bytes);
      change(object.image->bytes);
    });
    for (int round = 0; round < 2; ++round) {
      Program next(folder.path, "1.0", "cuda");
      EXPECT_EQ(next.run(), std::make_pair(36.0, 6.0));
      EXPECT_EQ(next.hits(), 2u);
    }
    // The entries have their original contents again.
    replaceObjects(folder.path, [&](CompiledObject &object) {
      EXPECT_TRUE(llvm::is_contained(good, object.image->bytes));
    });
  };
  expectAnew([](std::string &image) { image.assign(100, 'x'); });
  expectAnew([](std::string &image) { image.resize(image.size() / 2); });
  // An entry whose code is accepted, but contains other functions.
  std::string other;
  replaceObjects(folder.path, [&](CompiledObject &object) {
    std::swap(object.image->bytes, other);
  });
  replaceObjects(folder.path, [&](CompiledObject &object) {
    if (object.image->bytes.empty())
      object.image->bytes = other;
  });
  expectAnew([](std::string &) {});
  if (before)
    setenv("TAI_CUDA_EMULATION", before->c_str(), 1);
  else
    unsetenv("TAI_CUDA_EMULATION");
}

/// The next test runs this in separate processes.
TEST(EngineCache, DISABLED_Child) {
  const char *folder = std::getenv("TAI_TEST_CACHE");
  ASSERT_TRUE(folder);
  Program program(folder);
  bool good = program.run() == std::make_pair(36.0, 6.0);
  _exit(good ? 10 + static_cast<int>(program.hits()) : 1);
}

// Processes start together with an empty cache: each object is compiled once,
// and the other processes load it.
TEST(EngineCache, ProcessesShareTheWork) {
  TemporaryFolder folder;
  setenv("TAI_TEST_CACHE", folder.path.c_str(), 1);
  std::vector<pid_t> children;
  for (int i = 0; i < 4; ++i) {
    pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      execl("/proc/self/exe", "tai-unit-tests",
            "--gtest_filter=EngineCache.DISABLED_Child",
            "--gtest_also_run_disabled_tests", nullptr);
      _exit(2);
    }
    children.push_back(child);
  }
  unsetenv("TAI_TEST_CACHE");
  int hits = 0;
  for (pid_t child : children) {
    int status = 0;
    waitpid(child, &status, 0);
    ASSERT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) >= 10);
    hits += WEXITSTATUS(status) - 10;
  }
  // Four processes need a kernel and its adjoint, each of which one process
  // compiles.
  EXPECT_EQ(hits, 6);
}

/// The build id in the file of the library that contains an address.
std::string readBuildId(const void *address) {
  Dl_info info;
  if (!dladdr(address, &info))
    return "nowhere";
  auto file = llvm::object::ObjectFile::createObjectFile(info.dli_fname);
  if (!file) {
    llvm::consumeError(file.takeError());
    return "no file";
  }
  return llvm::toHex(llvm::object::getBuildID(file->getBinary()),
                     /*LowerCase=*/true);
}

// The key depends on each library that takes part, whatever the name and the
// time of its file.
TEST(EngineCache, KeysNameTheLibraries) {
  MLIRContext context;
  std::string id = getBuildId(&context);
  for (const void *address :
       {reinterpret_cast<const void *>(&getBuildId),
        reinterpret_cast<const void *>(&mlir::verify),
        reinterpret_cast<const void *>(&llvm::sys::getProcessTriple)}) {
    std::string expected = readBuildId(address);
    EXPECT_GE(expected.size(), 16u) << expected;
    EXPECT_NE(id.find(expected), std::string::npos) << id;
  }
  EXPECT_EQ(id, getBuildId(&context));
  // The C library does not affect the code.
  EXPECT_EQ(id.find(readBuildId(reinterpret_cast<const void *>(&getenv))),
            std::string::npos);
}

TEST(EngineCache, FailuresAreNotKept) {
  TemporaryFolder folder;
  {
    Context context;
    context.set("cache_dir", folder.path.c_str());
    context.addFields();
    // A function that is declared but not defined cannot be linked.
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
  object.toBeRecorded = "n";
  object.skipped[1] = 7;
  object.loopLevels = {0, 2};
  object.trees = {"t", ""};
  std::string bytes = object.serialize();
  std::optional<CompiledObject> read = CompiledObject::deserialize(bytes);
  ASSERT_TRUE(read);
  EXPECT_EQ(read->symbol, object.symbol);
  EXPECT_EQ(read->code, object.code);
  EXPECT_EQ(read->toBeRecorded, object.toBeRecorded);
  EXPECT_EQ(read->skipped, object.skipped);
  EXPECT_EQ(read->loopLevels, object.loopLevels);
  EXPECT_EQ(read->trees, object.trees);
  for (size_t length = 0; length < bytes.size(); ++length) {
    std::optional<CompiledObject> cut =
        CompiledObject::deserialize(llvm::StringRef(bytes).take_front(length));
    // Cut at the end of a tree, the bytes represent an object with fewer trees.
    if (cut)
      EXPECT_LT(cut->trees.size(), object.trees.size());
  }
}

} // namespace
