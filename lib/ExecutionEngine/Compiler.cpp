//===- Compiler.cpp - From a module to a function that runs ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Compiler.h"
#include "BuildId.h"
#include "mlir/Pass/Pass.h"
#include "mlir/Pass/PassInstrumentation.h"
#include "mlir/Target/LLVMIR/Export.h"
#include "tai/Analysis/SkipScope.h"
#include "tai/Conversion/Passes.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/ExecutionEngine/AdjointNeeds.h"
#include "tai/ExecutionEngine/LoopLevels.h"
#include "llvm/ADT/ScopeExit.h"
#include "llvm/ADT/StringExtras.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"
#include "llvm/Support/BLAKE3.h"
#include "llvm/Support/FileSystem.h"
#include <chrono>

using namespace mlir;
using namespace mlir::tai;

std::string CompileOptions::str() const {
  std::string text;
  llvm::raw_string_ostream(text)
      << "opt=" << codegen.optLevel << " fast=" << codegen.fastMath
      << " contract=" << codegen.contract << " debug=" << debug
      << " deterministic=" << deterministic << " history=" << historyBytes
      << " skip=" << skips.str();
  if (device)
    text += " device=" + DeviceTarget{*device, deviceTarget}.str();
  return text;
}

StringRef mlir::tai::stringifyPhase(Phase phase) {
  static constexpr StringRef names[kNumPhases] = {
      "cache", "autodiff", "lower", "translate", "optimize", "emit", "link"};
  return names[static_cast<unsigned>(phase)];
}

namespace {
/// Adds the time until its end to a phase.
class PhaseTimer {
public:
  PhaseTimer(PhaseTimes &times, Phase phase)
      : slot(times[static_cast<unsigned>(phase)]),
        start(std::chrono::steady_clock::now()) {}
  ~PhaseTimer() {
    slot +=
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start)
            .count();
  }

private:
  double &slot;
  std::chrono::steady_clock::time_point start;
};

/// Keeps the IR as it is after the last run of one pass.
class CaptureAfterPass : public PassInstrumentation {
public:
  CaptureAfterPass(StringRef argument, std::string **text)
      : argument(argument.str()), text(text) {}

  void runAfterPass(Pass *pass, Operation *op) override {
    if (!*text || pass->getArgument() != argument)
      return;
    (*text)->clear();
    llvm::raw_string_ostream stream(**text);
    op->print(stream);
  }

private:
  std::string argument;
  /// The string to fill in the present run, if any.
  std::string **text;
};
} // namespace

//===----------------------------------------------------------------------===//
// Workers
//===----------------------------------------------------------------------===//

/// What one thread needs to compile. Pass managers are kept, because a pass
/// collects its patterns when it first runs, and target machines are costly.
struct Compiler::Worker {
  Worker(MLIRContext *context, const Pipelines &pipelines,
         const CompileOptions &options)
      : options(options), autodiff(context), takingAutodiff(context),
        forward(context), lowering(context) {
    for (PassManager *manager :
         {&autodiff, &takingAutodiff, &forward, &lowering})
      manager->enableVerifier(options.debug);
    if (pipelines.autodiff) {
      pipelines.autodiff(autodiff, options, /*takes=*/false);
      pipelines.autodiff(takingAutodiff, options, /*takes=*/true);
    }
    if (pipelines.forward)
      pipelines.forward(forward, options);
    const auto &lower = options.device ? pipelines.toDevice : pipelines.toLLVM;
    if (lower)
      lower(lowering, options);
    lowering.addInstrumentation(std::make_unique<CaptureAfterPass>(
        options.device ? pipelines.deviceScfPass : pipelines.scfPass, &scf));
  }

  CompileOptions options;
  PassManager autodiff;
  PassManager takingAutodiff;
  PassManager forward;
  /// To the LLVM dialect, for a device or without one.
  PassManager lowering;
  std::unique_ptr<ObjectCompiler> objects;
  std::unique_ptr<DeviceCompiler> deviceCode;
  std::string *scf = nullptr;
};

/// Takes a worker for these options from the idle ones, and puts it back.
class Compiler::WorkerLease {
public:
  WorkerLease(Compiler &compiler, const CompileOptions &options)
      : compiler(compiler) {
    {
      std::lock_guard<std::mutex> lock(compiler.mutex);
      auto found = llvm::find_if(compiler.idle, [&](const auto &candidate) {
        return candidate->options == options;
      });
      if (found != compiler.idle.end()) {
        worker = std::move(*found);
        compiler.idle.erase(found);
      }
    }
    if (!worker)
      worker = std::make_unique<Worker>(compiler.context, compiler.pipelines,
                                        options);
  }
  ~WorkerLease() {
    std::lock_guard<std::mutex> lock(compiler.mutex);
    compiler.idle.push_back(std::move(worker));
  }

  Worker &operator*() { return *worker; }

private:
  Compiler &compiler;
  std::unique_ptr<Worker> worker;
};

Compiler::Compiler(MLIRContext *context, Pipelines pipelines,
                   ArrayRef<runtime::RuntimeSymbol> runtime)
    : context(context), pipelines(std::move(pipelines)),
      runtime(runtime.begin(), runtime.end()) {}

Compiler::~Compiler() = default;

void Compiler::loadDialects() {
  CompileOptions withDevice;
  withDevice.device = runtime::DeviceKind::Emulated;
  DialectRegistry registry;
  for (const CompileOptions &options : {CompileOptions(), withDevice}) {
    Worker worker(context, pipelines, options);
    worker.autodiff.getDependentDialects(registry);
    worker.forward.getDependentDialects(registry);
    worker.lowering.getDependentDialects(registry);
  }
  context->appendDialectRegistry(registry);
  for (StringRef name : registry.getDialectNames())
    context->getOrLoadDialect(name);
}

Linker *Compiler::getLinker(Failure &failure) {
  std::lock_guard<std::mutex> lock(mutex);
  if (!linker) {
    auto made = Linker::create(runtime);
    if (!made) {
      failure =
          Failure::get(FailureKind::Internal, llvm::toString(made.takeError()));
      return nullptr;
    }
    linker = std::move(*made);
  }
  return linker.get();
}

PhaseTimes Compiler::getTotals() {
  std::lock_guard<std::mutex> lock(mutex);
  return totals;
}

//===----------------------------------------------------------------------===//
// Passes
//===----------------------------------------------------------------------===//

/// Writes the module, with the pipeline that failed on it, to a file that
/// `tai-opt --run-reproducer` takes, and returns its path.
static std::string writeReproducer(ModuleOp module, PassManager &manager) {
  SmallString<128> path;
  int descriptor;
  if (llvm::sys::fs::createTemporaryFile("tai-reproducer", "mlir", descriptor,
                                         path))
    return "(no reproducer could be written)";
  llvm::raw_fd_ostream stream(descriptor, /*shouldClose=*/true);
  module.print(stream, OpPrintingFlags().enableDebugInfo());
  std::string pipeline;
  llvm::raw_string_ostream pipelineStream(pipeline);
  manager.printAsTextualPipeline(pipelineStream);
  stream << "\n{-#\n  external_resources: {\n    mlir_reproducer: {\n"
         << "      pipeline: \"";
  stream.write_escaped(pipeline);
  stream << "\",\n      disable_threading: true,\n"
         << "      verify_each: true\n    }\n  }\n#-}\n";
  return path.str().str();
}

/// Runs a pipeline. A pass that fails without saying why is a bug of ours.
static LogicalResult runPipeline(PassManager &manager, ModuleOp module,
                                 ModuleOp input, StringRef name,
                                 FailureKind kind, StringRef title,
                                 Failure &failure) {
  DiagnosticCollector collector(module.getContext());
  if (succeeded(manager.run(module)))
    return success();
  if (collector.hasErrors()) {
    failure = collector.take(kind);
    return mlir::failure();
  }
  failure = Failure::get(FailureKind::Internal,
                         Twine(title) + " of '" + name +
                             "' failed inside the compiler; reproducer: " +
                             writeReproducer(input, manager));
  return mlir::failure();
}

/// An adjoint that came with its kernel must say that it takes.
static LogicalResult checkTakes(ModuleOp module, KernelOp kernel,
                                Failure &failure) {
  DiagnosticCollector collector(module.getContext());
  auto adjoint = module.lookupSymbol<KernelOp>(*kernel.getAdjoint());
  if (!adjoint || adjoint->hasAttr(kTakesAttrName))
    return success();
  adjoint.emitError("this adjoint must leave zero in the adjoints of what '@" +
                    kernel.getName() +
                    "' stores, which an earlier launch has used")
          .attachNote()
      << "store zero there after reading them, and give it the attribute '"
      << kTakesAttrName << "'";
  failure = collector.take(FailureKind::Autodiff);
  return mlir::failure();
}

static void eraseOtherKernels(ModuleOp module, StringRef name) {
  for (KernelOp other : llvm::make_early_inc_range(module.getOps<KernelOp>()))
    if (other.getSymName() != name)
      other.erase();
}

LogicalResult Compiler::extendByTangents(Worker &worker, CompileRequest request,
                                         Prepared &prepared, Failure &failure) {
  PhaseTimer timer(prepared.times, Phase::Autodiff);
  ModuleOp module = *prepared.module;
  auto kernels = llvm::to_vector(module.getOps<KernelOp>());
  if (failed(runPipeline(worker.forward, module, request.module, request.name,
                         FailureKind::Autodiff, "forward mode", failure)))
    return mlir::failure();
  for (KernelOp kernel : kernels) {
    auto tangent = kernel->getAttrOfType<FlatSymbolRefAttr>("tai.tangent");
    if (getEntryPointName(kernel.getSymName()) == prepared.symbol)
      prepared.symbol = getEntryPointName(tangent.getValue());
    kernel.erase();
  }
  return success();
}

LogicalResult Compiler::differentiate(Worker &worker, CompileRequest request,
                                      Prepared &prepared, Failure &failure) {
  prepared.module = request.module.clone();
  OwningOpRef<ModuleOp> &module = prepared.module;
  prepared.symbol = getEntryPointName(request.name);
  auto given = module->lookupSymbol<KernelOp>(request.name);
  if (request.goal == CompileRequest::Goal::Primal && given) {
    given.removeAdjointAttr();
    eraseOtherKernels(*module, request.name);
  }
  if (request.goal != CompileRequest::Goal::Primal) {
    PhaseTimer timer(prepared.times, Phase::Autodiff);
    bool takes = CompileRequest::takes(request.goal);
    if (!pipelines.autodiff) {
      failure = Failure::get(FailureKind::Autodiff,
                             "this build cannot differentiate kernels");
      return mlir::failure();
    }
    // A kernel may come with its adjoint.
    if (given && given.getAdjoint()) {
      if (takes && failed(checkTakes(*module, given, failure)))
        return mlir::failure();
    } else if (failed(runPipeline(
                   takes ? worker.takingAutodiff : worker.autodiff, *module,
                   request.module, request.name, FailureKind::Autodiff,
                   "differentiation", failure))) {
      return mlir::failure();
    }
    prepared.needs = getAdjointNeeds(*module, request.name).serialize();
    // The primal is compiled on its own, when it is first launched.
    auto kernel = module->lookupSymbol<KernelOp>(request.name);
    FlatSymbolRefAttr adjoint = kernel ? kernel.getAdjointAttr() : nullptr;
    if (kernel)
      kernel.erase();
    if (!adjoint) {
      prepared.symbol.clear();
      return success();
    }
    auto form = module->lookupSymbol<KernelOp>(adjoint)
                    ->getAttrOfType<FlatSymbolRefAttr>(kStoredFormAttrName);
    if (form && CompileRequest::readsStored(request.goal))
      adjoint = form;
    prepared.symbol = getEntryPointName(adjoint.getValue());
    // Parts of the kernel are kernels of their own.
    eraseOtherKernels(*module, adjoint.getValue());
  }
  if (request.forward)
    return extendByTangents(worker, request, prepared, failure);
  return success();
}

LogicalResult Compiler::lower(Worker &worker, CompileRequest request,
                              Prepared &prepared,
                              std::vector<std::string> &trees, Failure &failure,
                              std::string *scf) {
  for (TreeOp tree : prepared.module->getOps<TreeOp>())
    trees.push_back(tree.getSymName().str());
  PhaseTimer timer(prepared.times, Phase::Lower);
  if (worker.options.device && !pipelines.toDevice) {
    failure = Failure::get(FailureKind::Usage,
                           "this build cannot compile kernels for a GPU");
    return mlir::failure();
  }
  worker.scf = scf;
  LogicalResult lowered =
      runPipeline(worker.lowering, *prepared.module, request.module,
                  request.name, FailureKind::Type, "lowering", failure);
  worker.scf = nullptr;
  return lowered;
}

//===----------------------------------------------------------------------===//
// LLVM
//===----------------------------------------------------------------------===//

namespace {
/// A module of LLVM IR with its context, and the tools of a worker to work on
/// it. After a fatal error inside LLVM nothing of it may be touched again.
class LLVMJob {
public:
  explicit LLVMJob(std::unique_ptr<ObjectCompiler> &objects)
      : objects(objects), context(std::make_unique<llvm::LLVMContext>()) {}
  ~LLVMJob() {
    if (!objects || !objects->isBroken())
      return;
    (void)module.release();
    (void)context.release();
    (void)objects.release();
  }

  /// Translates to LLVM IR with nothing visible but the function to call, so
  /// that LLVM may inline and drop the rest.
  LogicalResult translate(ModuleOp source, StringRef symbol, PhaseTimes &times,
                          Failure &failure);
  LogicalResult optimize(const CodegenOptions &options, PhaseTimes &times,
                         Failure &failure);

  llvm::Module &getModule() { return *module; }
  ObjectCompiler &getObjectCompiler() { return *objects; }

private:
  std::unique_ptr<ObjectCompiler> &objects;
  std::unique_ptr<llvm::LLVMContext> context;
  std::unique_ptr<llvm::Module> module;
};
} // namespace

LogicalResult LLVMJob::translate(ModuleOp source, StringRef symbol,
                                 PhaseTimes &times, Failure &failure) {
  PhaseTimer timer(times, Phase::Translate);
  DiagnosticCollector collector(source.getContext());
  module = translateModuleToLLVMIR(source, *context, symbol,
                                   /*disableVerification=*/true);
  if (!module) {
    failure =
        collector.take(FailureKind::Internal, "translation to LLVM IR failed");
    return mlir::failure();
  }
  llvm::Function *entry = module->getFunction(symbol);
  if (!entry || entry->isDeclaration()) {
    failure = Failure::get(FailureKind::Internal,
                           "no function '" + symbol + "' after lowering");
    return mlir::failure();
  }
  for (llvm::GlobalValue &value : module->global_values())
    if (!value.isDeclaration() && &value != entry)
      value.setLinkage(llvm::GlobalValue::InternalLinkage);
  return success();
}

/// A failure of LLVM, which is a bug of ours: we gave it what it cannot
/// compile.
static LogicalResult failInLLVM(llvm::Error error, Failure &failure) {
  failure =
      Failure::get(FailureKind::Internal, "code generation failed: " +
                                              llvm::toString(std::move(error)));
  return mlir::failure();
}

LogicalResult LLVMJob::optimize(const CodegenOptions &options,
                                PhaseTimes &times, Failure &failure) {
  PhaseTimer timer(times, Phase::Optimize);
  if (!objects) {
    auto made = ObjectCompiler::create(options);
    if (!made)
      return failInLLVM(made.takeError(), failure);
    objects = std::move(*made);
  }
  if (llvm::Error error = objects->optimize(*module))
    return failInLLVM(std::move(error), failure);
  return success();
}

//===----------------------------------------------------------------------===//
// Devices
//===----------------------------------------------------------------------===//

/// The device code of a lowered module, or null, which is a success.
static LogicalResult findDeviceCode(ModuleOp module, Operation *&found,
                                    Failure &failure) {
  auto deviceModule = findDeviceModule(module);
  if (!deviceModule)
    return failInLLVM(deviceModule.takeError(), failure);
  found = *deviceModule;
  return success();
}

/// The compiler of device code of a worker, made now if need be.
static llvm::Expected<DeviceCompiler *>
getDeviceCompiler(std::unique_ptr<DeviceCompiler> &compiler,
                  const CompileOptions &options) {
  if (!compiler) {
    auto made = DeviceCompiler::create({*options.device, options.deviceTarget},
                                       options.codegen);
    if (!made)
      return made.takeError();
    compiler = std::move(*made);
  }
  return compiler.get();
}

std::optional<runtime::DeviceImage>
Compiler::makeProgram(const runtime::ProgramPlan &plan,
                      const CompileOptions &options, Failure &failure) {
  WorkerLease lease(*this, options);
  auto compiler = getDeviceCompiler((*lease).deviceCode, options);
  if (!compiler) {
    (void)failInLLVM(compiler.takeError(), failure);
    return std::nullopt;
  }
  auto image = (*compiler)->makeProgram(plan);
  if ((*compiler)->isBroken())
    (*lease).deviceCode.reset();
  if (!image) {
    (void)failInLLVM(image.takeError(), failure);
    return std::nullopt;
  }
  return std::move(*image);
}

LogicalResult Compiler::compileDeviceCode(
    Worker &worker, const CompileOptions &options, Prepared &prepared,
    std::optional<runtime::DeviceImage> &image, Failure &failure) {
  Operation *deviceModule = nullptr;
  if (failed(findDeviceCode(*prepared.module, deviceModule, failure)))
    return mlir::failure();
  if (!deviceModule)
    return success();
  PhaseTimes &times = prepared.times;
  // What is wrong with the target or lacks on this machine is not our bug.
  auto fail = [&](llvm::Error error) {
    failure =
        Failure::get(FailureKind::Usage, llvm::toString(std::move(error)));
    return mlir::failure();
  };
  auto made = getDeviceCompiler(worker.deviceCode, options);
  if (!made)
    return fail(made.takeError());
  DeviceCompiler &compiler = **made;
  llvm::scope_exit leave([&] {
    if (compiler.isBroken())
      worker.deviceCode.reset();
  });
  auto code = [&] {
    PhaseTimer timer(times, Phase::Translate);
    DiagnosticCollector collector(context);
    auto code = compiler.translate(deviceModule);
    if (!code && collector.hasErrors())
      failure = collector.take(FailureKind::Internal);
    return code;
  }();
  if (!code) {
    if (failure.kind == FailureKind::None)
      return fail(code.takeError());
    llvm::consumeError(code.takeError());
    return mlir::failure();
  }
  // A kernel without device functions has nothing to load.
  if (!code->functions.empty()) {
    {
      PhaseTimer timer(times, Phase::Optimize);
      if (llvm::Error error = compiler.optimize(*code))
        return failInLLVM(std::move(error), failure);
    }
    PhaseTimer timer(times, Phase::Emit);
    auto made = compiler.emit(*code);
    if (!made)
      return failInLLVM(made.takeError(), failure);
    image = std::move(*made);
    // They are not part of the key then.
    if (!options.places)
      image->places.clear();
  }
  deviceModule->erase();
  return success();
}

/// The host's part of a kernel that runs on a device is cold.
static CodegenOptions getHostCodegen(const CompileOptions &options) {
  CodegenOptions codegen = options.codegen;
  if (options.device)
    codegen.optLevel = std::min(codegen.optLevel, 1u);
  return codegen;
}

std::optional<CompiledObject>
Compiler::compileObject(CompileRequest request, const CompileOptions &options,
                        Prepared &prepared, Failure &failure) {
  CompiledObject object;
  object.symbol = prepared.symbol;
  object.needs = prepared.needs;
  // Parts of a kernel count for themselves.
  if (object.symbol.empty())
    return object;
  object.skipped = prepared.skipped;
  SkipScope scope;
  object.loopLevels = findLoopLevels(*prepared.module, object.symbol);
  WorkerLease lease(*this, options);
  Worker &worker = *lease;
  PhaseTimes &times = prepared.times;
  if (failed(lower(worker, request, prepared, object.trees, failure, nullptr)))
    return std::nullopt;
  for (auto [sum, amount] : llvm::zip(object.skipped, scope.getAmounts()))
    sum += amount;
  if (options.device && failed(compileDeviceCode(worker, options, prepared,
                                                 object.image, failure)))
    return std::nullopt;
  LLVMJob job(worker.objects);
  if (failed(job.translate(*prepared.module, object.symbol, times, failure)) ||
      failed(job.optimize(getHostCodegen(options), times, failure)))
    return std::nullopt;
  PhaseTimer timer(times, Phase::Emit);
  auto code = job.getObjectCompiler().emitObject(job.getModule());
  if (!code) {
    (void)failInLLVM(code.takeError(), failure);
    return std::nullopt;
  }
  object.code = std::move(*code);
  return object;
}

//===----------------------------------------------------------------------===//
// Compilation
//===----------------------------------------------------------------------===//

std::string Compiler::getKey(CompileRequest request,
                             const CompileOptions &options) {
  // Locations are in the code only where checks or a profiler report them.
  std::string text;
  llvm::raw_string_ostream stream(text);
  const HostCpu &host = HostCpu::get();
  stream << getBuildId() << '\n'
         << host.triple << ' ' << host.name << ' ' << host.features << '\n'
         << options.str() << '\n'
         << request.name << ' ' << static_cast<int>(request.goal)
         << (request.forward ? " forward" : "") << '\n';
  OpPrintingFlags flags;
  // Assertions and checks put the place they stand at into the code; so do
  // adjoints, where a device has no memory for what they record.
  bool isAdjoint = request.goal != CompileRequest::Goal::Primal;
  bool hasPlaces =
      options.debug || (options.device && (options.places || isAdjoint)) ||
      request.module.walk([](CheckCloseOp) { return WalkResult::interrupt(); })
          .wasInterrupted();
  flags.enableDebugInfo(hasPlaces);
  flags.assumeVerified();
  request.module->print(stream, flags);
  llvm::BLAKE3 hasher;
  hasher.update(text);
  return llvm::toHex(hasher.final(), /*LowerCase=*/true);
}

std::optional<Compiler::Function>
Compiler::compile(CompileRequest request, const CompileOptions &options,
                  Failure &failure) {
  std::optional<Prepared> prepared = prepare(request, options, failure);
  if (!prepared)
    return std::nullopt;
  return finish(std::move(*prepared), request, options, failure);
}

std::optional<Compiler::Prepared>
Compiler::prepare(CompileRequest request, const CompileOptions &options,
                  Failure &failure) {
  Prepared prepared;
  if (cache) {
    PhaseTimer timer(prepared.times, Phase::Cache);
    prepared.key = getKey(request, options);
    if (std::optional<std::string> bytes = cache.load(prepared.key))
      prepared.object = CompiledObject::deserialize(*bytes);
  }
  if (prepared.object) {
    prepared.needs = prepared.object->needs;
    return prepared;
  }
  WorkerLease lease(*this, options);
  SkipScope scope;
  if (failed(differentiate(*lease, request, prepared, failure)))
    return std::nullopt;
  prepared.skipped = scope.getAmounts();
  return prepared;
}

std::optional<Compiler::Function>
Compiler::finish(Prepared prepared, CompileRequest request,
                 const CompileOptions &options, Failure &failure) {
  Function function;
  std::optional<CompiledObject> object = std::move(prepared.object);
  function.fromCache = object.has_value();
  if (!object) {
    object = compileObject(request, options, prepared, failure);
    if (!object)
      return std::nullopt;
    if (cache) {
      PhaseTimer timer(prepared.times, Phase::Cache);
      cache.store(prepared.key, object->serialize());
    }
  }
  function.times = prepared.times;
  if (!object->symbol.empty()) {
    PhaseTimer timer(function.times, Phase::Link);
    Linker *linker = getLinker(failure);
    if (!linker)
      return std::nullopt;
    auto linked = linker->link(object->code, object->symbol);
    if (!linked) {
      failure = Failure::get(FailureKind::Internal,
                             "linking '" + request.name + "' failed: " +
                                 llvm::toString(linked.takeError()));
      return std::nullopt;
    }
    function.address = linked->addresses.front();
    function.library = linked->library;
  }
  function.trees = std::move(object->trees);
  function.skipped = object->skipped;
  function.loopLevels = std::move(object->loopLevels);
  if (object->image) {
    object->image->key = prepared.key;
    function.image =
        std::make_shared<const runtime::DeviceImage>(std::move(*object->image));
  }
  std::lock_guard<std::mutex> lock(mutex);
  for (unsigned i = 0; i < kNumPhases; ++i)
    totals[i] += function.times[i];
  return function;
}

void Compiler::unload(const Function &function) {
  if (function.library)
    linker->unload(function.library);
}

//===----------------------------------------------------------------------===//
// Printing
//===----------------------------------------------------------------------===//

ArrayRef<StringRef> Compiler::getStages() {
  static constexpr StringRef stages[] = {"tai",  "autodiff", "scf",    "llvm",
                                         "nvvm", "ptx",      "llvmir", "asm"};
  return stages;
}

std::optional<std::string> Compiler::print(CompileRequest request,
                                           StringRef stage,
                                           const CompileOptions &options,
                                           Failure &failure) {
  if (!llvm::is_contained(getStages(), stage)) {
    failure = Failure::get(FailureKind::Usage,
                           "unknown stage '" + stage + "'; the stages are " +
                               llvm::join(getStages(), ", "));
    return std::nullopt;
  }
  if (!options.device && isDeviceStage(stage)) {
    failure = Failure::get(FailureKind::Usage,
                           "stage '" + stage +
                               "' is there for kernels of a GPU alone");
    return std::nullopt;
  }
  std::string text;
  llvm::raw_string_ostream stream(text);
  if (stage == "tai") {
    request.module->print(stream);
    return text;
  }
  WorkerLease lease(*this, options);
  Worker &worker = *lease;
  PhaseTimes times = {};
  if (stage == "autodiff" && request.forward) {
    Prepared prepared;
    if (failed(differentiate(worker, request, prepared, failure)))
      return std::nullopt;
    prepared.module->print(stream);
    return text;
  }
  if (stage == "autodiff") {
    if (!pipelines.autodiff) {
      failure = Failure::get(FailureKind::Autodiff,
                             "this build cannot differentiate kernels");
      return std::nullopt;
    }
    OwningOpRef<ModuleOp> module = request.module.clone();
    if (failed(runPipeline(worker.autodiff, *module, request.module,
                           request.name, FailureKind::Autodiff,
                           "differentiation", failure)))
      return std::nullopt;
    module->print(stream);
    return text;
  }
  Prepared prepared;
  std::vector<std::string> trees;
  std::string scf;
  if (failed(differentiate(worker, request, prepared, failure)))
    return std::nullopt;
  ModuleOp module = *prepared.module;
  if (!prepared.symbol.empty() &&
      failed(lower(worker, request, prepared, trees, failure, &scf)))
    return std::nullopt;
  if (stage == "scf" && !prepared.symbol.empty())
    return scf;
  if (stage == "llvm" || prepared.symbol.empty()) {
    module->print(stream);
    return text;
  }
  if (stage == "nvvm") {
    Operation *deviceModule = nullptr;
    if (failed(findDeviceCode(module, deviceModule, failure)))
      return std::nullopt;
    if (deviceModule)
      deviceModule->print(stream);
    return text;
  }
  std::optional<runtime::DeviceImage> image;
  if (options.device &&
      failed(compileDeviceCode(worker, options, prepared, image, failure)))
    return std::nullopt;
  if (stage == "ptx") {
    if (!image)
      return text;
    if (image->kind == runtime::DeviceKind::Cuda)
      return std::move(image->bytes);
    failure =
        Failure::get(FailureKind::Usage, "the emulated device has no PTX");
    return std::nullopt;
  }
  LLVMJob job(worker.objects);
  if (failed(job.translate(module, prepared.symbol, times, failure)) ||
      failed(job.optimize(getHostCodegen(options), times, failure)))
    return std::nullopt;
  if (stage == "llvmir") {
    job.getModule().print(stream, nullptr);
    return text;
  }
  auto assembly = job.getObjectCompiler().emitAssembly(job.getModule());
  if (!assembly) {
    (void)failInLLVM(assembly.takeError(), failure);
    return std::nullopt;
  }
  return *assembly;
}
