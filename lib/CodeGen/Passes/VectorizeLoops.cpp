//===- VectorizeLoops.cpp - The loop vectoriser, and a guard --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// InstCombine runs directly after the vectoriser, before any point where a pass
// could be added, so this pass runs the vectoriser itself, and guards it.
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/VectorizeLoops.h"
#include "llvm/Analysis/LoopInfo.h"
#include "llvm/Analysis/LoopIterator.h"
#include "llvm/Analysis/ScalarEvolution.h"
#include "llvm/IR/Dominators.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/Instructions.h"
#include "llvm/IR/IntrinsicInst.h"
#include "llvm/Transforms/Utils/LoopUtils.h"

using namespace llvm;

/// True if memory may be written between a load and an instruction that uses
/// its value.
static bool isBehindWrite(const Instruction &load, const Instruction &user) {
  if (load.getParent() != user.getParent())
    return true;
  for (const Instruction *at = load.getNextNode(); at && at != &user;
       at = at->getNextNode())
    if (at->mayWriteToMemory())
      return true;
  return false;
}

static bool isMaskedLoad(const IntrinsicInst &intrinsic) {
  return intrinsic.getIntrinsicID() == Intrinsic::masked_load ||
         intrinsic.getIntrinsicID() == Intrinsic::masked_gather;
}

/// Inserts a freeze of the result of each masked load that a select uses after
/// a write to memory, so that the select is not folded into the load.
static void pinMaskedLoads(Function &function) {
  SmallVector<IntrinsicInst *> pinned;
  for (Instruction &instruction : instructions(function)) {
    auto *load = dyn_cast<IntrinsicInst>(&instruction);
    if (load && isMaskedLoad(*load) && any_of(load->users(), [&](User *user) {
          return isa<SelectInst>(user) &&
                 isBehindWrite(*load, *cast<Instruction>(user));
        }))
      pinned.push_back(load);
  }
  for (IntrinsicInst *load : pinned) {
    auto *frozen = new FreezeInst(load, "", load->getNextNode()->getIterator());
    load->replaceUsesWithIf(
        frozen, [](Use &use) { return isa<SelectInst>(use.getUser()); });
  }
}

/// True if an iteration may write an element and then access it once more,
/// where one of the two accesses is under a condition. The vectoriser joins
/// loads, or stores, of neighbouring elements, which moves stores past later
/// accesses and loads past earlier ones. Where fields are known to be distinct,
/// the vectoriser does not look for accesses to the same element in between.
static bool mayReorder(const Loop &loop, const LoopInfo &loops,
                       const DominatorTree &dominators, ScalarEvolution &scev) {
  const BasicBlock *latch = loop.getLoopLatch();
  if (!latch)
    return false;
  struct Writes {
    bool always = false, sometimes = false;
  };
  DenseMap<const SCEV *, Writes> writes;
  LoopBlocksRPO blocks(const_cast<Loop *>(&loop));
  blocks.perform(&loops);
  for (BasicBlock *block : blocks) {
    bool isAlways = dominators.dominates(block, latch);
    for (Instruction &access : *block) {
      Value *pointer = getLoadStorePointerOperand(&access);
      if (!pointer)
        continue;
      bool isStore = isa<StoreInst>(access);
      Writes &before = writes[scev.getSCEV(pointer)];
      if (isAlways ? before.sometimes && !isStore : before.always)
        return true;
      if (isStore)
        (isAlways ? before.always : before.sometimes) = true;
    }
  }
  return false;
}

/// Disables vectorisation of loops where the vectoriser would change the order
/// of accesses to an element.
static void keepReorderedLoopsScalar(Function &function,
                                     FunctionAnalysisManager &analyses) {
  auto &loops = analyses.getResult<LoopAnalysis>(function);
  if (loops.empty())
    return;
  auto &dominators = analyses.getResult<DominatorTreeAnalysis>(function);
  auto &scev = analyses.getResult<ScalarEvolutionAnalysis>(function);
  for (Loop *loop : loops.getLoopsInPreorder())
    if (loop->isInnermost() && mayReorder(*loop, loops, dominators, scev))
      addStringMetadataToLoop(loop, "llvm.loop.vectorize.enable", 0);
}

PreservedAnalyses
mlir::tai::VectorizeLoops::run(Function &function,
                               FunctionAnalysisManager &analyses) {
  keepReorderedLoopsScalar(function, analyses);
  PreservedAnalyses preserved =
      LoopVectorizePass(options).run(function, analyses);
  pinMaskedLoads(function);
  return preserved;
}
