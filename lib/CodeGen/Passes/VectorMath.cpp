//===- VectorMath.cpp - Elementary functions of vectors -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/VectorMath.h"
#include "llvm/ADT/StringSet.h"
#include "llvm/Analysis/TargetLibraryInfo.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/Module.h"
#include "llvm/IR/Operator.h"
#include "llvm/IR/VFABIDemangler.h"
#include "llvm/MC/MCSubtargetInfo.h"
#include "llvm/Target/TargetMachine.h"

using namespace llvm;
using namespace mlir::tai;

VectorMath::VectorMath(const TargetMachine &machine, bool hasSleef) {
  // The vector functions need fused operations for exact remainders; without
  // these, the scalar functions of libm are no slower.
  const MCSubtargetInfo &target = *machine.getMCSubtargetInfo();
  if (!machine.getTargetTriple().isX86_64() ||
      !target.checkFeatures("+avx2,+fma"))
    return;
  bool has512 = target.checkFeatures("+avx512f,+avx512dq,+avx512vl");

  auto addWide = [&](StringRef name, bool isDouble) {
    Forms wide;
    std::string stem = ("tai_wide_" + name + (isDouble ? "_f64_" : "_")).str();
    wide.scalar = stem + "1";
    unsigned most = isDouble ? 8 : 16;
    for (unsigned lanes : {most / 4, most / 2, most})
      if (lanes < most || has512)
        wide.vectors.push_back({lanes, stem + std::to_string(lanes)});
    add(("llvm." + name + (isDouble ? ".f64" : ".f32")).str(),
        (name + (isDouble ? "" : "f")).str(), wide);
  };
  auto addSleef = [&](StringRef name, StringRef type, unsigned least) {
    // The chosen forms of SLEEF's functions give the same bits for any number
    // of lanes.
    Forms sleef;
    bool isDouble = type == "f64";
    std::string stem = ("Sleef_finz_" + name + (isDouble ? "d" : "f")).str();
    sleef.scalar = stem + "1_u10purecfma";
    unsigned lanes = isDouble ? 2 : 4;
    for (StringRef target : {"avx2128", "avx2", "avx512f"}) {
      // With AVX-512, two calls for 256 bits become one for 512.
      bool isEnough = lanes >= least || (target == "avx2" && has512);
      if (isEnough && (target != "avx512f" || has512))
        sleef.vectors.push_back(
            {lanes, stem + std::to_string(lanes) + ("_u10" + target).str()});
      lanes *= 2;
    }
    if (sleef.vectors.empty())
      return;
    add(("llvm." + name + "." + type).str(),
        (name + (isDouble ? "" : "f")).str(), sleef);
  };
#define TAI_WIDE_FUNCTION(name, arguments) addWide(#name, false);
#define TAI_WIDE_F64_FUNCTION(name) addWide(#name, true);
#include "tai/ABI/VectorMath.def"
  if (!hasSleef)
    return;
#define TAI_SLEEF_FUNCTION(name, type, least) addSleef(#name, #type, least);
#include "tai/ABI/VectorMath.def"
}

void VectorMath::add(StringRef intrinsic, StringRef function,
                     const Forms &added) {
  forms[intrinsic] = added;
  forms[function] = added;
  for (const auto &[half, whole] :
       zip(added.vectors, drop_begin(added.vectors)))
    twice[half.second] = whole.second;
}

const VectorMath::Forms *VectorMath::find(const CallInst &call) const {
  const Function *callee = call.getCalledFunction();
  if (!callee || !callee->isDeclaration() || !isa<FPMathOperator>(call) ||
      !call.hasAllowContract() || call.getType()->isVectorTy())
    return nullptr;
  auto found = forms.find(callee->getName());
  return found == forms.end() ? nullptr : &found->second;
}

/// Declares an external math function that accesses no memory.
static Function *declare(Module &module, StringRef name,
                         llvm::FunctionType *type) {
  auto *function = cast<Function>(
      module.getOrInsertFunction(name, type).getCallee()->stripPointerCasts());
  function->setDoesNotAccessMemory();
  function->setDoesNotThrow();
  function->setWillReturn();
  function->addFnAttr(Attribute::NoCallback);
  function->addFnAttr(Attribute::NoFree);
  function->addFnAttr(Attribute::NoSync);
  return function;
}

/// True if the target library has vector forms of the function that take less
/// time than those of VectorMath. The library's forms of pow for f32 take half
/// as much time again.
static bool hasShorterForms(StringRef name, const TargetLibraryInfo &library) {
  return library.isFunctionVectorizable(name) && name != "llvm.pow.f32" &&
         name != "powf";
}

PreservedAnalyses NameVectorMath::run(Function &function,
                                      FunctionAnalysisManager &analyses) {
  Module &module = *function.getParent();
  const auto &library = analyses.getResult<TargetLibraryAnalysis>(function);
  for (Instruction &instruction : instructions(function)) {
    auto *call = dyn_cast<CallInst>(&instruction);
    const VectorMath::Forms *forms = call ? math->find(*call) : nullptr;
    if (!forms ||
        (besideOthers &&
         hasShorterForms(call->getCalledFunction()->getName(), library)))
      continue;
    llvm::FunctionType *scalar = call->getFunctionType();
    SmallVector<std::string, 3> variants;
    for (const auto &[lanes, name] : forms->vectors) {
      ElementCount count = ElementCount::getFixed(lanes);
      SmallVector<llvm::Type *, 2> types;
      for (llvm::Type *type : scalar->params())
        types.push_back(llvm::VectorType::get(type, count));
      declare(module, name,
              llvm::FunctionType::get(
                  llvm::VectorType::get(scalar->getReturnType(), count), types,
                  /*isVarArg=*/false));
      std::string prefix = "_ZGV_LLVM_N" + std::to_string(lanes) +
                           std::string(types.size(), 'v');
      variants.push_back(VecDesc(call->getCalledFunction()->getName(), name,
                                 count, /*Masked=*/false, prefix,
                                 /*Conv=*/std::nullopt)
                             .getVectorFunctionABIVariantString());
    }
    VFABI::setVectorVariantNames(call, variants);
  }
  return PreservedAnalyses::all();
}

/// Joins calls of one vector form in the block, in pairs, if their results are
/// first needed behind both.
static bool joinCalls(BasicBlock &block, const VectorMath &math) {
  bool changed = false;
  // Calls that were not joined yet, at most one of each form, whose results no
  // instruction used so far.
  SmallVector<CallInst *> open;
  for (Instruction &instruction : make_early_inc_range(block)) {
    erase_if(open, [&](CallInst *call) {
      return is_contained(instruction.operands(), call);
    });
    auto *second = dyn_cast<CallInst>(&instruction);
    if (!second || !second->getCalledFunction())
      continue;
    Function *form = second->getCalledFunction();
    StringRef wider = math.findTwice(form->getName());
    if (wider.empty())
      continue;
    auto *found = find_if(open, [&](CallInst *call) {
      return call->getCalledFunction() == form;
    });
    if (found == open.end()) {
      open.push_back(second);
      continue;
    }
    CallInst *first = *found;
    open.erase(found);
    IRBuilder<> builder(second);
    SmallVector<Value *, 2> arguments;
    SmallVector<llvm::Type *, 2> types;
    unsigned lanes =
        cast<FixedVectorType>(form->getReturnType())->getNumElements();
    SmallVector<int> all = to_vector(seq<int>(0, 2 * lanes));
    for (auto [a, b] : zip(first->args(), second->args())) {
      arguments.push_back(builder.CreateShuffleVector(a, b, all));
      types.push_back(arguments.back()->getType());
    }
    llvm::Type *result = llvm::VectorType::getDoubleElementsVectorType(
        cast<llvm::VectorType>(form->getReturnType()));
    CallInst *joined = builder.CreateCall(
        declare(*form->getParent(), wider,
                llvm::FunctionType::get(result, types, /*isVarArg=*/false)),
        arguments);
    FastMathFlags flags = first->getFastMathFlags();
    flags &= second->getFastMathFlags();
    joined->setFastMathFlags(flags);
    ArrayRef<int> halves = all;
    first->replaceAllUsesWith(
        builder.CreateShuffleVector(joined, halves.take_front(lanes)));
    second->replaceAllUsesWith(
        builder.CreateShuffleVector(joined, halves.drop_front(lanes)));
    first->eraseFromParent();
    second->eraseFromParent();
    changed = true;
  }
  return changed;
}

PreservedAnalyses JoinVectorMath::run(Function &function,
                                      FunctionAnalysisManager &) {
  bool changed = false;
  for (BasicBlock &block : function)
    changed |= joinCalls(block, *math);
  if (!changed)
    return PreservedAnalyses::all();
  PreservedAnalyses preserved;
  preserved.preserveSet<CFGAnalyses>();
  return preserved;
}

PreservedAnalyses MatchScalarMath::run(Function &function,
                                       FunctionAnalysisManager &) {
  SmallVector<std::pair<CallInst *, const VectorMath::Forms *>> scalars;
  StringSet<> vectors;
  for (Instruction &instruction : instructions(function)) {
    auto *call = dyn_cast<CallInst>(&instruction);
    if (!call || !call->getCalledFunction())
      continue;
    if (const VectorMath::Forms *forms = math->find(*call))
      scalars.push_back({call, forms});
    else if (call->getType()->isVectorTy())
      vectors.insert(call->getCalledFunction()->getName());
  }
  bool changed = false;
  for (auto [call, forms] : scalars) {
    call->removeFnAttr(VFABI::MappingsAttrName);
    if (!everywhere && none_of(forms->vectors, [&](const auto &form) {
          return vectors.contains(form.second);
        }))
      continue;
    call->setCalledFunction(
        declare(*function.getParent(), forms->scalar, call->getFunctionType()));
    changed = true;
  }
  if (!changed)
    return PreservedAnalyses::all();
  PreservedAnalyses preserved;
  preserved.preserveSet<CFGAnalyses>();
  return preserved;
}
