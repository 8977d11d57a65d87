//===- Session.cpp - A context in which programs run ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The context itself and its options. Trees and fields are in
// SessionFields.cpp, kernels in SessionKernels.cpp.
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Session.h"
#include "tai/ExecutionEngine/Explain.h"
#include "tai/InitAll.h"
#include "tai/Pipelines/Pipelines.h"
#include "tai/Runtime/Device/DeviceHeap.h"
#include "llvm/Support/FormatVariadic.h"
#include "llvm/Support/Path.h"
#include "llvm/Support/Process.h"
#include "llvm/Support/ThreadPool.h"
#include <dlfcn.h>
#include <thread>

using namespace mlir;
using namespace mlir::tai;

namespace {
/// Runs each task where it is submitted. With a pool set, MLIR locks what
/// threads share, which compiling on several threads needs; passes themselves
/// stay on the thread that runs them, for kernels are too small to split.
class InlineThreadPool : public llvm::ThreadPoolInterface {
  void asyncEnqueue(llvm::unique_function<void()> task,
                    llvm::ThreadPoolTaskGroup *) override {
    task();
  }

public:
  void wait() override {}
  void wait(llvm::ThreadPoolTaskGroup &) override {}
  unsigned getMaxConcurrency() const override { return 1; }
};
} // namespace

/// The pipelines of tai for the options of a kernel.
static Compiler::Pipelines getPipelines() {
  Compiler::Pipelines pipelines;
  pipelines.autodiff = [](OpPassManager &manager, const CompileOptions &options,
                          bool takes) {
    AutodiffOptions autodiff;
    autodiff.takes = takes;
    autodiff.storedOutputs = true;
    // An adjoint is launched with the arguments of its primal and no others.
    autodiff.arrayAdjoints = false;
    autodiff.historyBytes = options.historyBytes;
    autodiff.deterministic = options.deterministic;
    autodiff.skip = options.skips;
    buildAutodiffPipeline(manager, autodiff);
  };
  pipelines.forward = [](OpPassManager &manager, const CompileOptions &) {
    // A copy is launched with the arguments of its primal and no others.
    buildForwardPipeline(manager, /*arrayTangents=*/false);
  };
  pipelines.toLLVM = [](OpPassManager &manager, const CompileOptions &options) {
    ToLLVMOptions lowering;
    lowering.deterministic = options.deterministic;
    lowering.debug = options.debug;
    lowering.bounds = options.bounds;
    lowering.fastMath = options.codegen.fastMath;
    lowering.contract = options.codegen.contract;
    lowering.optLevel = options.codegen.optLevel;
    lowering.skip = options.skips;
    // Kernels are known by their names already.
    lowering.fuseLaunches = false;
    buildToLLVMPasses(manager, lowering);
  };
  pipelines.toDevice = [](OpPassManager &manager,
                          const CompileOptions &options) {
    ToNVVMOptions lowering;
    lowering.deterministic = options.deterministic;
    lowering.debug = options.debug;
    lowering.bounds = options.bounds;
    lowering.fastMath = options.codegen.fastMath;
    lowering.contract = options.codegen.contract;
    lowering.optLevel = options.codegen.optLevel;
    lowering.skip = options.skips;
    // Kernels are known by their names already.
    lowering.fuseLaunches = false;
    lowering.emulated = options.device == runtime::DeviceKind::Emulated;
    buildToNVVMPasses(manager, lowering);
  };
  pipelines.scfPass = "convert-tai-to-scf";
  pipelines.deviceScfPass = "convert-tai-to-gpu";
  return pipelines;
}

Session::Session()
    : pool(std::make_unique<InlineThreadPool>()),
      // One core is busy with the program.
      background(std::max(1u, std::thread::hardware_concurrency()) - 1) {
  DialectRegistry registry;
  registerAll(registry);
  registerDeviceTranslations(registry);
  context =
      std::make_unique<MLIRContext>(registry, MLIRContext::Threading::DISABLED);
  context->setThreadPool(*pool);
  context->printOpOnDiagnostic(false);
  // Threads may not load dialects, so all that can be needed are there first.
  context->loadAllAvailableDialects();
  RemarkScope::prepare(context.get());
  rt = std::make_unique<runtime::Runtime>();
  compiler = std::make_unique<Compiler>(context.get(), getPipelines(),
                                        runtime::runtimeSymbols());
  compiler->loadDialects();
  declarations = ModuleOp::create(UnknownLoc::get(context.get()));
  symbols.emplace(*declarations);
  printsProfile = llvm::sys::Process::GetEnv("TAI_COMPILE_PROFILE").has_value();
  if (std::optional<std::string> folder =
          llvm::sys::Process::GetEnv("TAI_CACHE_DIR")) {
    useCache(*folder);
    return;
  }
  SmallString<128> folder;
  if (llvm::sys::path::cache_directory(folder)) {
    llvm::sys::path::append(folder, "tai");
    useCache(folder);
  }
}

// A job may use any part of it.
Session::~Session() { background.stop(); }

SessionObjects Session::countObjects() {
  SessionObjects held;
  held.trees = rt->numTrees();
  held.fields = static_cast<int64_t>(rt->fields().size());
  held.declarations =
      llvm::range_size(declarations->getBody()->getOperations());
  held.kernels = rt->numKernels();
  held.codes = codeNames.size();
  held.linked = compiler->numLinked();
  std::lock_guard<std::mutex> lock(mutex);
  held.failures = static_cast<int64_t>(compileFailures.size());
  return held;
}

//===----------------------------------------------------------------------===//
// Failures
//===----------------------------------------------------------------------===//

/// What each thread failed at last. Of another session, it is of no use.
static thread_local Failure lastFailure;
static thread_local const Session *lastFailed = nullptr;

LogicalResult Session::fail(Failure failure) {
  lastFailure = std::move(failure);
  lastFailed = this;
  return mlir::failure();
}

const Failure &Session::getFailure() const {
  static const Failure none;
  return lastFailed == this ? lastFailure : none;
}

LogicalResult Session::fail(FailureKind kind, const Twine &message) {
  return fail(Failure::get(kind, message));
}

runtime::Status Session::keepFailure(Failure failure) {
  std::lock_guard<std::mutex> lock(mutex);
  std::string where;
  if (!failure.file.empty())
    where = llvm::formatv("{0}:{1}:{2}", failure.file, failure.line,
                          failure.column);
  auto status = runtime::Status::failure(
      runtime::StatusCode::Compile, failure.message, where,
      static_cast<int>(failuresBefore + compileFailures.size()) + 1);
  compileFailures.push_back(std::move(failure));
  // Those of old are told by their status alone.
  constexpr size_t mostFailures = 1024;
  if (compileFailures.size() > mostFailures) {
    compileFailures.pop_front();
    ++failuresBefore;
  }
  return status;
}

static FailureKind getKind(runtime::StatusCode code) {
  switch (code) {
  case runtime::StatusCode::Memory:
    return FailureKind::Memory;
  case runtime::StatusCode::Usage:
    return FailureKind::Usage;
  case runtime::StatusCode::Compile:
  case runtime::StatusCode::Internal:
    return FailureKind::Internal;
  default:
    return FailureKind::Runtime;
  }
}

LogicalResult Session::fail(const runtime::Status &status) {
  size_t number = status.detail();
  if (status.code() == runtime::StatusCode::Compile && number > 0) {
    std::lock_guard<std::mutex> lock(mutex);
    if (number > failuresBefore &&
        number - failuresBefore <= compileFailures.size())
      return fail(compileFailures[number - failuresBefore - 1]);
  }
  Failure failure = Failure::get(getKind(status.code()), status.message());
  // "file:line:col", where the file may hold colons of its own.
  StringRef place = status.where();
  auto [head, column] = place.rsplit(':');
  auto [file, line] = head.rsplit(':');
  if (!line.getAsInteger(10, failure.line) &&
      !column.getAsInteger(10, failure.column)) {
    failure.file = file.str();
    failure.text = formatDiagnostic(failure.file, failure.line, failure.column,
                                    "error", failure.message);
  }
  return fail(std::move(failure));
}

//===----------------------------------------------------------------------===//
// Options
//===----------------------------------------------------------------------===//

void Session::useCache(StringRef folder) {
  rt->keepBlockSizes({});
  if (folder.empty()) {
    cache.reset();
    compiler->setCache({});
    return;
  }
  cache = std::make_shared<runtime::CacheStore>(folder.str());
  if (!cache->usable())
    return compiler->setCache({});
  auto store = cache;
  compiler->setCache(
      {[store](StringRef key) { return store->get(std::string_view(key)); },
       [store](StringRef key, StringRef bytes) {
         store->put(std::string_view(key), std::string_view(bytes));
       },
       [store](StringRef key, const std::function<bool()> &goesOn) {
         constexpr double mostSeconds = 60;
         return store->claim(std::string_view(key), mostSeconds, goesOn);
       }});
  rt->keepBlockSizes(
      {[store](const std::string &key) { return store->get(key); },
       [this, store](std::string key, std::string bytes) {
         background.doLater(
             [store, key = std::move(key), bytes = std::move(bytes)] {
               store->put(key, bytes);
             });
       }});
}

static std::optional<bool> parseBool(StringRef text) {
  return llvm::StringSwitch<std::optional<bool>>(text)
      .Cases({"true", "1", "on"}, true)
      .Cases({"false", "0", "off"}, false)
      .Default(std::nullopt);
}

LogicalResult Session::setOption(StringRef name, StringRef value) {
  auto badValue = [&](StringRef expected) {
    return fail(FailureKind::Usage, "option '" + name + "' expects " +
                                        expected + ", but got '" + value + "'");
  };
  auto setBool = [&](function_ref<void(bool)> set) -> LogicalResult {
    std::optional<bool> parsed = parseBool(value);
    if (!parsed)
      return badValue("true or false");
    set(*parsed);
    return success();
  };
  if (name == "deterministic")
    return setBool([&](bool on) {
      options.deterministic = on;
      // Loops are cut differently for other numbers of threads, and what is
      // fused may depend on where a vectorised loop ends.
      options.codegen.contract = !on;
      rt->setDeterministic(on);
    });
  if (name == "debug")
    return setBool([&](bool on) {
      options.debug = on;
      rt->setDebug(on);
    });
  if (name == "bounds") {
    auto mode = llvm::StringSwitch<std::optional<BoundsMode>>(value)
                    .Case("off", BoundsMode::Off)
                    .Case("clamp", BoundsMode::Clamp)
                    .Case("check", BoundsMode::Check)
                    .Default(std::nullopt);
    if (!mode)
      return badValue("off, clamp or check");
    options.bounds = *mode;
    return success();
  }
  if (name == "fast_math")
    return setBool([&](bool on) { options.codegen.fastMath = on; });
  if (name == "sanitize") {
    if (!value.empty() && value != "address")
      return badValue("\"address\" or nothing");
    if (!value.empty() && !dlsym(RTLD_DEFAULT, "__asan_init"))
      return fail(FailureKind::Usage,
                  "option 'sanitize': the process has no run time of "
                  "AddressSanitizer; start it with LD_PRELOAD=$(clang-22 "
                  "-print-file-name=libclang_rt.asan-x86_64.so) "
                  "ASAN_OPTIONS=detect_leaks=0");
    options.codegen.sanitizeAddress = !value.empty();
    return success();
  }
  if (name == "profiler")
    return setBool([&](bool on) {
      rt->setProfiler(on);
      options.places = rt->wantsPlaces();
    });
  if (name == "forward_mode")
    return setBool([&](bool on) { rt->setForward(on); });
  if (name == "compile_profile")
    return setBool([&](bool on) { printsProfile = on; });
  if (name == "threads") {
    int threads;
    if (value.getAsInteger(10, threads) || threads < 0)
      return badValue("a number of threads, or 0 for all");
    rt->setThreads(threads);
    return success();
  }
  if (name == "opt_level") {
    unsigned level;
    if (value.getAsInteger(10, level) || level > 3)
      return badValue("a number from 0 to 3");
    options.codegen.optLevel = level;
    return success();
  }
  if (name == "history_bytes") {
    int64_t bytes;
    if (value.getAsInteger(10, bytes) || bytes < 0)
      return badValue("a number of bytes");
    options.historyBytes = bytes;
    return success();
  }
  if (name == "skip") {
    SkipSet skips;
    std::string error;
    if (!SkipSet::parse(value, skips, error))
      return fail(FailureKind::Usage, "option 'skip': " + error);
    options.skips = skips & SkipSet::ofCompiler();
    rt->setSkips(skips);
    return success();
  }
  if (name == "memory_limit") {
    int64_t bytes;
    if (value.getAsInteger(10, bytes) || bytes < 0)
      return badValue("a number of bytes, or 0");
    rt->setMemoryLimit(bytes);
    return success();
  }
  if (name == "arch")
    return setArch(value);
  if (name == "device_heap") {
    int64_t bytes;
    if (value.getAsInteger(10, bytes) || bytes < 0)
      return badValue("a number of bytes, or 0 for what suits the device");
    runtime::setDeviceHeapBytes(bytes);
    return success();
  }
  if (name == "device_memory_limit") {
    if (value.getAsInteger(10, deviceMemoryLimit) || deviceMemoryLimit < 0)
      return badValue("a number of bytes, or 0");
    return success();
  }
  if (name == "block_dim" || name == "max_block_dim") {
    int threads;
    if (value.getAsInteger(10, threads) || threads < 0 || threads % 32 != 0)
      return badValue("a multiple of 32, or 0");
    if (name == "block_dim")
      rt->setBlockThreads(threads);
    else
      rt->setMostBlockThreads(threads);
    return success();
  }
  if (name == "fuse_launches")
    return setBool([&](bool on) { setFuseLaunches(on); });
  if (name == "order_seed") {
    if (value.getAsInteger(0, options.orderSeed))
      return badValue("a number from 0 to 2^64 - 1");
    return success();
  }
  if (name == "seed") {
    uint64_t seed;
    if (value.getAsInteger(0, seed))
      return badValue("a number from 0 to 2^64 - 1");
    rt->setSeed(seed);
    return success();
  }
  if (name == "cache_dir") {
    useCache(value);
    return success();
  }
  if (name == "print_ir") {
    SmallVector<std::string> stages;
    SmallVector<StringRef> parts;
    value.split(parts, ',', -1, /*KeepEmpty=*/false);
    for (StringRef part : parts) {
      part = part.trim();
      if (part == "all") {
        for (StringRef stage : Compiler::getStages())
          stages.push_back(stage.str());
        continue;
      }
      if (!llvm::is_contained(Compiler::getStages(), part))
        return badValue("\"all\" or some of " +
                        llvm::join(Compiler::getStages(), ", "));
      stages.push_back(part.str());
    }
    printedStages = std::move(stages);
    return success();
  }
  return fail(FailureKind::Usage,
              "unknown option '" + name +
                  "'; the options are threads, deterministic, debug, "
                  "bounds, fast_math, sanitize, opt_level, seed, cache_dir, "
                  "print_ir, profiler, "
                  "compile_profile, forward_mode, history_bytes, skip, "
                  "memory_limit, arch, device_memory_limit, block_dim, "
                  "max_block_dim, fuse_launches, order_seed");
}
