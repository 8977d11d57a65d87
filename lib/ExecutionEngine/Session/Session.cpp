//===- Session.cpp - A context in which programs run ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The session and its calls. Options are in SessionOptions.cpp.
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Session/Session.h"
#include "HostPrograms.h"
#include "RunInParallel.h"
#include "tai/ExecutionEngine/Modules/ModuleFile.h"
#include "tai/ExecutionEngine/Reports/Explain.h"
#include "tai/InitAll.h"
#include "tai/Pipelines/Pipelines.h"
#include "tai/Runtime/Tape/HostProgram.h"
#include "tai/Runtime/Tape/Tape.h"
#include "llvm/Support/Path.h"
#include "llvm/Support/Process.h"
#include "llvm/Support/ThreadPool.h"
#include <thread>

using namespace mlir;
using namespace mlir::tai;

namespace {
/// Runs each task where it is submitted. With a pool, MLIR locks its shared
/// data, which compiling on several threads requires. Passes stay on the thread
/// that runs them, because kernels are too small to be split.
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

/// Sets the options of a kernel that the lowerings to the CPU and to a GPU
/// share.
static void setLowering(LoweringOptions &lowering,
                        const CompileOptions &options) {
#define TAI_LOWERING_OPTION(type, member, from, argument, initial, about)      \
  lowering.member = options.from;
#include "tai/Support/Options.def"
  // Kernels are already known to callers by name, so their launches are not
  // fused.
  lowering.fuseLaunches = false;
}

/// Returns the pass pipelines of the project, for the options of a kernel.
static Compiler::Pipelines getPipelines() {
  Compiler::Pipelines pipelines;
  pipelines.autodiff = [](OpPassManager &manager, const CompileOptions &options,
                          bool zeroes) {
    AutodiffOptions autodiff;
    autodiff.zeroOverwritten = zeroes;
    autodiff.storedOutputs = true;
    // An adjoint is launched with exactly the arguments of its primal.
    autodiff.arrayAdjoints = false;
#define TAI_AUTODIFF_OPTION(type, member, from, argument, initial, about)      \
  autodiff.member = options.from;
#include "tai/Support/Options.def"
    buildAutodiffPasses(manager, autodiff);
  };
  pipelines.forward = [](OpPassManager &manager, const CompileOptions &) {
    // A tangent is launched with exactly the arguments of its primal.
    buildForwardPipeline(manager, /*arrayTangents=*/false);
  };
  pipelines.toLLVM = [](OpPassManager &manager, const CompileOptions &options) {
    ToLLVMOptions lowering;
    setLowering(lowering, options);
    lowering.shadow = options.shadow;
    buildToLLVMPasses(manager, lowering);
  };
  pipelines.toDevice = [](OpPassManager &manager,
                          const CompileOptions &options) {
    ToNVVMOptions lowering;
    setLowering(lowering, options);
    lowering.emulated = options.device == runtime::DeviceKind::Emulated;
    buildToNVVMPasses(manager, lowering);
  };
  pipelines.scfPass = "convert-tai-to-scf";
  pipelines.deviceScfPass = "convert-tai-to-gpu";
  return pipelines;
}

Session::Session()
    : pool(std::make_unique<InlineThreadPool>()),
      // Background jobs use all cores except one, which is for the program.
      background(std::max(1u, std::thread::hardware_concurrency()) - 1) {
  DialectRegistry registry;
  registerAll(registry);
  registerDeviceTranslations(registry);
  context =
      std::make_unique<MLIRContext>(registry, MLIRContext::Threading::DISABLED);
  context->setThreadPool(*pool);
  context->printOpOnDiagnostic(false);
  // Threads must not load dialects, so all dialects that may be needed are
  // loaded now.
  context->loadAllAvailableDialects();
  RemarkScope::prepare(context.get());
  rt = std::make_unique<runtime::Runtime>();
  compileOptions.oneThread = rt->threads() == 1;
  compiler = std::make_unique<Compiler>(context.get(), getPipelines(),
                                        runtime::runtimeSymbols());
  compiler->loadDialects();
  declarations.emplace(context.get(), *rt, failures);
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

// Background jobs are stopped before any member is destroyed, because a job may
// use all of them.
Session::~Session() { background.stop(); }

SessionObjects Session::countObjects() {
  SessionObjects held;
  held.trees = rt->store().trees().size();
  held.fields = static_cast<int64_t>(rt->store().fields().size());
  held.declarations = declarations->size();
  held.kernels = rt->launcher().kernels().size();
  held.codes = codeNames.size();
  held.linked = compiler->numLinked();
  held.failures = failures.numKept();
  return held;
}

KernelServices Session::getServices() {
  return {*compiler,     background, codeNames, *rt,
          *declarations, failures,   reports,   warnings};
}

//===----------------------------------------------------------------------===//
// Kernels
//===----------------------------------------------------------------------===//

LogicalResult Session::compileEagerly(runtime::Kernel &kernel) {
  runtime::Kernel *adjoint = nullptr;
  runtime::Status status = kernel.resolve();
  if (!status.ok())
    return fail(status);
  // A missing adjoint is ignored here: it is an error only if a tape needs it.
  if (carriesGradients(kernel))
    (void)kernel.adjoint().resolve(adjoint);
  return success();
}

FailureOr<SessionKernel *> Session::createKernel(OwningOpRef<ModuleOp> module,
                                                 StringRef name) {
  modes.addTo(*module);
  auto made =
      makeKernel(getServices(), std::move(module), name, compileOptions, modes);
  if (failed(made))
    return failure();
  kernels.push_back({std::move(made->code), std::move(made->kernel)});
  SessionKernel &kernel = kernels.back();
  kernel.place = std::prev(kernels.end());
  rt->skipCounters().bump(SkipCount::KernelsDefined);
  if (!rt->skips(Skip::UnlaunchedKernels) &&
      failed(compileEagerly(*kernel.kernel)))
    return failure();
  return &kernel;
}

FailureOr<SessionKernel *> Session::parseKernel(StringRef bytes, StringRef file,
                                                StringRef name) {
  OwningOpRef<ModuleOp> module;
  {
    DiagnosticCollector collector(context.get());
    // The module is verified later, when it has the declarations that it refers
    // to.
    ParserConfig config(context.get(), /*verifyAfterParse=*/false);
    module = readModule(bytes, config, file);
    if (!module)
      return failures.fail(
          collector.take(FailureKind::Syntax, "the kernel does not parse"));
  }
  return createKernel(std::move(module), name);
}

SessionKernel *Session::findKernel(StringRef name) {
  for (SessionKernel &kernel : kernels)
    if (kernel.code->getName() == name)
      return &kernel;
  return nullptr;
}

//===----------------------------------------------------------------------===//
// Running
//===----------------------------------------------------------------------===//

LogicalResult Session::compile(ArrayRef<SessionKernel *> kernels,
                               bool adjoints) {
  // Primals are compiled first, because the adjoint of a kernel waits for its
  // primal.
  size_t count = kernels.size() * (adjoints ? 2 : 1);
  std::vector<runtime::Status> statuses(count);
  auto failed = runInParallel(count, [&](size_t i) -> const runtime::Status & {
    runtime::Kernel &kernel = *kernels[i % kernels.size()]->kernel;
    runtime::Kernel *adjoint = nullptr;
    return statuses[i] = i < kernels.size() ? kernel.resolve()
                                            : kernel.adjoint().resolve(adjoint);
  });
  return failed ? fail(statuses[*failed]) : success();
}

LogicalResult Session::prepareReverse(runtime::Tape &tape, bool cleared) {
  std::vector<runtime::PendingAdjoint> needed = tape.pendingAdjoints(cleared);
  if (needed.size() < 2)
    return success();
  std::vector<runtime::Status> statuses(needed.size());
  auto failed =
      runInParallel(needed.size(), [&](size_t i) -> const runtime::Status & {
        return statuses[i] = needed[i].resolve();
      });
  return failed ? fail(statuses[*failed]) : success();
}

CompileOptions Session::getHostOptions() const {
  CompileOptions options = compileOptions;
  options.device = std::nullopt;
  options.deviceTarget.clear();
  return options;
}

bool Session::fusesLaunches() const {
  return fuseLaunches && !compileOptions.interpret && !compileOptions.debug &&
         compileOptions.codegen.optLevel > 0 &&
         compileOptions.bounds == BoundsMode::Off;
}

FailureOr<Session::HostFunction> Session::compileHost(ModuleOp module,
                                                      StringRef name) {
  OwningOpRef<ModuleOp> host = makeHostModule(module, name);
  Failure failure;
  HostFunction function{name.str(), {}, getHostOptions(), usesFields(*host)};
  auto compiled = compiler->compile({*host, name, CompileRequest::Goal::Primal},
                                    function.options, failure);
  if (!compiled)
    return failures.fail(std::move(failure));
  reports.printProfile(name, CompileRequest::Goal::Primal, *compiled);
  function.code = std::move(*compiled);
  return function;
}

LogicalResult Session::runHost(
    const HostFunction &function,
    const std::function<SessionKernel *(StringRef name)> &findKernel) {
  // A tape records launches only, not the loads and stores of a host function.
  const runtime::Recorder *tape = rt->recordings().current();
  if (function.usesFields && tape && !tape->isSuspended())
    return fail(FailureKind::Usage,
                "a tape cannot record the loads and stores of fields in '@" +
                    function.name +
                    "' itself; move them into a kernel, or open the tape in "
                    "the function");
  runtime::HostModule hostModule;
  hostModule.usesTrees = function.usesFields;
  hostModule.findKernel = [&](std::string_view kernelName) {
    SessionKernel *kernel = findKernel(kernelName);
    return kernel ? kernel->kernel.get() : nullptr;
  };
  std::vector<runtime::TreePtr> trees;
  for (const std::string &tree : function.code.trees) {
    trees.push_back(rt->store().findTree(tree));
    if (!trees.back())
      return fail(FailureKind::Usage, "'@" + function.name + "' uses tree '" +
                                          tree + "', which has been destroyed");
  }
  return check(runtime::runHost(
      *rt, reinterpret_cast<TaiKernelFn>(function.code.address), trees,
      hostModule, nullptr, nullptr));
}

FailureOr<std::string> Session::getIR(SessionKernel &kernel, StringRef stage) {
  if (stage == "explain")
    return explain(kernel);
  Failure failure;
  bool forward = stage.consume_front("tangent.");
  CompileRequest::Goal goal = stage.consume_front("adjoint.")
                                  ? CompileRequest::Goal::Adjoint
                                  : CompileRequest::Goal::Primal;
  std::optional<std::string> text =
      compiler->print(kernel.code->getRequest(goal, forward), stage,
                      kernel.code->getOptions(), failure);
  if (!text)
    return failures.fail(std::move(failure));
  return *text;
}

std::string Session::explainGathers(const runtime::Kernel *kernel) {
  auto found = llvm::find_if(kernels, [&](SessionKernel &each) {
    return each.kernel.get() == kernel;
  });
  if (found == kernels.end())
    return {};
  Failure reason;
  RemarkScope gradient;
  CompileRequest::Goal goal = found->code->getTapeGoal(*found->kernel);
  (void)compiler->print(found->code->getRequest(goal), "scf",
                        found->code->getOptions(), reason);
  return tai::explainGathers("gradient of @" + found->code->getName(),
                             gradient.getRemarks());
}

FailureOr<std::string> Session::explain(SessionKernel &kernel) {
  RemarkScope scope;
  Failure reason;
  std::optional<std::string> text = compiler->print(
      kernel.code->getRequest(CompileRequest::Goal::Primal, /*forward=*/false),
      "autodiff", kernel.code->getOptions(), reason, /*withPlaces=*/true);
  if (!text)
    return failures.fail(std::move(reason));
  OwningOpRef<ModuleOp> module =
      readModule(*text, ParserConfig(context.get()), "gradient");
  if (!module)
    return fail(FailureKind::Internal, "the gradient cannot be read back");
  RemarkScope lowering;
  if (failed(getIR(kernel, "scf")))
    return failure();
  // These remarks stay empty for a kernel without a gradient.
  RemarkScope gradient;
  CompileRequest::Goal goal = kernel.code->getTapeGoal(*kernel.kernel);
  (void)compiler->print(kernel.code->getRequest(goal), "scf",
                        kernel.code->getOptions(), reason);
  return explainKernel(*module, kernel.code->getName(),
                       kernel.code->getOptions().device.has_value(),
                       scope.getRemarks(), lowering.getRemarks(),
                       gradient.getRemarks());
}
