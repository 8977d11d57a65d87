//===- VectorizeLoops.cpp - The loop vectoriser, and a guard --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// InstCombine runs right behind the vectoriser, before any place where a pass
// could be added, so the guard is a part of vectorising.
//
//===----------------------------------------------------------------------===//

#include "VectorizeLoops.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/Instructions.h"
#include "llvm/IR/IntrinsicInst.h"

using namespace llvm;

/// True if memory may be written between a load and a later instruction.
static bool isBehindWrite(const Instruction &load, const Instruction &user) {
  if (load.getParent() != user.getParent())
    return true;
  for (const Instruction *at = load.getNextNode(); at && at != &user;
       at = at->getNextNode())
    if (at->mayWriteToMemory())
      return true;
  return false;
}

bool mlir::tai::pinMaskedLoads(Function &function) {
  SmallVector<IntrinsicInst *> pinned;
  for (Instruction &instruction : instructions(function)) {
    auto *load = dyn_cast<IntrinsicInst>(&instruction);
    if (load && load->getIntrinsicID() == Intrinsic::masked_load &&
        any_of(load->users(), [&](User *user) {
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
  return !pinned.empty();
}

PreservedAnalyses
mlir::tai::VectorizeLoops::run(Function &function,
                               FunctionAnalysisManager &analyses) {
  PreservedAnalyses preserved =
      LoopVectorizePass(options).run(function, analyses);
  pinMaskedLoads(function);
  return preserved;
}
