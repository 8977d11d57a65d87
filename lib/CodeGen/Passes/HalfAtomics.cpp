//===- HalfAtomics.cpp - Atomic operations on 16-bit floats ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/HalfAtomics.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/Module.h"
#include "llvm/Transforms/Utils/BasicBlockUtils.h"
#include "llvm/Transforms/Utils/LowerAtomic.h"

using namespace llvm;

static void expand(AtomicRMWInst *atomic) {
  BasicBlock *before = atomic->getParent();
  BasicBlock *after = SplitBlock(before, atomic);
  BasicBlock *loop = BasicBlock::Create(atomic->getContext(), "exchange",
                                        before->getParent(), after);
  Type *type = atomic->getType();
  Value *address = atomic->getPointerOperand();

  before->getTerminator()->eraseFromParent();
  IRBuilder<> builder(before);
  builder.SetCurrentDebugLocation(atomic->getDebugLoc());
  Type *bits = builder.getInt16Ty();
  Value *first = builder.CreateAlignedLoad(bits, address, atomic->getAlign());
  builder.CreateBr(loop);

  builder.SetInsertPoint(loop);
  PHINode *expected = builder.CreatePHI(bits, 2);
  expected->addIncoming(first, before);
  Value *old = builder.CreateBitCast(expected, type);
  Value *next = buildAtomicRMWValue(atomic->getOperation(), builder, old,
                                    atomic->getValOperand());
  AtomicCmpXchgInst *exchange = builder.CreateAtomicCmpXchg(
      address, expected, builder.CreateBitCast(next, bits), atomic->getAlign(),
      atomic->getOrdering(),
      AtomicCmpXchgInst::getStrongestFailureOrdering(atomic->getOrdering()),
      atomic->getSyncScopeID());
  expected->addIncoming(builder.CreateExtractValue(exchange, 0), loop);
  builder.CreateCondBr(builder.CreateExtractValue(exchange, 1), after, loop);

  atomic->replaceAllUsesWith(old);
  atomic->eraseFromParent();
}

void mlir::tai::expandHalfAtomics(Module &module) {
  for (Function &function : module) {
    SmallVector<AtomicRMWInst *> atomics;
    for (Instruction &instruction : instructions(function))
      if (auto *atomic = dyn_cast<AtomicRMWInst>(&instruction);
          atomic && atomic->isFloatingPointOperation() &&
          atomic->getType()->is16bitFPTy())
        atomics.push_back(atomic);
    for (AtomicRMWInst *atomic : atomics)
      expand(atomic);
  }
}
