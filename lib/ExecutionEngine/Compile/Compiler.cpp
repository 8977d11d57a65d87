//===- Compiler.cpp - From a module to a function that runs ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Compile/Compiler.h"
#include "BuildId.h"
#include "CompilerWorker.h"
#include "mlir/Pass/Pass.h"
#include "mlir/Pass/PassInstrumentation.h"
#include "tai/Analysis/SkipScope.h"
#include "tai/Analysis/ToBeRecorded.h"
#include "tai/CodeGen/Device/Libdevice.h"
#include "tai/CodeGen/InjectedFailures.h"
#include "tai/CodeGen/VerifyEach.h"
#include "tai/Conversion/Passes.h"
#include "tai/Dialect/Check/IR/Check.h"
#include "tai/Dialect/Mesh/IR/Mesh.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/ExecutionEngine/Compile/Background.h"
#include "tai/ExecutionEngine/Reproduce/StripAttributes.h"
#include "tai/Runtime/Launch/Mesh.h"
#include "tai/Support/XXHash.h"
#include "llvm/ADT/StringExtras.h"
#include "llvm/Support/BLAKE3.h"

using namespace mlir;
using namespace mlir::tai;

static std::string describe(BoundsMode mode) {
  return stringifyBoundsMode(mode).str();
}
static std::string describe(const SkipSet &skips) { return skips.str(); }
static std::string describe(const std::string &text) { return text; }
template <typename Number> static std::string describe(Number value) {
  return std::to_string(value);
}

std::string CompileOptions::str() const {
  std::string text;
  auto add = [&](StringRef key, const std::string &value) {
    if (!key.empty())
      text += (text.empty() ? "" : " ") + key.str() + '=' + value;
  };
#define TAI_CODEGEN_OPTION(type, member, initial, key)                         \
  add(key, describe(codegen.member));
#define TAI_COMPILE_OPTION(type, member, initial, key)                         \
  add(key, describe(member));
#include "tai/Support/Options.def"
  text += " vectors=" + llvm::join(getVectorLibraries(), ",");
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
/// Captures the IR after the last run of one pass.
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
  /// The string that the current run fills with the captured IR; null if the
  /// run captures none.
  std::string **text;
};
} // namespace

//===----------------------------------------------------------------------===//
// Workers
//===----------------------------------------------------------------------===//

Compiler::Worker::Worker(MLIRContext *context, const Pipelines &pipelines,
                         const CompileOptions &options)
    : options(options), autodiff(context), zeroingAutodiff(context),
      forward(context), lowering(context) {
  for (PassManager *manager :
       {&autodiff, &zeroingAutodiff, &forward, &lowering}) {
    manager->enableVerifier(options.debug || verifiesEach());
    manager->addInstrumentation(std::make_unique<InvalidAfterPass>(finding));
    StripAttributes::addIfWanted(*manager);
  }
  if (pipelines.autodiff) {
    pipelines.autodiff(autodiff, options, /*zeroes=*/false);
    pipelines.autodiff(zeroingAutodiff, options, /*zeroes=*/true);
    injectFailingPass(autodiff, "autodiff");
    injectFailingPass(zeroingAutodiff, "autodiff");
  }
  if (pipelines.forward)
    pipelines.forward(forward, options);
  injectFailingPass(forward, "forward");
  injectFailingPass(lowering, "lower");
  const auto &lower = options.device ? pipelines.toDevice : pipelines.toLLVM;
  if (lower)
    lower(lowering, options);
  lowering.addInstrumentation(std::make_unique<CaptureAfterPass>(
      options.device ? pipelines.deviceScfPass : pipelines.scfPass, &scf));
}

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

/// A user-written adjoint must declare that it sets adjoints of overwritten
/// elements to zero.
static LogicalResult checkZeroes(ModuleOp module, KernelOp kernel,
                                 Failure &failure) {
  DiagnosticCollector collector(module.getContext());
  auto adjoint = module.lookupSymbol<KernelOp>(*kernel.getAdjoint());
  if (!adjoint || adjoint.getZeroesAdjoint())
    return success();
  adjoint.emitError("this adjoint must leave zero in the adjoints of what '@" +
                    kernel.getName() +
                    "' stores, which an earlier launch has used")
          .attachNote()
      << "store zero there after reading them, and give it the attribute '"
      << adjoint.getZeroesAdjointAttrName().strref() << "'";
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
  prepared.step = Prepared::Step::Forward;
  if (failed(runPipeline(worker.forward, worker.finding, module,
                         "forward mode of '" + request.name + "'",
                         FailureKind::Autodiff, failure)))
    return mlir::failure();
  for (KernelOp kernel : kernels) {
    FlatSymbolRefAttr tangent = kernel.getTangentAttr();
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
    bool zeroes = CompileRequest::zeroes(request.goal);
    if (!pipelines.autodiff) {
      failure = Failure::get(FailureKind::Autodiff,
                             "this build cannot differentiate kernels");
      return mlir::failure();
    }
    // The user may have written the adjoint, in which case it is not derived.
    if (given && given.getAdjoint()) {
      if (zeroes && failed(checkZeroes(*module, given, failure)))
        return mlir::failure();
    } else if (failed(runPipeline(zeroes ? worker.zeroingAutodiff
                                         : worker.autodiff,
                                  worker.finding, *module,
                                  "differentiation of '" + request.name + "'",
                                  FailureKind::Autodiff, failure))) {
      return mlir::failure();
    }
    prepared.toBeRecorded = findToBeRecorded(*module, request.name).serialize();
    // The primal is dropped from the module, since it is compiled separately
    // when it is first launched.
    auto kernel = module->lookupSymbol<KernelOp>(request.name);
    FlatSymbolRefAttr adjoint = kernel ? kernel.getAdjointAttr() : nullptr;
    if (kernel)
      kernel.erase();
    if (!adjoint) {
      prepared.symbol.clear();
      return success();
    }
    FlatSymbolRefAttr form =
        module->lookupSymbol<KernelOp>(adjoint).getStoredFormAttr();
    if (form && CompileRequest::readsStored(request.goal))
      adjoint = form;
    prepared.symbol = getEntryPointName(adjoint.getValue());
    // The parts into which the kernel was split are erased, since they are
    // compiled as kernels of their own.
    eraseOtherKernels(*module, adjoint.getValue());
  }
  if (request.forward)
    return extendByTangents(worker, request, prepared, failure);
  return success();
}

/// The number of this process, if kernels of the module run on several ranks.
static std::optional<int64_t> getRank(ModuleOp module) {
  return llvm::any_of(module.getOps<TreeOp>(), hasShards)
             ? runtime::rankOfProcess()
             : std::nullopt;
}

LogicalResult Compiler::lower(Worker &worker, CompileRequest request,
                              Prepared &prepared,
                              std::vector<std::string> &trees, Failure &failure,
                              std::string *scf) {
  for (TreeOp tree : prepared.module->getOps<TreeOp>())
    trees.push_back(tree.getSymName().str());
  PhaseTimer timer(prepared.times, Phase::Lower);
  prepared.step = Prepared::Step::Lower;
  if (worker.options.device && !pipelines.toDevice) {
    failure = Failure::get(FailureKind::Usage,
                           "this build cannot compile kernels for a GPU");
    return mlir::failure();
  }
  ModuleOp module = *prepared.module;
  if (std::optional<int64_t> rank = getRank(module))
    module->setAttr(kRankAttrName, Builder(module).getI64IntegerAttr(*rank));
  worker.scf = scf;
  LogicalResult lowered = runPipeline(
      worker.lowering, worker.finding, *prepared.module,
      "lowering of '" + request.name + "'", FailureKind::Type, failure);
  worker.scf = nullptr;
  prepared.step = succeeded(lowered) ? Prepared::Step::Code : prepared.step;
  return lowered;
}

//===----------------------------------------------------------------------===//
// Reproducers
//===----------------------------------------------------------------------===//

/// The shell command that generates code from the lowered module of a
/// reproducer.
static std::string getCodeCommand(const CompileOptions &options) {
  if (!options.device)
    return "tai-translate --mlir-to-llvmir | llc -O" +
           std::to_string(std::min(options.codegen.optLevel, 3u));
  bool isCuda = *options.device == runtime::DeviceKind::Cuda;
  return (isCuda ? "tai-translate --tai-to-ptx --device-target=" +
                       options.deviceTarget
                 : std::string("tai-translate --tai-to-device-llvmir "
                               "--device-target=emulated"));
}

void Compiler::addReproducer(CompileRequest request,
                             const CompileOptions &options, Prepared::Step step,
                             Failure &failure) {
  using Step = Prepared::Step;
  if (failure.kind != FailureKind::Internal)
    return;
  WorkerLease lease(*this, options);
  Worker &worker = *lease;
  if (step == Step::Autodiff)
    return tai::addReproducer(failure, request.module,
                              CompileRequest::zeroes(request.goal)
                                  ? worker.zeroingAutodiff
                                  : worker.autodiff);
  // The module before the failed step is not kept, so it is recomputed for the
  // reproducer.
  CompileRequest before = request;
  before.forward = request.forward && step != Step::Forward;
  Prepared prepared;
  Failure ignored;
  if (failed(differentiate(worker, before, prepared, ignored)))
    prepared.module = request.module.clone();
  tai::addReproducer(failure, *prepared.module,
                     step == Step::Forward ? worker.forward : worker.lowering,
                     step == Step::Code ? getCodeCommand(options) : "");
}

//===----------------------------------------------------------------------===//
// Compilation
//===----------------------------------------------------------------------===//

/// CUDA's math library becomes part of device code, but is not part of the
/// build.
static std::string getLibdeviceKey(const CompileOptions &options) {
  if (options.device != runtime::DeviceKind::Cuda)
    return {};
  std::string searched;
  auto library = getLibdevice(searched);
  if (!library)
    return "no libdevice\n";
  static const uint64_t sum =
      runtime::xxh64(library->getBufferStart(), library->getBufferSize());
  return "libdevice " + llvm::utohexstr(sum) + "\n";
}

static std::string digest(StringRef text) {
  llvm::BLAKE3 hasher;
  hasher.update(text);
  return llvm::toHex(hasher.final(), /*LowerCase=*/true);
}

std::string Compiler::getPlaces(CompileRequest request) {
  std::string text;
  llvm::raw_string_ostream stream(text);
  OpPrintingFlags flags;
  flags.enableDebugInfo();
  flags.assumeVerified();
  request.module->print(stream, flags);
  return digest(text);
}

std::string Compiler::getProgramKey(StringRef text,
                                    const CompileOptions &options) {
  return digest("program\n" + getBuildId(context) + "\n" + options.str() +
                "\n" + getLibdeviceKey(options) + text.str());
}

std::string Compiler::getKey(CompileRequest request,
                             const CompileOptions &options) {
  // Compiled code contains no source locations, unless it has checks or serves
  // a profiler.
  std::string text;
  llvm::raw_string_ostream stream(text);
  // Sessions accept only processors that TargetCpu::find finds.
  TargetCpu cpu = llvm::cantFail(TargetCpu::find(options.codegen.targetCpu));
  stream << getBuildId(context) << '\n'
         << cpu.triple << ' ' << cpu.name << ' ' << cpu.features << '\n'
         << options.str() << '\n'
         << getLibdeviceKey(options) << request.name << ' '
         << static_cast<int>(request.goal)
         << (request.forward ? " forward" : "") << '\n';
  if (std::optional<int64_t> rank = getRank(request.module))
    stream << "rank " << *rank << '\n';
  OpPrintingFlags flags;
  // Assertions and checks put their source locations into the code; so do
  // adjoints on a device, which report if there is no memory for their records.
  bool isAdjoint = request.goal != CompileRequest::Goal::Primal;
  bool hasPlaces =
      options.debug || options.shadow || options.bounds == BoundsMode::Check ||
      (options.device && (options.places || isAdjoint)) ||
      request.module.walk([](CheckCloseOp) { return WalkResult::interrupt(); })
          .wasInterrupted();
  flags.enableDebugInfo(hasPlaces);
  flags.assumeVerified();
  request.module->print(stream, flags);
  return digest(text);
}

std::optional<Compiler::Function>
Compiler::compile(CompileRequest request, const CompileOptions &options,
                  Failure &failure) {
  std::optional<Prepared> prepared =
      prepare(request, options, failure, /*claims=*/true);
  if (!prepared)
    return std::nullopt;
  return finish(std::move(*prepared), request, options, failure);
}

void Compiler::load(Prepared &prepared, CompileRequest request) {
  if (std::optional<std::string> bytes = cache.load(prepared.key))
    prepared.object = CompiledObject::deserialize(*bytes);
  // The object was made from the same kernel at another line of its file.
  if (prepared.object && !prepared.object->places.empty() &&
      prepared.object->places != getPlaces(request))
    prepared.object.reset();
  if (prepared.object)
    prepared.toBeRecorded = prepared.object->toBeRecorded;
}

LogicalResult Compiler::claimOrLoad(Prepared &prepared, CompileRequest request,
                                    Failure &failure) {
  if (!cache || !cache.claim || prepared.claim)
    return success();
  PhaseTimer timer(prepared.times, Phase::Cache);
  auto wish = Background::Wish::Wait;
  prepared.claim = cache.claim(prepared.key, [&wish] {
    wish = Background::getWish();
    return wish == Background::Wish::Wait;
  });
  if (wish == Background::Wish::Abandon) {
    failure = Failure::get(FailureKind::Runtime,
                           "interrupted while another process compiled '" +
                               request.name + "'");
    return mlir::failure();
  }
  load(prepared, request);
  if (prepared.object)
    prepared.claim.reset();
  return success();
}

LogicalResult Compiler::start(CompileRequest request,
                              const CompileOptions &options, Prepared &prepared,
                              Failure &failure) {
  WorkerLease lease(*this, options);
  SkipScope scope;
  WarningScope warnings;
  if (failed(differentiate(*lease, request, prepared, failure))) {
    addReproducer(request, options, prepared.step, failure);
    return mlir::failure();
  }
  prepared.skipped = scope.getAmounts();
  prepared.warnings = warnings.take();
  return success();
}

std::optional<Compiler::Prepared>
Compiler::prepare(CompileRequest request, const CompileOptions &options,
                  Failure &failure, bool claims) {
  Prepared prepared;
  if (cache && !options.interpret) {
    PhaseTimer timer(prepared.times, Phase::Cache);
    prepared.key = getKey(request, options);
    load(prepared, request);
    if (!prepared.object && claims &&
        failed(claimOrLoad(prepared, request, failure)))
      return std::nullopt;
  }
  if (!prepared.object && failed(start(request, options, prepared, failure)))
    return std::nullopt;
  return prepared;
}

LogicalResult Compiler::link(const CompiledObject &object, StringRef name,
                             Function &function, Failure &failure) {
  if (object.symbol.empty())
    return success();
  PhaseTimer timer(function.times, Phase::Link);
  Linker *linker = getLinker(failure);
  if (!linker)
    return mlir::failure();
  if (injectsFailure("link")) {
    failure = Failure::get(FailureKind::Internal,
                           "linking '" + name + "': a failure was asked for");
    return mlir::failure();
  }
  auto linked = linker->link(object.code, object.symbol);
  if (!linked) {
    failure = Failure::get(
        FailureKind::Internal,
        "linking '" + name + "' failed: " + llvm::toString(linked.takeError()));
    return mlir::failure();
  }
  function.address = linked->addresses.front();
  function.library = linked->library;
  return success();
}

std::optional<Compiler::Function>
Compiler::finish(Prepared prepared, CompileRequest request,
                 const CompileOptions &options, Failure &failure) {
  if (options.interpret)
    return interpret(std::move(prepared), request, options, failure);
  Function function;
  if (!prepared.object && failed(claimOrLoad(prepared, request, failure)))
    return std::nullopt;
  std::optional<CompiledObject> object = std::move(prepared.object);
  prepared.object.reset();
  function.fromCache = object.has_value();
  if (object && failed(link(*object, request.name, function, failure))) {
    // The cached code of another process may need symbols that this process
    // lacks. In this case the module is compiled instead.
    failure = Failure();
    object.reset();
    function.fromCache = false;
  }
  if (!object) {
    if (!prepared.module && failed(start(request, options, prepared, failure)))
      return std::nullopt;
    object = compileObject(request, options, prepared, failure);
    if (!object)
      return std::nullopt;
  }
  for (unsigned i = 0; i < kNumPhases; ++i)
    function.times[i] += prepared.times[i];
  if (!function.fromCache) {
    if (failed(link(*object, request.name, function, failure))) {
      addReproducer(request, options, Prepared::Step::Code, failure);
      return std::nullopt;
    }
    if (cache) {
      PhaseTimer timer(function.times, Phase::Cache);
      cache.store(prepared.key, object->serialize());
    }
  }
  prepared.claim.reset();
  function.trees = std::move(object->trees);
  function.skipped = object->skipped;
  function.loopLevels = std::move(object->loopLevels);
  function.storesFirst = std::move(object->storesFirst);
  function.warnings = std::move(object->warnings);
  if (object->image) {
    object->image->key = prepared.key;
    if (function.fromCache)
      object->image->makeAgain =
          [this, request, name = request.name.str(),
           options](runtime::DeviceImage &fresh) mutable {
            request.name = name;
            return makeImageAgain(request, options, fresh);
          };
    function.image =
        std::make_shared<const runtime::DeviceImage>(std::move(*object->image));
  }
  std::lock_guard<std::mutex> lock(mutex);
  for (unsigned i = 0; i < kNumPhases; ++i)
    totals[i] += function.times[i];
  return function;
}

runtime::Status Compiler::makeImageAgain(CompileRequest request,
                                         const CompileOptions &options,
                                         runtime::DeviceImage &image) {
  Prepared prepared;
  prepared.key = getKey(request, options);
  Failure failure;
  std::optional<CompiledObject> object;
  if (succeeded(start(request, options, prepared, failure)))
    object = compileObject(request, options, prepared, failure);
  if (!object)
    return runtime::Status::failure(runtime::StatusCode::Internal,
                                    failure.message);
  if (cache)
    cache.store(prepared.key, object->serialize());
  if (object->image)
    image = std::move(*object->image);
  image.key = prepared.key;
  return runtime::Status::success();
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
                                           Failure &failure, bool withPlaces) {
  Prepared prepared;
  // Warnings are dropped here, because compiling the kernel reports them, too.
  WarningScope warnings;
  std::optional<std::string> text =
      printStage(request, stage, options, prepared, failure, withPlaces);
  if (!text)
    addReproducer(request, options, prepared.step, failure);
  return text;
}

std::optional<std::string>
Compiler::printStage(CompileRequest request, StringRef stage,
                     const CompileOptions &options, Prepared &prepared,
                     Failure &failure, bool withPlaces) {
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
  if (stage == "autodiff" && request.forward) {
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
    if (failed(runPipeline(worker.autodiff, worker.finding, *module,
                           "differentiation of '" + request.name + "'",
                           FailureKind::Autodiff, failure)))
      return std::nullopt;
    module->print(stream, OpPrintingFlags().enableDebugInfo(withPlaces));
    return text;
  }
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
  return printCode(worker, prepared, stage, options, failure);
}
