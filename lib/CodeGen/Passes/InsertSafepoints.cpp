//===- InsertSafepoints.cpp - Polls in loops that may run long ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A poll is two loads, a comparison and a branch that is rarely taken:
// negligible for a body with calls or inner loops, and a few percent for the
// shortest vectorised loops. A loop without calls that is known to be short has
// no poll.
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/InsertSafepoints.h"
#include "tai/ABI/Abi.h"
#include "tai/CodeGen/Passes/ManyLoops.h"
#include "llvm/Analysis/LoopInfo.h"
#include "llvm/Analysis/ScalarEvolution.h"
#include "llvm/Analysis/ScalarEvolutionExpressions.h"
#include "llvm/IR/Dominators.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/MDBuilder.h"
#include "llvm/IR/Module.h"
#include "llvm/Transforms/Utils/BasicBlockUtils.h"
#include <cstddef>

using namespace llvm;
using namespace mlir::tai;

/// Whether a function may return early follows from its type, which no
/// optimisation level changes.
bool mlir::tai::mayReturnEarly(const Function &function) {
  llvm::FunctionType *type = function.getFunctionType();
  if (type->isVarArg())
    return false;
  if (function.hasFnAttribute(kLoopPart))
    return type->getReturnType()->isIntegerTy(32);
  auto isPointer = [&](unsigned i) {
    return type->getParamType(i)->isPointerTy();
  };
  auto isLong = [&](unsigned i) {
    return type->getParamType(i)->isIntegerTy(64);
  };
  if (type->getReturnType()->isIntegerTy(32))
    return type->getNumParams() == 1 && isPointer(0) &&
           !function.hasLocalLinkage();
  return type->getReturnType()->isVoidTy() && type->getNumParams() == 5 &&
         isPointer(0) && isPointer(1) && isLong(2) && isLong(3) && isLong(4);
}

namespace {
/// Loops that take fewer instructions than this end within a millisecond, and
/// need no safepoint.
constexpr uint64_t kShortLoop = 200000;

/// If the function is the body of a parallel loop: returns an upper bound of
/// the loop's iterations. Otherwise, or if unknown, 0.
uint64_t getIterations(const Function &function) {
  uint64_t most = 0;
  for (const Use &use : function.uses()) {
    const auto *call = dyn_cast<CallBase>(use.getUser());
    const Function *callee = call ? call->getCalledFunction() : nullptr;
    if (!callee || callee->getName() != "tai_rt_parallel_for" ||
        call->arg_size() < 4)
      return 0;
    const auto *count = dyn_cast<ConstantInt>(call->getArgOperand(3));
    if (!count || count->isNegative())
      return 0;
    most = std::max(most, count->getZExtValue());
  }
  return most;
}

/// True if `loop` runs up to the end of the range of iterations that the
/// function (the body of a parallel loop) gets. Other loops of the function,
/// such as a loop from which an iteration was peeled off, do not depend on this
/// end.
bool goesOverPart(const Loop &loop, ScalarEvolution &evolution) {
  const Function &function = *loop.getHeader()->getParent();
  if (function.arg_size() != 5)
    return false;
  const SCEV *rounds = evolution.getBackedgeTakenCount(&loop);
  return !isa<SCEVCouldNotCompute>(rounds) &&
         SCEVExprContains(rounds, [&](const SCEV *part) {
           auto *unknown = dyn_cast<SCEVUnknown>(part);
           return unknown && unknown->getValue() == function.getArg(3);
         });
}

/// Returns an upper bound of the instructions that all iterations of `loop`
/// execute; UINT64_MAX if there is none. `iterations` is the number of
/// iterations of the parallel loop, 0 if unknown.
uint64_t countInstructions(const Loop &loop, ScalarEvolution &evolution,
                           uint64_t iterations) {
  uint64_t perRound = 0;
  for (const BasicBlock *block : loop.blocks()) {
    for (const Instruction &instruction : *block)
      if (const auto *call = dyn_cast<CallBase>(&instruction);
          call && !call->getIntrinsicID())
        return UINT64_MAX;
    perRound += block->size();
  }
  uint64_t total = perRound;
  for (const Loop *inner : loop.getSubLoops()) {
    uint64_t rounds = countInstructions(*inner, evolution, 0);
    if (rounds == UINT64_MAX)
      return UINT64_MAX;
    total += rounds;
  }
  uint64_t rounds = evolution.getSmallConstantMaxTripCount(&loop);
  if (rounds == 0 && iterations != 0 && goesOverPart(loop, evolution))
    rounds = iterations;
  if (rounds == 0 || total > kShortLoop || rounds > kShortLoop)
    return UINT64_MAX;
  return total * rounds;
}

class PollInserter {
public:
  explicit PollInserter(Function &function)
      : function(function), builder(function.getContext()) {}

  void insertBefore(Instruction *branch) {
    Module &module = *function.getParent();
    Type *i64 = builder.getInt64Ty();
    Value *frame = function.getArg(0);
    Constant *tick = module.getOrInsertGlobal("tai_rt_tick", i64);
    FunctionCallee look = module.getOrInsertFunction(
        "tai_rt_safepoint", builder.getInt32Ty(), builder.getPtrTy());

    builder.SetInsertPoint(branch);
    auto load = [&](Value *address, const char *name) {
      LoadInst *loaded =
          builder.CreateAlignedLoad(i64, address, Align(8), name);
      loaded->setAtomic(AtomicOrdering::Monotonic);
      return loaded;
    };
    Value *seen =
        builder.CreatePtrAdd(frame, builder.getInt64(offsetof(TaiFrame, tick)));
    Value *isNew = builder.CreateICmpNE(load(tick, "tick"), load(seen, "seen"));
    MDNode *never =
        MDBuilder(function.getContext()).createUnlikelyBranchWeights();
    Instruction *poll = SplitBlockAndInsertIfThen(isNew, branch->getIterator(),
                                                  /*Unreachable=*/false, never);
    builder.SetInsertPoint(poll);
    CallInst *answer = builder.CreateCall(look, frame);
    answer->setDoesNotThrow();
    answer->addFnAttr(Attribute::Cold);
    Value *ends = builder.CreateICmpNE(answer, builder.getInt32(0));
    Instruction *leave = SplitBlockAndInsertIfThen(ends, poll->getIterator(),
                                                   /*Unreachable=*/true, never);
    builder.SetInsertPoint(leave);
    if (function.getReturnType()->isVoidTy())
      builder.CreateRetVoid();
    else
      builder.CreateRet(builder.getInt32(1));
    leave->eraseFromParent();
  }

private:
  Function &function;
  IRBuilder<> builder;
};
} // namespace

PreservedAnalyses InsertSafepoints::run(Function &function,
                                        FunctionAnalysisManager &analyses) {
  if (!mayReturnEarly(function))
    return PreservedAnalyses::all();
  auto &loops = analyses.getResult<LoopAnalysis>(function);
  auto &evolution = analyses.getResult<ScalarEvolutionAnalysis>(function);
  uint64_t iterations = getIterations(function);
  SmallVector<Instruction *> backEdges;
  for (Loop *loop : loops.getLoopsInPreorder()) {
    if (countInstructions(*loop, evolution, iterations) <= kShortLoop)
      continue;
    SmallVector<BasicBlock *> latches;
    loop->getLoopLatches(latches);
    for (BasicBlock *latch : latches)
      backEdges.push_back(latch->getTerminator());
  }
  if (backEdges.empty())
    return PreservedAnalyses::all();
  PollInserter inserter(function);
  for (Instruction *branch : backEdges)
    inserter.insertBefore(branch);
  // The memory attribute of an outlined part is removed: it was inferred before
  // the part had polls, which access memory.
  if (function.hasFnAttribute(kLoopPart))
    function.removeFnAttr(llvm::Attribute::Memory);
  return PreservedAnalyses::none();
}
