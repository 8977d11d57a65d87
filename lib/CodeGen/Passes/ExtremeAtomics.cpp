//===- ExtremeAtomics.cpp - Atomic minima and maxima ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/ExtremeAtomics.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/Module.h"
#include "llvm/Transforms/Utils/BasicBlockUtils.h"

using namespace llvm;

/// Emits the comparison of the old value with the operand that is true if the
/// operation does not change the element. For floats it is false if either is a
/// NaN, and for two zeros their signs decide.
static std::optional<CmpInst::Predicate>
getStaysPredicate(const AtomicRMWInst &atomic) {
  switch (atomic.getOperation()) {
  case AtomicRMWInst::Max:
    return CmpInst::ICMP_SGE;
  case AtomicRMWInst::Min:
    return CmpInst::ICMP_SLE;
  case AtomicRMWInst::UMax:
    return CmpInst::ICMP_UGE;
  case AtomicRMWInst::UMin:
    return CmpInst::ICMP_ULE;
  case AtomicRMWInst::FMaximum:
    return CmpInst::FCMP_OGT;
  case AtomicRMWInst::FMinimum:
    return CmpInst::FCMP_OLT;
  default:
    return std::nullopt;
  }
}

static void test(AtomicRMWInst *atomic, CmpInst::Predicate predicate) {
  IRBuilder<> builder(atomic);
  Type *type = atomic->getType();
  LoadInst *old = builder.CreateAlignedLoad(type, atomic->getPointerOperand(),
                                            atomic->getAlign(), "old");
  old->setAtomic(AtomicOrdering::Monotonic, atomic->getSyncScopeID());
  old->copyMetadata(*atomic, {LLVMContext::MD_alias_scope,
                              LLVMContext::MD_noalias, LLVMContext::MD_tbaa});
  Value *given = atomic->getValOperand();
  Value *stays = builder.CreateCmp(predicate, old, given);
  if (type->isFloatingPointTy()) {
    Type *bits = builder.getIntNTy(type->getPrimitiveSizeInBits());
    Value *isSame = builder.CreateICmpEQ(builder.CreateBitCast(old, bits),
                                         builder.CreateBitCast(given, bits));
    stays = builder.CreateOr(stays, isSame);
  }
  Value *changes = builder.CreateNot(stays);

  BasicBlock *before = atomic->getParent();
  Instruction *inside =
      SplitBlockAndInsertIfThen(changes, atomic->getIterator(),
                                /*Unreachable=*/false);
  BasicBlock *after = atomic->getParent();
  atomic->moveBefore(inside->getIterator());
  if (atomic->use_empty())
    return;
  builder.SetInsertPoint(after, after->begin());
  PHINode *result = builder.CreatePHI(type, 2);
  atomic->replaceAllUsesWith(result);
  result->addIncoming(old, before);
  result->addIncoming(atomic, atomic->getParent());
}

void mlir::tai::testExtremeAtomics(Module &module) {
  for (Function &function : module) {
    SmallVector<std::pair<AtomicRMWInst *, CmpInst::Predicate>> found;
    for (Instruction &instruction : instructions(function)) {
      auto *atomic = dyn_cast<AtomicRMWInst>(&instruction);
      if (!atomic || atomic->isVolatile() ||
          atomic->getOrdering() != AtomicOrdering::Monotonic)
        continue;
      if (std::optional<CmpInst::Predicate> stays = getStaysPredicate(*atomic))
        found.emplace_back(atomic, *stays);
    }
    for (auto [atomic, stays] : found)
      test(atomic, stays);
  }
}
