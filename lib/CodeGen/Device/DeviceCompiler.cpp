//===- DeviceCompiler.cpp - From a gpu.module to an image -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Device/DeviceCompiler.h"
#include "../CodegenErrors.h"
#include "../CodegenPasses.h"
#include "mlir/Dialect/GPU/IR/GPUDialect.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/LLVMIR/NVVMDialect.h"
#include "mlir/IR/BuiltinOps.h"
#include "mlir/Target/LLVMIR/Dialect/Builtin/BuiltinToLLVMIRTranslation.h"
#include "mlir/Target/LLVMIR/Dialect/GPU/GPUToLLVMIRTranslation.h"
#include "mlir/Target/LLVMIR/Dialect/LLVMIR/LLVMToLLVMIRTranslation.h"
#include "mlir/Target/LLVMIR/Dialect/NVVM/NVVMToLLVMIRTranslation.h"
#include "mlir/Target/LLVMIR/Export.h"
#include "tai/ABI/DeviceAccesses.h"
#include "tai/CodeGen/Device/Libdevice.h"
#include "tai/CodeGen/Diagnostics.h"
#include "tai/CodeGen/Passes/AggregateAtomics.h"
#include "tai/CodeGen/Passes/FailedAllocations.h"
#include "tai/CodeGen/Passes/GroupLoads.h"
#include "tai/CodeGen/Passes/HugeBodies.h"
#include "tai/CodeGen/Passes/UnrollGridLoops.h"
#include "tai/CodeGen/Passes/VectorizeAtomics.h"
#include "tai/CodeGen/VerifyEach.h"
#include "tai/Support/BlockSize.h"
#include "tai/Support/Places.h"
#include "llvm/ADT/SetVector.h"
#include "llvm/ADT/StringSet.h"
#include "llvm/Bitcode/BitcodeReader.h"
#include "llvm/Bitcode/BitcodeWriter.h"
#include "llvm/IR/Constants.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/Verifier.h"
#include "llvm/Linker/Linker.h"
#include "llvm/MC/TargetRegistry.h"
#include "llvm/Passes/PassBuilder.h"
#include "llvm/Support/SaveAndRestore.h"
#include "llvm/Support/TargetSelect.h"
#include "llvm/Target/TargetMachine.h"
#include "llvm/TargetParser/Triple.h"
#include <mutex>

using namespace mlir;
using namespace mlir::tai;
using llvm::createStringError;
using llvm::Error;
using llvm::Expected;

// The sources that the build generates from lib/DeviceLibrary.
namespace mlir::tai {
extern const unsigned char deviceLibraryNvptx[], deviceLibraryHost[];
extern const unsigned long deviceLibraryNvptxSize, deviceLibraryHostSize;
} // namespace mlir::tai

llvm::ArrayRef<char> mlir::tai::getDeviceLibrary(runtime::DeviceKind kind) {
  bool cuda = kind == runtime::DeviceKind::Cuda;
  const unsigned char *bytes = cuda ? deviceLibraryNvptx : deviceLibraryHost;
  return {reinterpret_cast<const char *>(bytes),
          cuda ? deviceLibraryNvptxSize : deviceLibraryHostSize};
}

std::string DeviceTarget::str() const {
  return kind == runtime::DeviceKind::Cuda ? "cuda:" + name : "emulated";
}

void mlir::tai::registerDeviceTranslations(DialectRegistry &registry) {
  registry.insert<gpu::GPUDialect, NVVM::NVVMDialect>();
  registerBuiltinDialectTranslation(registry);
  registerLLVMDialectTranslation(registry);
  registerGPUDialectTranslation(registry);
  registerNVVMDialectTranslation(registry);
}

Expected<Operation *> mlir::tai::findDeviceModule(ModuleOp module) {
  Operation *found = nullptr;
  for (auto deviceModule : module.getOps<gpu::GPUModuleOp>()) {
    if (found)
      return createStringError(
          "device code is in several modules, '%s' and '%s'",
          cast<gpu::GPUModuleOp>(found).getName().str().c_str(),
          deviceModule.getName().str().c_str());
    found = deviceModule;
  }
  return found;
}

//===----------------------------------------------------------------------===//
// The target
//===----------------------------------------------------------------------===//

/// The architectures that the code generator supports, each with the oldest
/// version of PTX that supports it and the instructions of the device library.
static constexpr struct {
  unsigned architecture, ptxVersion;
} architectures[] = {{70, 70},  {72, 70},  {75, 70}, {80, 70},
                     {86, 71},  {87, 74},  {89, 78}, {90, 81},
                     {100, 86}, {103, 88}, {120, 87}};

/// Chooses the newest processor whose code runs on the target.
static Error choosePtxTarget(StringRef name, unsigned &architecture,
                             unsigned &ptxVersion) {
  StringRef digits = name;
  unsigned number = 0;
  if (!digits.consume_front("sm_") || digits.getAsInteger(10, number) ||
      number < architectures[0].architecture)
    return createStringError(
        "unknown GPU '%s': code is made for sm_70 and later",
        name.str().c_str());
  for (const auto &known : architectures) {
    if (known.architecture > number)
      break;
    architecture = known.architecture;
    ptxVersion = known.ptxVersion;
  }
  return Error::success();
}

DeviceCompiler::DeviceCompiler(const DeviceTarget &target,
                               const CodegenOptions &options)
    : target(target), options(options) {}

DeviceCompiler::~DeviceCompiler() {
  if (isBroken()) {
    (void)machine.release();
    (void)objects.release();
  }
}

bool DeviceCompiler::isBroken() const {
  return broken || (objects && objects->isBroken());
}

Expected<std::unique_ptr<DeviceCompiler>>
DeviceCompiler::create(const DeviceTarget &target,
                       const CodegenOptions &options) {
  std::unique_ptr<DeviceCompiler> compiler(new DeviceCompiler(target, options));
  if (!compiler->isCuda()) {
    auto objects = ObjectCompiler::create(options);
    if (!objects)
      return objects.takeError();
    compiler->objects = std::move(*objects);
    return compiler;
  }
  static std::once_flag initialized;
  std::call_once(initialized, [] {
    LLVMInitializeNVPTXTargetInfo();
    LLVMInitializeNVPTXTarget();
    LLVMInitializeNVPTXTargetMC();
    LLVMInitializeNVPTXAsmPrinter();
  });
  unsigned architecture = 0, ptxVersion = 0;
  if (Error error = choosePtxTarget(target.name, architecture, ptxVersion))
    return error;
  std::string cpu = "sm_" + std::to_string(architecture);
  std::string features = "+ptx" + std::to_string(ptxVersion);
  std::string message;
  compiler->hasVectorAtomics = architecture >= 90;
  llvm::Triple triple("nvptx64-nvidia-cuda");
  const llvm::Target *nvptx =
      llvm::TargetRegistry::lookupTarget(triple, message);
  if (!nvptx)
    return createStringError("no code generator for NVIDIA GPUs: %s",
                             message.c_str());
  llvm::TargetOptions targetOptions;
  // PTX operations must say whether they may be fused, because ptxas fuses
  // multiplications and additions by default.
  targetOptions.AllowFPOpFusion = options.contract || options.fastMath
                                      ? llvm::FPOpFusion::Fast
                                      : llvm::FPOpFusion::Strict;
  compiler->machine.reset(nvptx->createTargetMachine(
      triple, cpu, features, targetOptions, llvm::Reloc::PIC_, std::nullopt,
      options.optLevel == 0 ? llvm::CodeGenOptLevel::None
                            : llvm::CodeGenOptLevel::Aggressive));
  if (!compiler->machine)
    return createStringError("no target machine for %s", cpu.c_str());
  return compiler;
}

//===----------------------------------------------------------------------===//
// Libraries
//===----------------------------------------------------------------------===//

/// Links the used functions of a library, without the processor attributes of
/// the compiler that built it: attributes that differ from the caller's prevent
/// inlining.
static Error linkNeeded(llvm::Module &module, llvm::MemoryBufferRef bitcode) {
  auto library = llvm::getLazyBitcodeModule(bitcode, module.getContext());
  if (!library)
    return library.takeError();
  (*library)->setTargetTriple(module.getTargetTriple());
  (*library)->setDataLayout(module.getDataLayout());
  llvm::StringSet<> before;
  for (const llvm::Function &function : module)
    if (!function.isDeclaration())
      before.insert(function.getName());
  if (llvm::Linker::linkModules(module, std::move(*library),
                                llvm::Linker::LinkOnlyNeeded))
    return createStringError("a library does not link with device code");
  for (llvm::Function &function : module) {
    if (before.contains(function.getName()))
      continue;
    llvm::AttributeList attributes = function.getAttributes();
    for (llvm::Attribute attribute : attributes.getFnAttrs())
      if (attribute.isStringAttribute())
        function.removeFnAttr(attribute.getKindAsString());
  }
  return Error::success();
}

/// Lists the names of the functions that use the missing function.
static std::string getUsers(const llvm::Function &missing) {
  llvm::StringSet<> names;
  for (const llvm::User *user : missing.users())
    if (auto *instruction = dyn_cast<llvm::Instruction>(user))
      names.insert(instruction->getFunction()->getName());
  SmallVector<StringRef> sorted(names.keys());
  llvm::sort(sorted);
  return sorted.empty() ? "device code"
                        : "'" + llvm::join(sorted, "', '") + "'";
}

/// Replaces calls of __nvvm_reflect with the argument `question` by the
/// constant `answer`. Libdevice makes these calls to ask its compiler about
/// modes; LLVM itself answers the questions about denormals and about the
/// processor.
static void answerReflection(llvm::Module &module, StringRef question,
                             unsigned answer) {
  llvm::Function *reflect = module.getFunction("__nvvm_reflect");
  if (!reflect)
    return;
  for (llvm::User *user : llvm::make_early_inc_range(reflect->users())) {
    auto *call = dyn_cast<llvm::CallInst>(user);
    if (!call || call->arg_size() != 1)
      continue;
    auto *text = dyn_cast<llvm::GlobalVariable>(
        call->getArgOperand(0)->stripPointerCasts());
    auto *bytes =
        text && text->hasInitializer()
            ? dyn_cast<llvm::ConstantDataArray>(text->getInitializer())
            : nullptr;
    if (!bytes || !bytes->isCString() || bytes->getAsCString() != question)
      continue;
    call->replaceAllUsesWith(llvm::ConstantInt::get(call->getType(), answer));
    call->eraseFromParent();
  }
}

Error DeviceCompiler::linkLibdevice(llvm::Module &module) {
  const llvm::Function *wanted = nullptr;
  for (const llvm::Function &function : module)
    if (function.isDeclaration() && !function.use_empty() &&
        function.getName().starts_with("__nv_")) {
      wanted = &function;
      break;
    }
  if (!wanted)
    return Error::success();
  std::string searched;
  std::optional<llvm::MemoryBufferRef> library = getLibdevice(searched);
  if (!library)
    return createStringError(
        "%s calls '%s' of CUDA's math library, but there is no "
        "libdevice.10.bc: set CUDA_HOME to where CUDA is; searched: %s",
        getUsers(*wanted).c_str(), wanted->getName().str().c_str(),
        searched.c_str());
  if (Error error = linkNeeded(module, *library))
    return error;
  answerReflection(module, "__CUDA_PREC_SQRT", !options.fastMath);
  return Error::success();
}

Error DeviceCompiler::link(llvm::Module &module) {
  llvm::ArrayRef<char> library = getDeviceLibrary(target.kind);
  llvm::MemoryBufferRef bitcode(StringRef(library.data(), library.size()),
                                "device library");
  if (Error error = linkNeeded(module, bitcode))
    return error;
  return isCuda() ? linkLibdevice(module) : Error::success();
}

//===----------------------------------------------------------------------===//
// Translation
//===----------------------------------------------------------------------===//

llvm::Function *mlir::tai::addSlotsFunction(llvm::Function &kernel) {
  llvm::LLVMContext &context = kernel.getContext();
  llvm::IRBuilder<> builder(context);
  auto *type =
      llvm::FunctionType::get(builder.getVoidTy(), {builder.getPtrTy()}, false);
  auto *wrapper = llvm::Function::Create(
      type, llvm::GlobalValue::ExternalLinkage, kernel.getName() + kSlotsSuffix,
      kernel.getParent());
  builder.SetInsertPoint(llvm::BasicBlock::Create(context, "", wrapper));
  SmallVector<llvm::Value *> arguments;
  for (llvm::Argument &parameter : kernel.args()) {
    llvm::Value *slot = builder.CreateConstInBoundsGEP1_64(
        builder.getInt64Ty(), wrapper->getArg(0), parameter.getArgNo());
    llvm::Type *type = parameter.getType();
    // A parameter of type i1 takes a byte of its slot.
    if (type->isIntegerTy(1))
      arguments.push_back(builder.CreateTrunc(
          builder.CreateAlignedLoad(builder.getInt8Ty(), slot, llvm::Align(8)),
          type));
    else
      arguments.push_back(
          builder.CreateAlignedLoad(type, slot, llvm::Align(8)));
  }
  builder.CreateCall(&kernel, arguments);
  builder.CreateRetVoid();
  return wrapper;
}

/// Checks that each parameter of a kernel fits a slot of eight bytes.
static Error checkParameters(const llvm::Function &kernel) {
  if (!kernel.getReturnType()->isVoidTy())
    return createStringError("kernel '%s' returns a value",
                             kernel.getName().str().c_str());
  const llvm::DataLayout &layout = kernel.getParent()->getDataLayout();
  for (const llvm::Argument &parameter : kernel.args()) {
    llvm::Type *type = parameter.getType();
    if (!type->isSingleValueType() || type->isVectorTy() ||
        layout.getTypeStoreSize(type) > 8)
      return createStringError(
          "parameter %u of kernel '%s' does not fit into eight bytes",
          parameter.getArgNo(), kernel.getName().str().c_str());
  }
  return Error::success();
}

/// The attribute of a function for the handling of f32 denormals, and its value
/// for flushing them to zero.
constexpr StringLiteral kDenormalsAttrName = "denormal-fp-math-f32";
constexpr StringLiteral kFlushing = "preserve-sign,preserve-sign";

/// Sets up the module for PTX: modes of the math library, scopes of atomics.
void DeviceCompiler::prepareForCuda(llvm::Module &module) {
  auto saysFlush = [](const llvm::Function &function) {
    return function.getFnAttribute(kDenormalsAttrName).getValueAsString() ==
           kFlushing;
  };
  auto isKernel = [](const llvm::Function &function) {
    return function.getCallingConv() == llvm::CallingConv::PTX_Kernel;
  };
  // The module flag "nvvm-reflect-ftz" makes all of libdevice flush denormals,
  // so it is set only if all kernels of the module flush.
  auto kernels = llvm::make_filter_range(module, isKernel);
  if (!kernels.empty() && llvm::all_of(kernels, saysFlush))
    module.addModuleFlag(llvm::Module::Override, "nvvm-reflect-ftz", 1);
  // Atomic operations order memory only among the threads of this device, so
  // their scope is the device.
  llvm::SyncScope::ID device =
      module.getContext().getOrInsertSyncScopeID("device");
  for (llvm::Function &function : module) {
    if (function.isDeclaration())
      continue;
    function.setDoesNotThrow();
    function.addFnAttr("no-trapping-math", "true");
    for (llvm::Instruction &instruction : llvm::instructions(function)) {
      auto scope = llvm::getAtomicSyncScopeID(&instruction);
      if (scope && *scope == llvm::SyncScope::System)
        llvm::setAtomicSyncScopeID(&instruction, device);
    }
  }
}

void DeviceCompiler::setTarget(llvm::Module &module) {
  if (!isCuda())
    return objects->setTarget(module);
  module.setTargetTriple(machine->getTargetTriple());
  module.setDataLayout(machine->createDataLayout());
}

DeviceCode DeviceCompiler::createCode(StringRef name) {
  DeviceCode code;
  code.context = std::make_unique<llvm::LLVMContext>();
  code.module = std::make_unique<llvm::Module>(name, *code.context);
  setTarget(*code.module);
  return code;
}

Expected<runtime::DeviceImage> DeviceCompiler::finish(
    DeviceCode &code,
    llvm::function_ref<bool(const llvm::GlobalValue &)> isVisible,
    llvm::function_ref<void()> prepare) {
  llvm::Module &module = *code.module;
  if (Error error = link(module))
    return error;
  if (prepare)
    prepare();
  for (llvm::GlobalValue &value : module.global_values())
    if (!value.isDeclaration() && !isVisible(value))
      value.setLinkage(llvm::GlobalValue::InternalLinkage);
  if (isCuda())
    prepareForCuda(module);
  if (linkedHook) {
    auto known = linkedHook(module);
    if (!known)
      return known.takeError();
    if (*known)
      return std::move(**known);
  }
  // Additions of a warp to data-dependent elements have been combined, if at
  // all, when the kernels were compiled, so they are not combined again.
  llvm::SaveAndRestore combine(options.combineScatters, false);
  if (Error error = optimize(code))
    return error;
  return emit(code);
}

/// The maximum number of threads that a kernel declares. Passes would rely on
/// this attribute; but programs reuse the bitcode with other block sizes. So it
/// is removed, and only the driver is told.
constexpr StringLiteral kMostThreadsAttrName = "nvvm.maxntid";

static std::string takeMostThreads(llvm::Function &kernel) {
  std::string most =
      kernel.getFnAttribute(kMostThreadsAttrName).getValueAsString().str();
  kernel.removeFnAttr(kMostThreadsAttrName);
  return most;
}

static void putBackMostThreads(DeviceCode &code) {
  for (auto [name, most] : llvm::zip(code.functions, code.mostThreads))
    if (!most.empty())
      code.module->getFunction(name)->addFnAttr(kMostThreadsAttrName, most);
}

static bool saysWhatIsApproximate(const llvm::Module &module) {
  return llvm::any_of(module, [](const llvm::Function &function) {
    return llvm::any_of(llvm::instructions(function), [](auto &instruction) {
      return isa<llvm::FPMathOperator>(instruction) &&
             instruction.hasApproxFunc();
    });
  });
}

Expected<DeviceCode> DeviceCompiler::translate(Operation *deviceModule) {
  DeviceCode code;
  for (Operation &op : deviceModule->getRegion(0).front())
    if (auto function = dyn_cast<LLVM::LLVMFuncOp>(op))
      if (function->hasAttr(gpu::GPUDialect::getKernelFuncAttrName()) ||
          function->hasAttr(NVVM::NVVMDialect::getKernelFuncAttrName())) {
        code.functions.push_back(function.getName().str());
        code.places.push_back(describePlace(function.getLoc()));
        code.blockSizes.push_back(getBlockSize(function).value_or(0));
        auto list = function->getAttrOfType<DenseI64ArrayAttr>("tai.accesses");
        code.accesses.emplace_back();
        if (list)
          code.accesses.back() = list.asArrayRef().vec();
        if (auto sites =
                function->getAttrOfType<DenseI64ArrayAttr>("tai.tiles");
            list && sites) {
          code.accesses.back().push_back(
              runtime::FunctionAccesses::sitesFollow);
          llvm::append_range(code.accesses.back(), sites.asArrayRef());
        }
      }
  code.context = std::make_unique<llvm::LLVMContext>();
  code.module = translateModuleToLLVMIR(deviceModule, *code.context, "kernels",
                                        /*disableVerification=*/true);
  if (!code.module)
    return createStringError("");
  llvm::Module &module = *code.module;
  setTarget(module);
  // If any operation allows approximate functions, the kernels' own fast-math
  // flags are kept: they are absent where the order of roundings matters.
  if (isCuda() && options.fastMath && !saysWhatIsApproximate(module))
    allowFastMath(module);
  SmallVector<llvm::GlobalValue *> visible;
  for (const std::string &name : code.functions) {
    llvm::Function *kernel = module.getFunction(name);
    if (!kernel || kernel->isDeclaration())
      return createStringError("kernel '%s' has no body", name.c_str());
    if (Error error = checkParameters(*kernel))
      return error;
    kernel->setCallingConv(isCuda() ? llvm::CallingConv::PTX_Kernel
                                    : llvm::CallingConv::C);
    kernel->setLinkage(llvm::GlobalValue::ExternalLinkage);
    code.mostThreads.push_back(takeMostThreads(*kernel));
    visible.push_back(isCuda() ? kernel : addSlotsFunction(*kernel));
    // A function of one iteration is inlined and optimised later, in the
    // program that calls it.
    if (llvm::Function *tile = module.getFunction(name + runtime::tileSuffix)) {
      tile->setLinkage(llvm::GlobalValue::ExternalLinkage);
      tile->addFnAttr(llvm::Attribute::OptimizeNone);
      tile->addFnAttr(llvm::Attribute::NoInline);
      visible.push_back(tile);
    }
  }
  exitOnFailedAllocations(module);
  if (Error error = link(module))
    return error;
  for (llvm::GlobalValue &value : module.global_values())
    if (!value.isDeclaration() && !llvm::is_contained(visible, &value))
      value.setLinkage(llvm::GlobalValue::InternalLinkage);
  if (isCuda())
    prepareForCuda(module);
  std::string message;
  llvm::raw_string_ostream stream(message);
  if (llvm::verifyModule(module, &stream))
    return createStringError("device code is not valid: %s", message.c_str());
  return code;
}

//===----------------------------------------------------------------------===//
// Optimisation
//===----------------------------------------------------------------------===//

/// Runs an LLVM task on the device code. After a fatal error, the code is
/// leaked, since its objects must not be destroyed.
Error DeviceCompiler::guard(DeviceCode &code, StringRef place,
                            llvm::function_ref<void()> task) {
  Error error = guardFatalErrors(broken, place, task);
  if (broken) {
    (void)code.module.release();
    (void)code.context.release();
  }
  return error;
}

Error DeviceCompiler::optimize(DeviceCode &code) {
  if (isCuda())
    return guard(code, "optimize", [&] { runPasses(*code.module); });
  Error error = objects->optimize(*code.module);
  if (objects->isBroken()) {
    (void)code.module.release();
    (void)code.context.release();
  }
  return error;
}

void DeviceCompiler::runPasses(llvm::Module &module) {
  keepCallsInHugeFunctions(module, "__nv_");
  llvm::LoopAnalysisManager loops;
  llvm::FunctionAnalysisManager functions;
  llvm::CGSCCAnalysisManager sccs;
  llvm::ModuleAnalysisManager modules;
  // The PassBuilder gets the target machine, which registers passes of its own,
  // such as the pass that answers libdevice's questions.
  llvm::PassInstrumentationCallbacks callbacks;
  verifyOwnPasses(callbacks);
  llvm::PassBuilder builder(machine.get(), llvm::PipelineTuningOptions(),
                            std::nullopt, &callbacks);
  if (options.optLevel > 1)
    builder.registerVectorizerStartEPCallback(
        [](llvm::FunctionPassManager &manager, llvm::OptimizationLevel) {
          manager.addPass(UnrollGridLoops());
        });
  if (options.optLevel > 1)
    builder.registerOptimizerLastEPCallback(
        [this](llvm::ModulePassManager &manager, llvm::OptimizationLevel,
               llvm::ThinOrFullLTOPhase) {
          llvm::FunctionPassManager last;
          last.addPass(AggregateAtomics(options.combineScatters));
          last.addPass(GroupLoads());
          manager.addPass(
              llvm::createModuleToFunctionPassAdaptor(std::move(last)));
        });
  builder.registerModuleAnalyses(modules);
  builder.registerCGSCCAnalyses(sccs);
  builder.registerFunctionAnalyses(functions);
  builder.registerLoopAnalyses(loops);
  builder.crossRegisterProxies(loops, functions, sccs, modules);
  llvm::ModulePassManager passes =
      options.optLevel == 0
          ? builder.buildO0DefaultPipeline(llvm::OptimizationLevel::O0)
          : builder.buildPerModuleDefaultPipeline(
                options.optLevel == 1   ? llvm::OptimizationLevel::O1
                : options.optLevel == 2 ? llvm::OptimizationLevel::O2
                                        : llvm::OptimizationLevel::O3);
  passes.run(module, modules);
  divideHugeBlocks(module, /*machine=*/nullptr, HugeBodyLimits::ofDevice());
}

//===----------------------------------------------------------------------===//
// Emission
//===----------------------------------------------------------------------===//

/// True for the functions that the CUDA driver provides to device code.
static bool isDriverFunction(StringRef name) {
  return name == "malloc" || name == "free" || name == "vprintf";
}

/// The driver would refuse to load code that calls missing functions, without
/// naming the caller.
static Error checkExternals(const llvm::Module &module) {
  std::string missing;
  for (const llvm::Function &function : module) {
    if (!function.isDeclaration() || function.isIntrinsic() ||
        function.use_empty() || isDriverFunction(function.getName()))
      continue;
    missing += missing.empty() ? "" : "; ";
    missing +=
        "'" + function.getName().str() + "', called by " + getUsers(function);
  }
  if (missing.empty())
    return Error::success();
  return createStringError("device code calls what a GPU does not have: %s",
                           missing.c_str());
}

/// Fails if PTX calls a function that a GPU does not have. Unlike the overload
/// above, finds calls that the code generator itself has inserted.
static Error checkExternals(StringRef ptx) {
  constexpr StringLiteral keyword = ".extern .func";
  for (size_t at = ptx.find(keyword); at != StringRef::npos;
       at = ptx.find(keyword, at)) {
    StringRef text = ptx.drop_front(at + keyword.size()).ltrim();
    // In PTX, a result parameter is in parentheses before the function's name.
    if (text.starts_with("("))
      text =
          text.drop_until([](char c) { return c == ')'; }).drop_front().ltrim();
    StringRef name = text.take_while(
        [](char c) { return llvm::isAlnum(c) || c == '_' || c == '$'; });
    if (!isDriverFunction(name))
      return createStringError("device code calls what a GPU does not have: "
                               "'%s'",
                               name.str().c_str());
    at += keyword.size();
  }
  return Error::success();
}

/// Returns the module as LLVM bitcode, which can be linked with other kernels
/// into a program.
static std::shared_ptr<const std::string>
getBitcode(const llvm::Module &module) {
  auto bytes = std::make_shared<std::string>();
  llvm::raw_string_ostream stream(*bytes);
  llvm::WriteBitcodeToFile(module, stream);
  return bytes;
}

/// Removes the functions that run single iterations, which only programs of
/// several kernels use.
static void removeTileFunctions(llvm::Module &module,
                                ArrayRef<std::string> functions) {
  SmallVector<llvm::Function *> unused;
  for (const std::string &name : functions)
    if (llvm::Function *tile = module.getFunction(name + runtime::tileSuffix))
      unused.push_back(tile);
  while (!unused.empty()) {
    llvm::Function *function = unused.pop_back_val();
    llvm::SmallSetVector<llvm::Function *, 4> callees;
    for (llvm::Instruction &instruction : llvm::instructions(*function))
      if (auto *call = dyn_cast<llvm::CallBase>(&instruction))
        if (llvm::Function *callee = call->getCalledFunction())
          callees.insert(callee);
    callees.remove(function);
    function->eraseFromParent();
    for (llvm::Function *callee : callees)
      if (callee->use_empty() &&
          (callee->hasLocalLinkage() || callee->isDeclaration()))
        unused.push_back(callee);
  }
}

Expected<runtime::DeviceImage> DeviceCompiler::emit(DeviceCode &code) {
  runtime::DeviceImage image;
  image.kind = target.kind;
  image.functions = code.functions;
  image.places = code.places;
  image.accesses = code.accesses;
  image.blockSizes = code.blockSizes;
  if (isCuda())
    for (llvm::Function &function : *code.module)
      noteAtomicAlignment(function);
  image.bitcode = getBitcode(*code.module);
  removeTileFunctions(*code.module, code.functions);
  if (!isCuda()) {
    auto object = objects->emitObject(*code.module);
    if (objects->isBroken()) {
      (void)code.module.release();
      (void)code.context.release();
    }
    if (!object)
      return object.takeError();
    image.bytes.assign(object->begin(), object->end());
    return image;
  }
  if (Error error = checkExternals(*code.module))
    return error;
  putBackMostThreads(code);
  SmallVector<char, 0> text;
  llvm::raw_svector_ostream stream(text);
  std::string message;
  code.context->setDiagnosticHandler(std::make_unique<CodegenErrors>(message));
  bool supported = true;
  Error error = guard(code, "emit", [&] {
    CodegenPasses passes;
    if (hasVectorAtomics)
      passes.beforeVectorizer = createVectorizeAtomicsPass;
    supported = !machine->addPassesToEmitFile(
        passes, stream, /*DwoOut=*/nullptr, llvm::CodeGenFileType::AssemblyFile,
        /*DisableVerify=*/!verifiesEach());
    if (supported)
      passes.run(*code.module);
  });
  if (error)
    return error;
  code.context->setDiagnosticHandler(nullptr);
  if (!supported)
    return createStringError("this target cannot emit PTX");
  if (!message.empty())
    return createStringError(message);
  image.bytes.assign(text.begin(), text.end());
  if (Error error = checkExternals(StringRef(image.bytes)))
    return error;
  return image;
}
