//===- CompilerCode.cpp - From the LLVM dialect to code -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Compiles lowered modules to object code for the host, and to an image for a
// device if there is one.
//
//===----------------------------------------------------------------------===//

#include "CompilerWorker.h"
#include "InterpretedCode.h"
#include "mlir/Target/LLVMIR/Export.h"
#include "tai/Analysis/LoopLevels.h"
#include "tai/Analysis/SkipScope.h"
#include "tai/CodeGen/InjectedFailures.h"
#include "tai/CodeGen/VerifyEach.h"
#include "tai/Conversion/Passes.h"
#include "tai/Dialect/Tai/IR/StoresFirst.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/ADT/ScopeExit.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// LLVM
//===----------------------------------------------------------------------===//

namespace {
/// A module of LLVM IR with its context, and the worker's code generator. After
/// a fatal error inside LLVM, none of these may be used or destroyed.
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

  /// Translates to LLVM IR in which only the function `symbol` is visible, so
  /// that LLVM may inline and drop all other functions.
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
  if (injectsFailure("translate")) {
    failure = Failure::get(FailureKind::Internal, "a failure was asked for");
    return mlir::failure();
  }
  DiagnosticCollector collector(source.getContext());
  module = translateModuleToLLVMIR(source, *context, symbol,
                                   /*disableVerification=*/!verifiesEach());
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

/// Reports a failure of LLVM, which is an internal error: the compiler has
/// produced a module that LLVM cannot compile.
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

/// Finds the device code of a lowered module; null, and success, if there is
/// none.
static LogicalResult findDeviceCode(ModuleOp module, Operation *&found,
                                    Failure &failure) {
  auto deviceModule = findDeviceModule(module);
  if (!deviceModule)
    return failInLLVM(deviceModule.takeError(), failure);
  found = *deviceModule;
  return success();
}

/// Gets the worker's compiler for device code, which is created at the first
/// call.
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

static std::string printModule(const llvm::Module &module) {
  std::string text;
  llvm::raw_string_ostream stream(text);
  module.print(stream, nullptr);
  return text;
}

/// Adds a file to reproduce a failure of LLVM's passes on a program. A plan
/// that is rejected before these passes run gets no file.
static void addProgramReproducer(const runtime::ProgramPlan &plan,
                                 const CompileOptions &options,
                                 Failure &failure) {
  std::unique_ptr<DeviceCompiler> compiler;
  if (auto made = getDeviceCompiler(compiler, options); !made)
    return llvm::consumeError(made.takeError());
  std::string text;
  compiler->setLinkedHook(
      [&](const llvm::Module &module)
          -> llvm::Expected<std::optional<runtime::DeviceImage>> {
        text = printModule(module);
        return llvm::createStringError("printed");
      });
  llvm::consumeError(tai::makeProgram(*compiler, plan).takeError());
  if (text.empty())
    return;
  std::string level =
      "O" + std::to_string(std::min(options.codegen.optLevel, 3u));
  addReproducer(failure, text,
                "opt --passes='default<" + level + ">' <this file> | llc -" +
                    level);
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
  std::string key;
  bool isKnown = false;
  // The cache key is computed in a hook on the linked module, so that the plan
  // is linked only once.
  if (cache)
    (*compiler)->setLinkedHook(
        [&](const llvm::Module &module)
            -> llvm::Expected<std::optional<runtime::DeviceImage>> {
          key = getProgramKey(printModule(module), options);
          std::optional<std::string> bytes;
          if (!key.empty())
            bytes = cache.load(key);
          std::optional<CompiledObject> object;
          if (bytes)
            object = CompiledObject::deserialize(*bytes);
          if (!object || !object->image)
            return std::nullopt;
          isKnown = true;
          return std::move(object->image);
        });
  auto image = tai::makeProgram(**compiler, plan);
  (*compiler)->setLinkedHook(nullptr);
  if ((*compiler)->isBroken())
    (*lease).deviceCode.reset();
  if (!image) {
    (void)failInLLVM(image.takeError(), failure);
    addProgramReproducer(plan, options, failure);
    return std::nullopt;
  }
  if (isKnown)
    return std::move(*image);
  if (assembler)
    assembler(*image);
  if (!key.empty()) {
    CompiledObject object;
    object.image = std::move(*image);
    cache.store(key, object.serialize());
    return std::move(object.image);
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
  // A target CPU that is wrong, or that this machine lacks, is a usage error.
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
  // A kernel without device functions has no image.
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
    // Without this option, the key of the cache does not include places.
    if (!options.places)
      image->places.clear();
  }
  deviceModule->erase();
  return success();
}

/// The options for the host part of a kernel that runs on a device, which takes
/// little time.
static CodegenOptions getHostCodegen(const CompileOptions &options) {
  CodegenOptions codegen = options.codegen;
  if (options.device)
    codegen.optLevel = std::min(codegen.optLevel, 1u);
  return codegen;
}

std::optional<CompiledObject>
Compiler::compileObject(CompileRequest request, const CompileOptions &options,
                        Prepared &prepared, Failure &failure) {
  std::optional<CompiledObject> object =
      makeObject(request, options, prepared, failure);
  if (!object)
    addReproducer(request, options, prepared.step, failure);
  return object;
}

std::optional<CompiledObject>
Compiler::makeObject(CompileRequest request, const CompileOptions &options,
                     Prepared &prepared, Failure &failure) {
  CompiledObject object;
  object.symbol = prepared.symbol;
  object.toBeRecorded = prepared.toBeRecorded;
  object.warnings = prepared.warnings;
  // Warnings contain source locations, which are not part of the cache's key,
  // so an object with warnings gets a digest of the locations.
  if (!object.warnings.empty())
    object.places = getPlaces(request);
  // A kernel that was split into parts has no code of its own; its parts report
  // their warnings themselves.
  if (object.symbol.empty())
    return object;
  object.skipped = prepared.skipped;
  SkipScope scope;
  for (KernelOp kernel : prepared.module->getOps<KernelOp>())
    if (getEntryPointName(kernel.getSymName()) == object.symbol)
      object.loopLevels = findLoopLevels(kernel);
  WorkerLease lease(*this, options);
  Worker &worker = *lease;
  PhaseTimes &times = prepared.times;
  if (failed(lower(worker, request, prepared, object.trees, failure, nullptr)))
    return std::nullopt;
  if (Operation *entry = prepared.module->lookupSymbol(object.symbol))
    object.storesFirst = getStoresFirst(entry);
  // Code that reports an error contains its location: without `places`, the
  // cache would return the code of the same kernel at another line.
  if (prepared.module->lookupSymbol("tai_rt_fail"))
    object.places = getPlaces(request);
  for (auto [sum, amount] : llvm::zip(object.skipped, scope.getAmounts()))
    sum += amount;
  if (options.device && failed(compileDeviceCode(worker, options, prepared,
                                                 object.image, failure)))
    return std::nullopt;
  if (object.image && assembler) {
    PhaseTimer timer(times, Phase::Emit);
    assembler(*object.image);
  }
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

std::optional<std::string>
Compiler::printCode(Worker &worker, Prepared &prepared, StringRef stage,
                    const CompileOptions &options, Failure &failure) {
  std::string text;
  llvm::raw_string_ostream stream(text);
  if (stage == "nvvm") {
    Operation *deviceModule = nullptr;
    if (failed(findDeviceCode(*prepared.module, deviceModule, failure)))
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
  if (failed(job.translate(*prepared.module, prepared.symbol, prepared.times,
                           failure)) ||
      failed(job.optimize(getHostCodegen(options), prepared.times, failure)))
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

std::optional<Compiler::Function>
Compiler::interpret(Prepared prepared, CompileRequest request,
                    const CompileOptions &options, Failure &failure) {
  Function function;
  function.times = prepared.times;
  function.skipped = prepared.skipped;
  if (!prepared.module && failed(start(request, options, prepared, failure)))
    return std::nullopt;
  function.warnings = prepared.warnings;
  if (prepared.symbol.empty())
    return function;
  for (TreeOp tree : prepared.module->getOps<TreeOp>())
    function.trees.push_back(tree.getSymName().str());
  function.interpreter = makeInterpreter(std::move(prepared.module),
                                         prepared.symbol, options, failure);
  if (!function.interpreter)
    return std::nullopt;

  WorkerLease lease(*this, options);
  std::unique_ptr<ObjectCompiler> &objects = (*lease).objects;
  auto fail = [&](llvm::Error error) -> std::optional<Function> {
    failure = Failure::get(FailureKind::Internal,
                           "code generation failed: " +
                               llvm::toString(std::move(error)));
    return std::nullopt;
  };
  if (!objects) {
    auto made = ObjectCompiler::create(options.codegen);
    if (!made)
      return fail(made.takeError());
    objects = std::move(*made);
  }
  llvm::LLVMContext context;
  llvm::Module module(prepared.symbol, context);
  buildInterpreterEntry(module, prepared.symbol, function.interpreter.get());
  if (llvm::Error error = objects->optimize(module))
    return fail(std::move(error));
  auto code = objects->emitObject(module);
  if (!code)
    return fail(code.takeError());
  CompiledObject object;
  object.symbol = prepared.symbol;
  object.code = std::move(*code);
  if (failed(link(object, request.name, function, failure)))
    return std::nullopt;
  return function;
}
