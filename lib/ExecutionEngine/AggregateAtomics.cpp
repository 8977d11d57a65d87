//===- AggregateAtomics.cpp - One atomic addition for a warp --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The adjoint of a value that all iterations read is added to by all of them;
// in the adjoint of a dense layer these are all its inputs. The memory takes
// such additions one after another.
//
// A full warp adds up several sums at once: of each pair, half of the threads
// go on with one and half with the other, so that 32 sums take 31 exchanges
// rather than 160, and end in a thread each.
//
//===----------------------------------------------------------------------===//

#include "AggregateAtomics.h"
#include "llvm/Analysis/AliasAnalysis.h"
#include "llvm/Analysis/MemoryLocation.h"
#include "llvm/Analysis/UniformityAnalysis.h"
#include "llvm/Analysis/ValueTracking.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/Instructions.h"
#include "llvm/IR/IntrinsicsNVPTX.h"
#include "llvm/Transforms/Utils/BasicBlockUtils.h"
#include <vector>

using namespace llvm;

static constexpr unsigned warpSize = 32;

namespace {
/// Additions that move to the last of them.
using Group = SmallVector<AtomicRMWInst *, 8>;

class GroupFinder {
public:
  GroupFinder(const UniformityInfo &uniformity, AAResults &aliases)
      : uniformity(uniformity), aliases(aliases) {}
  std::vector<Group> find(BasicBlock &block);

private:
  bool mayPass(Instruction &instruction);
  void close();

  const UniformityInfo &uniformity;
  BatchAAResults aliases;
  std::vector<Group> groups;
  Group open;
};

/// Writes the code for one group.
class GroupEmitter {
public:
  explicit GroupEmitter(Group &group)
      : group(group), builder(group.back()->getContext()) {}
  void emit();

private:
  void emitFull(BasicBlock *tail);
  void emitFirstThreads(BasicBlock *tail);
  void emitAdditions(ArrayRef<Value *> values);
  BasicBlock *addBlock() {
    return BasicBlock::Create(builder.getContext(), "",
                              group.back()->getFunction(), tailBlock);
  }
  Value *exchange(Intrinsic::ID how, Value *value, unsigned distance) {
    return builder.CreateIntrinsic(how, {},
                                   {mask, value, builder.getInt32(distance),
                                    builder.getInt32(warpSize - 1)});
  }

  Group &group;
  IRBuilder<> builder;
  BasicBlock *tailBlock = nullptr;
  Value *mask = nullptr, *lane = nullptr;
};
} // namespace

static bool isAddition(const Instruction &instruction) {
  auto *op = dyn_cast<AtomicRMWInst>(&instruction);
  return op && op->getOperation() == AtomicRMWInst::FAdd &&
         op->getType()->isFloatTy() && op->use_empty() && !op->isVolatile() &&
         op->getOrdering() == AtomicOrdering::Monotonic;
}

bool GroupFinder::mayPass(Instruction &instruction) {
  // Additions to the same place come in any order.
  if (isAddition(instruction))
    return true;
  if (!isGuaranteedToTransferExecutionToSuccessor(&instruction))
    return false;
  if (!instruction.mayReadOrWriteMemory())
    return true;
  if (isa<FenceInst>(instruction))
    return false;
  if (auto *call = dyn_cast<CallBase>(&instruction))
    if (call->isConvergent() || call->isInlineAsm())
      return false;
  return all_of(open, [&](AtomicRMWInst *op) {
    return isNoModRef(
        aliases.getModRefInfo(&instruction, MemoryLocation::get(op)));
  });
}

void GroupFinder::close() {
  if (open.size() > 1)
    groups.push_back(open);
  open.clear();
}

std::vector<Group> GroupFinder::find(BasicBlock &block) {
  for (Instruction &instruction : block) {
    if (open.size() == warpSize || (!open.empty() && !mayPass(instruction)))
      close();
    if (isAddition(instruction) &&
        uniformity.isUniform(
            cast<AtomicRMWInst>(instruction).getPointerOperand()))
      open.push_back(cast<AtomicRMWInst>(&instruction));
  }
  close();
  return std::exchange(groups, {});
}

void GroupEmitter::emitAdditions(ArrayRef<Value *> values) {
  for (auto [op, value] : zip_first(group, values)) {
    auto *copy = cast<AtomicRMWInst>(op->clone());
    copy->setOperand(1, value);
    builder.Insert(copy);
  }
}

/// All threads of the warp are here.
void GroupEmitter::emitFull(BasicBlock *tail) {
  // Addresses are mostly constants behind few others: these need no registers.
  SmallVector<Value *> values, bases, offsets;
  const DataLayout &layout = group.back()->getDataLayout();
  for (AtomicRMWInst *op : group) {
    Value *pointer = op->getPointerOperand();
    APInt offset(layout.getIndexTypeSizeInBits(pointer->getType()), 0);
    Value *base = pointer->stripAndAccumulateConstantOffsets(
        layout, offset, /*AllowNonInbounds=*/true);
    bool isAlike = base->getType() == pointer->getType();
    bases.push_back(isAlike ? base : pointer);
    offsets.push_back(
        builder.getInt(isAlike ? offset.sextOrTrunc(64) : APInt(64, 0)));
    values.push_back(op->getValOperand());
  }
  auto select = [&](Value *condition, Value *yes, Value *no) {
    return yes == no ? yes : builder.CreateSelect(condition, yes, no);
  };
  Value *number = builder.getInt32(0);
  for (unsigned distance = warpSize / 2, bit = 1; distance > 0;
       distance /= 2, bit *= 2) {
    Value *isUpper = builder.CreateICmpNE(builder.CreateAnd(lane, distance),
                                          builder.getInt32(0));
    number = builder.CreateOr(
        number, builder.CreateSelect(isUpper, builder.getInt32(bit),
                                     builder.getInt32(0)));
    SmallVector<Value *> nextValues, nextBases, nextOffsets;
    for (size_t i = 0; i < values.size(); i += 2) {
      bool isPair = i + 1 < values.size();
      Value *mine = values[i], *theirs = values[i];
      if (isPair) {
        mine = builder.CreateSelect(isUpper, values[i + 1], values[i]);
        theirs = builder.CreateSelect(isUpper, values[i], values[i + 1]);
      }
      size_t other = isPair ? i + 1 : i;
      nextBases.push_back(select(isUpper, bases[other], bases[i]));
      nextOffsets.push_back(select(isUpper, offsets[other], offsets[i]));
      nextValues.push_back(
          builder.CreateFAdd(mine, exchange(Intrinsic::nvvm_shfl_sync_bfly_f32,
                                            theirs, distance)));
    }
    values = std::move(nextValues);
    bases = std::move(nextBases);
    offsets = std::move(nextOffsets);
  }
  // Threads beyond the last sum hold one that another has.
  BasicBlock *add = addBlock();
  builder.CreateCondBr(
      builder.CreateICmpULT(number, builder.getInt32(group.size())), add, tail);
  builder.SetInsertPoint(add);
  Value *target =
      builder.CreateGEP(builder.getInt8Ty(), bases.front(), offsets.front());
  builder.CreateAtomicRMW(AtomicRMWInst::FAdd, target, values.front(),
                          group.back()->getAlign(), AtomicOrdering::Monotonic,
                          group.back()->getSyncScopeID());
  builder.CreateBr(tail);
}

/// The first threads of the warp are here, and no others.
void GroupEmitter::emitFirstThreads(BasicBlock *tail) {
  SmallVector<Value *> sums;
  for (AtomicRMWInst *op : group)
    sums.push_back(op->getValOperand());
  // Leaves every value as it is.
  Value *zero = ConstantFP::getNegativeZero(builder.getFloatTy());
  for (unsigned distance = warpSize / 2; distance > 0; distance /= 2) {
    Value *other = builder.CreateAdd(lane, builder.getInt32(distance));
    Value *isHere = builder.CreateAnd(
        builder.CreateICmpULT(other, builder.getInt32(warpSize)),
        builder.CreateICmpNE(
            builder.CreateAnd(builder.CreateLShr(
                                  mask, builder.CreateAnd(other, warpSize - 1)),
                              1),
            builder.getInt32(0)));
    for (Value *&sum : sums) {
      Value *theirs =
          exchange(Intrinsic::nvvm_shfl_sync_down_f32, sum, distance);
      sum = builder.CreateFAdd(sum, builder.CreateSelect(isHere, theirs, zero));
    }
  }
  BasicBlock *add = addBlock();
  builder.CreateCondBr(builder.CreateICmpEQ(lane, builder.getInt32(0)), add,
                       tail);
  builder.SetInsertPoint(add);
  emitAdditions(sums);
  builder.CreateBr(tail);
}

void GroupEmitter::emit() {
  AtomicRMWInst *last = group.back();
  BasicBlock *head = last->getParent();
  tailBlock = SplitBlock(head, last);
  head->getTerminator()->eraseFromParent();
  builder.SetInsertPoint(head);
  builder.SetCurrentDebugLocation(last->getDebugLoc());
  mask = builder.CreateIntrinsic(Intrinsic::nvvm_activemask, ArrayRef<Type *>(),
                                 ArrayRef<Value *>());
  lane = builder.CreateIntrinsic(Intrinsic::nvvm_read_ptx_sreg_laneid,
                                 ArrayRef<Type *>(), ArrayRef<Value *>());
  BasicBlock *full = addBlock(), *partial = addBlock(), *first = addBlock(),
             *single = addBlock();
  builder.CreateCondBr(builder.CreateICmpEQ(mask, builder.getInt32(~0u)), full,
                       partial);
  builder.SetInsertPoint(full);
  emitFull(tailBlock);
  builder.SetInsertPoint(partial);
  Value *above =
      builder.CreateAnd(mask, builder.CreateAdd(mask, builder.getInt32(1)));
  builder.CreateCondBr(builder.CreateICmpEQ(above, builder.getInt32(0)), first,
                       single);
  builder.SetInsertPoint(first);
  emitFirstThreads(tailBlock);
  builder.SetInsertPoint(single);
  SmallVector<Value *> values;
  for (AtomicRMWInst *op : group)
    values.push_back(op->getValOperand());
  emitAdditions(values);
  builder.CreateBr(tailBlock);
  for (AtomicRMWInst *op : group)
    op->eraseFromParent();
}

PreservedAnalyses
mlir::tai::AggregateAtomics::run(Function &function,
                                 FunctionAnalysisManager &analyses) {
  if (none_of(instructions(function), isAddition))
    return PreservedAnalyses::all();
  GroupFinder finder(analyses.getResult<UniformityInfoAnalysis>(function),
                     analyses.getResult<AAManager>(function));
  std::vector<Group> groups;
  for (BasicBlock &block : function)
    for (Group &group : finder.find(block))
      groups.push_back(std::move(group));
  // From the end, so that blocks stay whole in front of what is split.
  for (Group &group : reverse(groups))
    GroupEmitter(group).emit();
  if (groups.empty())
    return PreservedAnalyses::all();
  function.setConvergent();
  return PreservedAnalyses::none();
}
