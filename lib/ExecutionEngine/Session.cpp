//===- Session.cpp - A context in which programs run ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Options, kernels and running. Trees and fields are in SessionFields.cpp.
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Session.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/IR/Verifier.h"
#include "mlir/Parser/Parser.h"
#include "mlir/Target/LLVMIR/Dialect/Builtin/BuiltinToLLVMIRTranslation.h"
#include "mlir/Target/LLVMIR/Dialect/LLVMIR/LLVMToLLVMIRTranslation.h"
#include "tai/InitAll.h"
#include "tai/Pipelines/Pipelines.h"
#include "llvm/ADT/SetVector.h"
#include "llvm/Support/FormatVariadic.h"
#include "llvm/Support/Path.h"
#include "llvm/Support/Process.h"
#include "llvm/Support/ThreadPool.h"
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
  pipelines.autodiff = [](OpPassManager &manager, const CompileOptions &) {
    AutodiffOptions autodiff;
    // An adjoint is launched with the arguments of its primal and no others.
    autodiff.arrayAdjoints = false;
    buildAutodiffPipeline(manager, autodiff);
  };
  pipelines.toLLVM = [](OpPassManager &manager, const CompileOptions &options) {
    ToLLVMOptions lowering;
    lowering.deterministic = options.deterministic;
    lowering.debug = options.debug;
    lowering.boundsCheck = options.debug;
    lowering.fastMath = options.codegen.fastMath;
    lowering.contract = options.codegen.contract;
    lowering.optLevel = options.codegen.optLevel;
    buildToLLVMPipeline(manager, lowering);
  };
  pipelines.scfPass = "convert-tai-to-scf";
  return pipelines;
}

Session::Session() : pool(std::make_unique<InlineThreadPool>()) {
  DialectRegistry registry;
  registerAll(registry);
  registerBuiltinDialectTranslation(registry);
  registerLLVMDialectTranslation(registry);
  context =
      std::make_unique<MLIRContext>(registry, MLIRContext::Threading::DISABLED);
  context->setThreadPool(*pool);
  context->printOpOnDiagnostic(false);
  // Threads may not load dialects, so all that can be needed are there first.
  context->loadAllAvailableDialects();
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

Session::~Session() = default;

//===----------------------------------------------------------------------===//
// Failures
//===----------------------------------------------------------------------===//

LogicalResult Session::fail(Failure failure) {
  lastFailure = std::move(failure);
  return mlir::failure();
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
      static_cast<int>(compileFailures.size()) + 1);
  compileFailures.push_back(std::move(failure));
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
    if (number <= compileFailures.size())
      return fail(compileFailures[number - 1]);
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
  if (name == "fast_math")
    return setBool([&](bool on) { options.codegen.fastMath = on; });
  if (name == "profiler")
    return setBool([&](bool on) { rt->setProfiler(on); });
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
                  "fast_math, opt_level, seed, cache_dir, print_ir, profiler, "
                  "compile_profile");
}

//===----------------------------------------------------------------------===//
// Kernels
//===----------------------------------------------------------------------===//

/// Slots of a value of the type; see Abi.h.
static int64_t countSlots(Type type) {
  if (auto vector = dyn_cast<VectorType>(type))
    return vector.getNumElements();
  if (auto memref = dyn_cast<MemRefType>(type))
    return 1 + memref.getRank();
  return 1;
}

static int64_t countSlots(TypeRange types) {
  int64_t slots = 0;
  for (Type type : types)
    slots += countSlots(type);
  return slots;
}

FailureOr<SessionKernel *> Session::createKernel(OwningOpRef<ModuleOp> module,
                                                 StringRef name) {
  auto op = module->lookupSymbol<KernelOp>(name);
  if (!op)
    return fail(FailureKind::Usage,
                "the module holds no kernel of the name '" + name + "'");
  if (failed(declareUsed(*module)) || failed(verifyModule(*module)))
    return failure();

  auto kernel = std::make_unique<SessionKernel>();
  kernel->code = std::make_shared<KernelCode>(*compiler, name, options);
  runtime::KernelInfo info;
  info.name = kernel->code->name;
  info.argSlots = countSlots(op.getArgumentTypes());
  info.resultSlots = countSlots(op.getResultTypes());
  info.summary = summarize(*module);
  SmallVector<std::string> trees;
  for (TreeOp tree : module->getOps<TreeOp>())
    trees.push_back(tree.getSymName().str());
  info.trees = findTrees(trees);
  info.resolve = [this, code = kernel->code](runtime::Kernel &runtimeKernel,
                                             TaiKernelFn &function) {
    return compilePrimal(*code, runtimeKernel, function);
  };
  info.makeAdjoint = [this, code = kernel->code](runtime::Kernel &runtimeKernel,
                                                 runtime::KernelPtr &adjoint) {
    return compileAdjoint(*code, runtimeKernel, adjoint);
  };
  kernel->code->module = std::move(module);
  kernel->kernel = rt->createKernel(std::move(info));
  kernels.push_back(std::move(kernel));
  return kernels.back().get();
}

FailureOr<SessionKernel *> Session::parseKernel(StringRef text, StringRef file,
                                                StringRef name) {
  OwningOpRef<ModuleOp> module;
  {
    DiagnosticCollector collector(context.get());
    // Verified once it has the declarations that it refers to.
    ParserConfig config(context.get(), /*verifyAfterParse=*/false);
    module = parseSourceString<ModuleOp>(text, config, file);
    if (!module)
      return fail(
          collector.take(FailureKind::Syntax, "the kernel does not parse"));
  }
  return createKernel(std::move(module), name);
}

KernelCode::~KernelCode() {
  for (const Compiler::Function &function : functions)
    compiler.unload(function);
}

void Session::destroyKernel(SessionKernel *kernel) {
  llvm::erase_if(kernels,
                 [&](const auto &owned) { return owned.get() == kernel; });
}

SessionKernel *Session::findKernel(StringRef name) const {
  for (const auto &kernel : kernels)
    if (kernel->code->name == name)
      return kernel.get();
  return nullptr;
}

std::vector<runtime::TreePtr> Session::findTrees(ArrayRef<std::string> names) {
  std::vector<runtime::TreePtr> trees;
  for (const std::string &name : names)
    trees.push_back(rt->findTree(name));
  return trees;
}

void Session::printStages(KernelCode &code, CompileRequest::Goal goal) {
  bool isAdjoint = goal == CompileRequest::Goal::Adjoint;
  for (const std::string &stage : printedStages) {
    if (isAdjoint && stage == "tai")
      continue;
    // The primal is compiled without differentiation.
    if (!isAdjoint && stage == "autodiff")
      continue;
    Failure failure;
    std::optional<std::string> text = compiler->print(
        {*code.module, code.name, goal}, stage, code.options, failure);
    std::lock_guard<std::mutex> lock(mutex);
    llvm::errs() << "// -----// " << stage << " of "
                 << (isAdjoint ? "the adjoint of " : "") << code.name
                 << " //----- //\n"
                 << (text ? *text : failure.text) << "\n";
  }
}

void Session::printProfile(StringRef name, CompileRequest::Goal goal,
                           const Compiler::Function &function) {
  std::lock_guard<std::mutex> lock(mutex);
  llvm::errs() << llvm::formatv(
      "{0,-32} {1,-8} {2,-5}", name,
      goal == CompileRequest::Goal::Adjoint ? "adjoint" : "primal",
      function.fromCache ? "hit" : "miss");
  for (unsigned i = 0; i < kNumPhases; ++i)
    llvm::errs() << llvm::formatv(" {0} {1,7:F2} ms",
                                  stringifyPhase(static_cast<Phase>(i)),
                                  function.times[i] * 1e3);
  llvm::errs() << "\n";
}

std::optional<Compiler::Function> Session::compileAs(KernelCode &code,
                                                     CompileRequest::Goal goal,
                                                     Failure &failure) {
  if (!printedStages.empty())
    printStages(code, goal);
  auto function =
      compiler->compile({*code.module, code.name, goal}, code.options, failure);
  if (!function)
    return std::nullopt;
  if (printsProfile)
    printProfile(code.name, goal, *function);
  code.functions.push_back(*function);
  return function;
}

runtime::Status Session::compilePrimal(KernelCode &code,
                                       runtime::Kernel &runtimeKernel,
                                       TaiKernelFn &function) {
  Failure failure;
  auto compiled = compileAs(code, CompileRequest::Goal::Primal, failure);
  if (!compiled)
    return keepFailure(std::move(failure));
  std::vector<runtime::TreePtr> trees = findTrees(compiled->trees);
  for (size_t i = 0; i < trees.size(); ++i)
    if (!trees[i])
      return runtime::Status::failure(runtime::StatusCode::Usage,
                                      "kernel '" + code.name + "' uses tree '" +
                                          compiled->trees[i] +
                                          "', which has been destroyed");
  runtimeKernel.setTrees(std::move(trees));
  function = reinterpret_cast<TaiKernelFn>(compiled->address);
  return runtime::Status::success();
}

runtime::Status Session::compileAdjoint(KernelCode &code,
                                        runtime::Kernel &runtimeKernel,
                                        runtime::KernelPtr &adjoint) {
  Failure failure;
  auto compiled = compileAs(code, CompileRequest::Goal::Adjoint, failure);
  if (!compiled)
    return keepFailure(std::move(failure));
  if (!compiled->address)
    return runtime::Status::success();
  runtime::KernelInfo info;
  info.name = code.name + "_grad";
  info.argSlots = runtimeKernel.argSlots();
  info.trees = findTrees(compiled->trees);
  info.function = reinterpret_cast<TaiKernelFn>(compiled->address);
  adjoint = rt->createKernel(std::move(info));
  return runtime::Status::success();
}

//===----------------------------------------------------------------------===//
// Running
//===----------------------------------------------------------------------===//

LogicalResult Session::launchAdjoint(SessionKernel &kernel,
                                     const uint64_t *args, int64_t slots) {
  return check(rt->launchAdjoint(*kernel.kernel, args, slots));
}

/// Runs task(0) to task(count - 1) on as many threads as help.
static void runInParallel(size_t count, function_ref<void(size_t)> task) {
  std::atomic<size_t> next{0};
  auto work = [&] {
    for (size_t i = next++; i < count; i = next++)
      task(i);
  };
  size_t helpers = std::min<size_t>(
      count, std::max(1u, std::thread::hardware_concurrency()));
  std::vector<std::thread> threads;
  for (size_t i = 1; i < helpers; ++i)
    threads.emplace_back(work);
  work();
  for (std::thread &thread : threads)
    thread.join();
}

LogicalResult Session::compile(ArrayRef<SessionKernel *> kernels,
                               bool adjoints) {
  // All primals first: the adjoint of a kernel waits for its primal.
  size_t count = kernels.size() * (adjoints ? 2 : 1);
  std::vector<runtime::Status> statuses(count);
  runInParallel(count, [&](size_t i) {
    runtime::Kernel &kernel = *kernels[i % kernels.size()]->kernel;
    runtime::Kernel *adjoint = nullptr;
    statuses[i] =
        i < kernels.size() ? kernel.resolve() : kernel.resolveAdjoint(adjoint);
  });
  for (const runtime::Status &status : statuses)
    if (!status.ok())
      return fail(status);
  return success();
}

LogicalResult Session::prepareReverse(runtime::Tape &tape) {
  std::vector<runtime::Kernel *> needed = tape.pendingAdjoints();
  if (needed.size() < 2)
    return success();
  std::vector<runtime::Status> statuses(needed.size());
  runInParallel(needed.size(), [&](size_t i) {
    runtime::Kernel *adjoint = nullptr;
    statuses[i] = needed[i]->resolveAdjoint(adjoint);
  });
  for (const runtime::Status &status : statuses)
    if (!status.ok())
      return fail(status);
  return success();
}

/// Leaves nothing of the kernels but their signatures: the host reaches them
/// through the runtime.
static void stubKernels(ModuleOp module) {
  for (KernelOp kernel : module.getOps<KernelOp>()) {
    kernel.removeAdjointAttr();
    Block &block = kernel.getBody().front();
    block.dropAllReferences();
    block.getOperations().clear();
    OpBuilder builder = OpBuilder::atBlockEnd(&block);
    SmallVector<Value> zeros;
    for (Type type : kernel.getResultTypes())
      zeros.push_back(arith::ConstantOp::create(
          builder, kernel.getLoc(),
          cast<TypedAttr>(builder.getZeroAttr(type))));
    ReturnOp::create(builder, kernel.getLoc(), zeros);
  }
}

LogicalResult Session::runHost(ModuleOp module, StringRef name) {
  OwningOpRef<ModuleOp> host = module.clone();
  stubKernels(*host);
  Failure failure;
  auto compiled = compiler->compile({*host, name, CompileRequest::Goal::Primal},
                                    options, failure);
  if (!compiled)
    return fail(std::move(failure));
  if (printsProfile)
    printProfile(name, CompileRequest::Goal::Primal, *compiled);
  runtime::HostModule hostModule;
  hostModule.findKernel = [this](std::string_view kernelName) {
    SessionKernel *kernel = findKernel(kernelName);
    return kernel ? kernel->kernel.get() : nullptr;
  };
  LogicalResult result = check(
      rt->runHost(reinterpret_cast<TaiKernelFn>(compiled->address),
                  findTrees(compiled->trees), hostModule, nullptr, nullptr));
  compiler->unload(*compiled);
  return result;
}

FailureOr<std::string> Session::getIR(SessionKernel &kernel, StringRef stage) {
  Failure failure;
  CompileRequest::Goal goal = stage.consume_front("adjoint.")
                                  ? CompileRequest::Goal::Adjoint
                                  : CompileRequest::Goal::Primal;
  std::optional<std::string> text =
      compiler->print({*kernel.code->module, kernel.code->name, goal}, stage,
                      kernel.code->options, failure);
  if (!text)
    return fail(std::move(failure));
  return *text;
}
