//===- FailedAllocations.cpp - Failed allocations on a device -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A thread whose allocation failed, or that is asked to stop, frees its memory
// and branches to the end of its function. There, it still takes part in the
// barriers at which the threads of a block reduce their sums.
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/FailedAllocations.h"
#include "tai/ABI/LocalMemory.h"
#include "llvm/IR/Dominators.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/MDBuilder.h"
#include "llvm/IR/Module.h"
#include "llvm/Transforms/Utils/BasicBlockUtils.h"

using namespace llvm;

/// Returns the first basic block with a reduction over the threads of a thread
/// block, or null.
static BasicBlock *findMeeting(Function &function, const DominatorTree &tree) {
  BasicBlock *first = nullptr;
  for (Instruction &instruction : instructions(function)) {
    auto *call = dyn_cast<CallInst>(&instruction);
    const Function *callee = call ? call->getCalledFunction() : nullptr;
    if (!callee || !callee->getName().starts_with("tai_dev_reduce_"))
      continue;
    BasicBlock *block = call->getParent();
    if (!first || tree.dominates(block, first))
      first = block;
  }
  return first;
}

static bool isValid(Function &function) {
  DominatorTree tree(function);
  for (Instruction &instruction : instructions(function))
    for (Use &use : instruction.operands())
      if (auto *definition = dyn_cast<Instruction>(use.get()))
        if (!tree.dominates(definition, use))
          return false;
  return true;
}

namespace {
/// The memory that one device function allocates and frees. For each
/// allocation, a local variable holds the address, or null while nothing is
/// allocated.
class OwnMemory {
public:
  explicit OwnMemory(Function &function);
  void freeAll(IRBuilder<> &builder) const;

private:
  SmallVector<AllocaInst *> variables;
  FunctionCallee release;
};
} // namespace

OwnMemory::OwnMemory(Function &function) {
  SmallVector<CallInst *> allocations;
  for (Instruction &instruction : instructions(function))
    if (auto *call = dyn_cast<CallInst>(&instruction))
      if (const Function *callee = call->getCalledFunction();
          callee && callee->getName() == mlir::tai::kLocalAllocate)
        allocations.push_back(call);
  Function *free = function.getParent()->getFunction(mlir::tai::kLocalFree);
  if (!free)
    return;
  release = free;
  for (CallInst *allocation : allocations) {
    SmallVector<CallInst *> frees;
    for (User *user : allocation->users())
      if (auto *call = dyn_cast<CallInst>(user))
        if (call->getCalledFunction() == free)
          frees.push_back(call);
    if (frees.empty())
      continue;
    IRBuilder<> builder(&*function.getEntryBlock().getFirstInsertionPt());
    auto *null = ConstantPointerNull::get(builder.getPtrTy());
    AllocaInst *variable = builder.CreateAlloca(builder.getPtrTy());
    builder.CreateStore(null, variable);
    builder.SetInsertPoint(allocation->getNextNode());
    builder.CreateStore(allocation, variable);
    for (CallInst *call : frees) {
      builder.SetInsertPoint(call);
      builder.CreateStore(null, variable);
    }
    variables.push_back(variable);
  }
}

void OwnMemory::freeAll(IRBuilder<> &builder) const {
  for (AllocaInst *variable : variables)
    builder.CreateCall(release,
                       builder.CreateLoad(builder.getPtrTy(), variable));
}

/// Ends the thread after `call` if `address` is null, because the allocation
/// has failed or the thread is asked to stop; else the thread continues.
static void endWhereNull(CallInst &call, Value &address,
                         const OwnMemory &memory) {
  Function &function = *call.getFunction();
  BasicBlock *meeting = findMeeting(function, DominatorTree(function));
  BasicBlock *block = call.getParent();
  bool isBefore = meeting && meeting != block;
  BasicBlock *rest = block->splitBasicBlock(call.getNextNode());
  auto *lacking = BasicBlock::Create(function.getContext(), "", &function);
  block->getTerminator()->eraseFromParent();
  IRBuilder<> builder(block);
  builder.CreateCondBr(
      builder.CreateIsNull(&address), lacking, rest,
      MDBuilder(function.getContext()).createUnlikelyBranchWeights());
  builder.SetInsertPoint(lacking);
  memory.freeAll(builder);
  if (!isBefore) {
    builder.CreateRetVoid();
    return;
  }
  BranchInst *leave = builder.CreateBr(meeting);
  for (PHINode &phi : meeting->phis())
    phi.addIncoming(Constant::getNullValue(phi.getType()), lacking);
  if (isValid(function))
    return;
  // A thread that lacks memory returns, because it cannot contribute to the
  // reductions, which need values that it has not computed.
  meeting->removePredecessor(lacking, /*KeepOneInputPHIs=*/true);
  leave->eraseFromParent();
  builder.SetInsertPoint(lacking);
  builder.CreateRetVoid();
}

/// Makes the call happen only every n-th time that it is reached in a run of
/// the function; n, its last argument, is a power of two.
static void space(CallInst &call) {
  Function &function = *call.getFunction();
  auto *every = cast<ConstantInt>(call.getArgOperand(call.arg_size() - 1));
  if (every->isOne())
    return;
  IRBuilder<> builder(&*function.getEntryBlock().getFirstInsertionPt());
  AllocaInst *count = builder.CreateAlloca(builder.getInt32Ty());
  builder.CreateStore(builder.getInt32(0), count);
  builder.SetInsertPoint(&call);
  Value *next = builder.CreateAdd(
      builder.CreateLoad(builder.getInt32Ty(), count), builder.getInt32(1));
  builder.CreateStore(next, count);
  Value *isTime = builder.CreateIsNull(
      builder.CreateAnd(next, builder.getInt32(every->getZExtValue() - 1)));
  Instruction *then = SplitBlockAndInsertIfThen(
      isTime, call.getIterator(), /*Unreachable=*/false,
      MDBuilder(function.getContext()).createUnlikelyBranchWeights());
  call.moveBefore(then->getIterator());
}

void mlir::tai::exitOnFailedAllocations(Module &module) {
  DenseMap<Function *, OwnMemory> memories;
  for (StringRef name :
       {StringRef(kLocalAllocate), StringRef(kLocalGiven), StringRef(kGoOn)}) {
    Function *function = module.getFunction(name);
    if (!function)
      continue;
    SmallVector<CallInst *> calls;
    for (User *user : function->users())
      if (auto *call = dyn_cast<CallInst>(user))
        calls.push_back(call);
    for (CallInst *call : calls) {
      bool isGiven = name == kLocalGiven;
      llvm::Value *address = isGiven ? call->getArgOperand(0) : call;
      Function *caller = call->getFunction();
      if (name == kGoOn)
        space(*call);
      if (caller->getReturnType()->isVoidTy()) {
        const OwnMemory &memory =
            memories.try_emplace(caller, *caller).first->second;
        endWhereNull(*call, *address, memory);
      }
      if (isGiven) {
        call->replaceAllUsesWith(address);
        call->eraseFromParent();
      }
    }
    if (name == kLocalGiven)
      function->eraseFromParent();
  }
}
