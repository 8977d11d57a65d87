//===- ObjectCompiler.cpp - LLVM IR to object code for this CPU -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/ObjectCompiler.h"
#include "CodegenErrors.h"
#include "CodegenPasses.h"
#include "tai/CodeGen/Passes/ExpandBfloat.h"
#include "tai/CodeGen/Passes/ExtremeAtomics.h"
#include "tai/CodeGen/Passes/HalfAtomics.h"
#include "tai/CodeGen/Passes/HugeBodies.h"
#include "tai/CodeGen/Passes/InsertSafepoints.h"
#include "tai/CodeGen/Passes/ManyLoops.h"
#include "tai/CodeGen/Passes/TransposeColumns.h"
#include "tai/CodeGen/Passes/VectorMath.h"
#include "tai/CodeGen/Passes/VectorizeLoops.h"
#include "tai/CodeGen/Passes/WidenSums.h"
#include "tai/CodeGen/VerifyEach.h"
#include "llvm/Analysis/TargetLibraryInfo.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/Module.h"
#include "llvm/IR/Operator.h"
#include "llvm/MC/TargetRegistry.h"
#include "llvm/Passes/PassBuilder.h"
#include "llvm/Support/DynamicLibrary.h"
#include "llvm/Support/TargetSelect.h"
#include "llvm/Target/TargetMachine.h"
#include "llvm/TargetParser/Host.h"
#include "llvm/TargetParser/SubtargetFeature.h"
#include "llvm/TargetParser/Triple.h"
#include "llvm/TargetParser/X86TargetParser.h"
#include "llvm/Transforms/Instrumentation/AddressSanitizer.h"
#include "llvm/Transforms/Scalar/GVN.h"
#include "llvm/Transforms/Utils/InjectTLIMappings.h"

using namespace llvm;
using namespace mlir::tai;

const TargetCpu &TargetCpu::getHost() {
  static const TargetCpu host = [] {
    InitializeNativeTarget();
    InitializeNativeTargetAsmPrinter();
    InitializeNativeTargetAsmParser();
    TargetCpu cpu;
    cpu.triple = sys::getProcessTriple();
    cpu.name = sys::getHostCPUName().str();
    // The names of CPU features are sorted, because the string is part of the
    // key of cached code.
    StringMap<bool> map = sys::getHostCPUFeatures();
    SmallVector<StringRef> names(map.keys());
    sort(names);
    SubtargetFeatures features;
    for (StringRef name : names)
      features.AddFeature(name, map[name]);
    cpu.features = features.getString();
    return cpu;
  }();
  return host;
}

Expected<TargetCpu> TargetCpu::find(StringRef name) {
  const TargetCpu &host = getHost();
  if (name.empty())
    return host;
  SmallVector<StringRef> known;
  if (Triple(host.triple).isX86_64())
    X86::fillValidCPUArchList(known, /*Only64Bit=*/true);
  if (!is_contained(known, name))
    return createStringError("LLVM knows no '%s' here, but for example %s",
                             name.str().c_str(),
                             known.empty() ? "native" : "x86-64-v3");
  SmallVector<StringRef> needed;
  X86::getFeaturesForCPU(name, needed);
  StringMap<bool> has = sys::getHostCPUFeatures();
  for (StringRef feature : needed)
    if (auto found = has.find(feature); found != has.end() && !found->second)
      return createStringError("its code needs '%s', which this processor, "
                               "%s, does not have",
                               feature.str().c_str(), host.name.c_str());
  return TargetCpu{host.triple, name.str(), /*features=*/""};
}

ObjectCompiler::ObjectCompiler(const CodegenOptions &options)
    : options(options) {}

ObjectCompiler::~ObjectCompiler() = default;

Expected<std::unique_ptr<ObjectCompiler>>
ObjectCompiler::create(const CodegenOptions &options) {
  Expected<TargetCpu> cpu = TargetCpu::find(options.targetCpu);
  if (!cpu)
    return cpu.takeError();
  Triple triple(cpu->triple);
  std::string message;
  const Target *target = TargetRegistry::lookupTarget(triple, message);
  if (!target)
    return createStringError("no code generator for this CPU: %s",
                             message.c_str());
  TargetOptions targetOptions;
  targetOptions.AllowFPOpFusion =
      options.contract ? FPOpFusion::Fast : FPOpFusion::Standard;
  // Exceptions do not pass through compiled kernels.
  targetOptions.ExceptionModel = ExceptionHandling::None;
  static constexpr CodeGenOptLevel levels[] = {
      CodeGenOptLevel::None, CodeGenOptLevel::Less, CodeGenOptLevel::Default,
      CodeGenOptLevel::Aggressive};
  std::unique_ptr<ObjectCompiler> compiler(new ObjectCompiler(options));
  // Code is position-independent, in the small code model: the linker may place
  // it anywhere, and it reaches the runtime through its own table.
  compiler->machine.reset(target->createTargetMachine(
      triple, cpu->name, cpu->features, targetOptions, Reloc::PIC_,
      CodeModel::Small, levels[std::min(options.optLevel, 3u)], /*JIT=*/true));
  if (!compiler->machine)
    return createStringError("no target machine for %s", cpu->triple.c_str());
  compiler->vectorMath = std::make_unique<VectorMath>(
      *compiler->machine, is_contained(getVectorLibraries(), kSleef));
  return compiler;
}

void mlir::tai::allowFastMath(Module &module) {
  FastMathFlags flags;
  flags.setAllowReassoc();
  flags.setNoSignedZeros();
  flags.setAllowReciprocal();
  flags.setAllowContract();
  flags.setApproxFunc();
  for (Function &function : module)
    for (Instruction &instruction : instructions(function))
      if (isa<FPMathOperator>(instruction))
        instruction.setFastMathFlags(instruction.getFastMathFlags() | flags);
}

ArrayRef<StringRef> mlir::tai::getVectorLibraries() {
  static const SmallVector<StringRef, 2> found = [] {
    SmallVector<StringRef, 2> libraries;
    for (StringRef name : {kGlibcVectors, kSleef})
      if (sys::DynamicLibrary::getPermanentLibrary(name.data()).isValid())
        libraries.push_back(name);
    return libraries;
  }();
  return found;
}

//===----------------------------------------------------------------------===//
// Optimisation
//===----------------------------------------------------------------------===//

Error ObjectCompiler::optimize(Module &module) {
  return guardFatalErrors(broken, "optimize", [&] { runPasses(module); });
}

/// True if the SLP vectoriser should run on the module. Its time grows with the
/// square of a block's size, and unrolled programs have blocks that would take
/// seconds. Blocks with compensated sums are longer for the same work and gain
/// more, so they may be larger.
static bool hasBlocksForVectors(const Module &module) {
  for (const Function &function : module) {
    // The attribute holds the modes of the kernel that the function belongs to,
    // as Modes.h writes them.
    StringRef modes = function.getFnAttribute("tai.modes").getValueAsString();
    size_t most = modes.contains("sums=compensated") ? 5000 : 2000;
    for (const BasicBlock &block : function)
      if (block.size() >= most)
        return false;
  }
  return true;
}

namespace {
/// Global value numbering without one of its transformations: it would carry a
/// load over to the next iteration of a loop. A stencil reads each element in
/// several iterations, and a value carried across branches or stores keeps the
/// loop from being vectorised.
struct StencilGVN : PassInfoMixin<StencilGVN> {
  PreservedAnalyses run(Function &function, FunctionAnalysisManager &analyses) {
    return GVNPass(GVNOptions().setLoadInLoopPRE(false))
        .run(function, analyses);
  }
};
} // namespace

void ObjectCompiler::setTarget(Module &module) {
  module.setTargetTriple(machine->getTargetTriple());
  module.setDataLayout(machine->createDataLayout());
}

void ObjectCompiler::runPasses(Module &module) {
  setTarget(module);
  bool keepsDenormals = !options.fastMath && module.getTargetTriple().isX86();
  if (keepsDenormals)
    expandBfloat(module);
  if (options.fastMath)
    allowFastMath(module);
  for (Function &function : module) {
    if (function.isDeclaration())
      continue;
    function.setDoesNotThrow();
    function.addFnAttr("no-trapping-math", "true");
    // A Newton step from an estimate of 1 / 0 or 1 / infinity yields NaN, which
    // the fast-math flags of arithmetic, which kernels in fast mode have, do
    // not permit.
    function.addFnAttr("reciprocal-estimates", "none");
    if (options.sanitizeAddress)
      function.addFnAttr(llvm::Attribute::SanitizeAddress);
  }

  PipelineTuningOptions tuning;
  tuning.LoopVectorization = options.optLevel > 1;
  tuning.SLPVectorization = options.optLevel > 1 && hasBlocksForVectors(module);
  tuning.LoopInterleaving = options.optLevel > 1;
  LoopAnalysisManager loops;
  FunctionAnalysisManager functions;
  CGSCCAnalysisManager sccs;
  ModuleAnalysisManager modules;
  TargetLibraryInfoImpl libraryInfo(machine->getTargetTriple());
  // The transformation of pow(2^n, x) to exp2(n x) is disabled, because the
  // product is rounded, and the error grows with it.
  if (!options.fastMath)
    for (LibFunc function : {LibFunc_exp2, LibFunc_exp2f, LibFunc_exp2l})
      libraryInfo.setUnavailable(function);
  // Results of libmvec are within 4 ulp, which only fast_math may accept.
  if (options.fastMath && machine->getTargetTriple().isX86() &&
      is_contained(getVectorLibraries(), kGlibcVectors))
    libraryInfo.addVectorizableFunctionsFromVecLib(VectorLibrary::LIBMVEC,
                                                   machine->getTargetTriple());
  functions.registerPass([&] { return TargetLibraryAnalysis(libraryInfo); });
  // StencilGVN and VectorizeLoops replace the pipeline's own value numbering
  // and loop vectoriser, which no option of the pipeline disables alone.
  PassInstrumentationCallbacks callbacks;
  bool isDivided = divideManyLoops(module);
  callbacks.registerShouldRunOptionalPassCallback(
      [isDivided](StringRef name, const Any &ir) {
        return name != "GVNPass" && name != "LoopVectorizePass" &&
               KeepHugeLoopsScalar::canRun(name, ir) &&
               !(isDivided && looksThroughCalls(name));
      });
  verifyOwnPasses(callbacks);
  PassBuilder builder(machine.get(), tuning, std::nullopt, &callbacks);
  builder.registerScalarOptimizerLateEPCallback(
      [](FunctionPassManager &late, OptimizationLevel) {
        late.addPass(StencilGVN());
      });
  builder.registerVectorizerStartEPCallback(
      [&](FunctionPassManager &early, OptimizationLevel level) {
        early.addPass(KeepHugeLoopsScalar());
        if (level == OptimizationLevel::O0)
          return;
        // Registers the functions that have vector forms. The pipeline has a
        // pass for this, which runs too late.
        early.addPass(InjectTLIMappings());
        // With fast_math, loops call the vector functions of glibc where these
        // exist, since they are shorter.
        early.addPass(NameVectorMath(*vectorMath,
                                     /*besideOthers=*/options.fastMath));
        early.addPass(VectorizeLoops(LoopVectorizeOptions(
            !tuning.LoopInterleaving, !tuning.LoopVectorization)));
      });
  builder.registerVectorizerEndEPCallback(
      [&](FunctionPassManager &late, OptimizationLevel level) {
        late.addPass(TransposeColumns());
        late.addPass(WidenSums());
        late.addPass(JoinVectorMath(*vectorMath));
        // Calls that may be contracted, in a kernel compiled without
        // contraction, belong to a deterministic kernel. Its results must not
        // depend on whether a loop is vectorised, and vectorisation depends on
        // the work that passes removed.
        if (!options.fastMath && level != OptimizationLevel::O0)
          late.addPass(
              MatchScalarMath(*vectorMath, /*everywhere=*/!options.contract));
      });
  builder.registerOptimizerLastEPCallback(
      [](ModulePassManager &last, OptimizationLevel, ThinOrFullLTOPhase) {
        last.addPass(createModuleToFunctionPassAdaptor(InsertSafepoints()));
      });
  if (options.sanitizeAddress)
    builder.registerOptimizerLastEPCallback(
        [](ModulePassManager &last, OptimizationLevel, ThinOrFullLTOPhase) {
          // Object code is loaded and unloaded without constructors and
          // destructors.
          last.addPass(AddressSanitizerPass(
              AddressSanitizerOptions(), /*UseGlobalGC=*/false,
              /*UseOdrIndicator=*/false, AsanDtorKind::None,
              AsanCtorKind::None));
        });
  builder.registerModuleAnalyses(modules);
  builder.registerCGSCCAnalyses(sccs);
  builder.registerFunctionAnalyses(functions);
  builder.registerLoopAnalyses(loops);
  builder.crossRegisterProxies(loops, functions, sccs, modules);
  static const OptimizationLevel levels[] = {
      OptimizationLevel::O0, OptimizationLevel::O1, OptimizationLevel::O2,
      OptimizationLevel::O3};
  ModulePassManager passes = builder.buildPerModuleDefaultPipeline(
      levels[std::min(options.optLevel, 3u)]);
  passes.run(module, modules);
  if (options.optLevel > 0)
    testExtremeAtomics(module);
  expandHalfAtomics(module);
  if (keepsDenormals)
    expandBfloat(module);
}

//===----------------------------------------------------------------------===//
// Code generation
//===----------------------------------------------------------------------===//

Error ObjectCompiler::emit(Module &module, raw_pwrite_stream &stream,
                           bool assembly) {
  std::string message;
  module.getContext().setDiagnosticHandler(
      std::make_unique<CodegenErrors>(message));
  bool supported = true;
  Error error = guardFatalErrors(broken, "emit", [&] {
    divideHugeBlocks(module, machine.get());
    CodegenPasses passes;
    supported = !machine->addPassesToEmitFile(
        passes, stream, /*DwoOut=*/nullptr,
        assembly ? CodeGenFileType::AssemblyFile : CodeGenFileType::ObjectFile,
        /*DisableVerify=*/!verifiesEach());
    if (supported)
      passes.run(module);
  });
  if (error)
    return error;
  module.getContext().setDiagnosticHandler(nullptr);
  if (!supported)
    return createStringError("this target cannot emit the file type");
  if (!message.empty())
    return createStringError(message);
  return Error::success();
}

Expected<SmallVector<char, 0>> ObjectCompiler::emitObject(Module &module) {
  SmallVector<char, 0> object;
  raw_svector_ostream stream(object);
  if (Error error = emit(module, stream, /*assembly=*/false))
    return error;
  return object;
}

Expected<std::string> ObjectCompiler::emitAssembly(Module &module) {
  SmallVector<char, 0> text;
  raw_svector_ostream stream(text);
  if (Error error = emit(module, stream, /*assembly=*/true))
    return error;
  return std::string(text.begin(), text.end());
}
