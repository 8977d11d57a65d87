//===- UnrollGridLoops.cpp - Unroll grid-stride loops ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The bandwidth of a GPU is proportional to the number of bytes in flight. If
// each thread loads one number at a time, less than half of the bandwidth is
// used.
//
// LLVM's own unrolling computes the trip count by a division by the stride; for
// a loop that runs once in each thread, as in many small kernels, that costs
// more than the loop itself. Here
//
//   for (i = first; i < n; i += stride)  body(i)
//
// becomes
//
//   i = first
//   if (i + 3 * stride < n)
//     do { body(i), …, body(i + 3 * stride); i += 4 * stride }
//     while (i + 3 * stride < n)
//   for (; i < n; i += stride)  body(i)
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/UnrollGridLoops.h"
#include "llvm/ADT/SmallPtrSet.h"
#include "llvm/Analysis/LoopInfo.h"
#include "llvm/IR/Dominators.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/Instructions.h"
#include "llvm/IR/IntrinsicInst.h"
#include "llvm/IR/IntrinsicsNVPTX.h"
#include "llvm/Transforms/Utils/LoopUtils.h"
#include "llvm/Transforms/Utils/ValueMapper.h"

using namespace llvm;
using namespace mlir::tai;

namespace {
/// A grid-stride loop that consists of one block and ends in `br (next < n),
/// block, exit`.
struct GridLoop {
  BasicBlock *preheader, *block, *exit;
  PHINode *index;
  BinaryOperator *next;
  ICmpInst *condition;
  BranchInst *branch;
  Value *stride;
  unsigned factor;
};
} // namespace

/// True for a value computed from the number of blocks of the grid.
static bool isGridStride(const Value *value, unsigned depth = 0) {
  if (auto *call = dyn_cast<IntrinsicInst>(value))
    return call->getIntrinsicID() == Intrinsic::nvvm_read_ptx_sreg_nctaid_x;
  auto *instruction = dyn_cast<Instruction>(value);
  constexpr unsigned deepest = 4;
  if (!instruction || depth == deepest ||
      !(isa<CastInst>(instruction) || isa<BinaryOperator>(instruction)))
    return false;
  return any_of(instruction->operands(), [&](const Use &operand) {
    return isGridStride(operand.get(), depth + 1);
  });
}

/// Chooses the unroll factor: as many loads as possible, with so few registers
/// that all threads of a multiprocessor can still be resident.
static unsigned chooseFactor(const BasicBlock &block) {
  unsigned size = 0, loads = 0;
  for (const Instruction &instruction : block) {
    if (isa<PHINode>(instruction) || instruction.isDebugOrPseudoInst())
      continue;
    // No instruction is moved past atomic operations, which wait for each other
    // anyway, or past calls, which may do anything.
    if (instruction.isAtomic() || isa<FenceInst>(instruction))
      return 1;
    if (auto *call = dyn_cast<CallBase>(&instruction))
      if (!isa<IntrinsicInst>(call) || call->isConvergent() ||
          call->mayHaveSideEffects())
        return 1;
    if (instruction.isVolatile())
      return 1;
    loads += isa<LoadInst>(instruction);
    ++size;
  }
  if (loads == 0)
    return 1;
  constexpr unsigned small = 48, large = 96;
  if (size <= small && loads <= 8)
    return 4;
  return size <= large && loads <= 16 ? 2 : 1;
}

/// True if all values of the loop that are used after it go through phis of the
/// exit block (LCSSA form).
static bool isClosed(const BasicBlock &block, const BasicBlock &exit) {
  return all_of(block, [&](const Instruction &instruction) {
    return all_of(instruction.users(), [&](const User *user) {
      auto *at = cast<Instruction>(user);
      return at->getParent() == &block ||
             (isa<PHINode>(at) && at->getParent() == &exit);
    });
  });
}

static std::optional<GridLoop> match(Loop &loop) {
  GridLoop found;
  found.block = loop.getHeader();
  if (loop.getNumBlocks() != 1)
    return std::nullopt;
  found.branch = dyn_cast<BranchInst>(found.block->getTerminator());
  if (!found.branch || !found.branch->isConditional() ||
      found.branch->getSuccessor(0) != found.block)
    return std::nullopt;
  found.exit = found.branch->getSuccessor(1);
  if (!isClosed(*found.block, *found.exit))
    return std::nullopt;
  found.condition = dyn_cast<ICmpInst>(found.branch->getCondition());
  if (!found.condition || !found.condition->hasOneUse() ||
      (found.condition->getPredicate() != ICmpInst::ICMP_SLT &&
       found.condition->getPredicate() != ICmpInst::ICMP_ULT) ||
      !loop.isLoopInvariant(found.condition->getOperand(1)))
    return std::nullopt;
  found.next = dyn_cast<BinaryOperator>(found.condition->getOperand(0));
  if (!found.next || found.next->getOpcode() != Instruction::Add)
    return std::nullopt;
  for (unsigned side : {0u, 1u}) {
    found.index = dyn_cast<PHINode>(found.next->getOperand(side));
    found.stride = found.next->getOperand(1 - side);
    if (found.index && found.index->getParent() == found.block &&
        found.index->getIncomingValueForBlock(found.block) == found.next &&
        loop.isLoopInvariant(found.stride) && isGridStride(found.stride)) {
      found.factor = chooseFactor(*found.block);
      return found;
    }
  }
  return std::nullopt;
}

/// Finds the instructions that must stay in the order of the iterations:
/// writes, reads after a write in their own iteration, and their users.
static SmallPtrSet<const Instruction *, 16> findLate(const BasicBlock &block) {
  SmallPtrSet<const Instruction *, 16> late;
  bool written = false;
  for (const Instruction &instruction : block) {
    if (isa<PHINode>(instruction))
      continue;
    bool isLate = instruction.mayWriteToMemory() ||
                  (written && instruction.mayReadFromMemory() &&
                   !instruction.hasMetadata(LLVMContext::MD_invariant_load)) ||
                  any_of(instruction.operands(), [&](const Use &operand) {
                    auto *used = dyn_cast<Instruction>(operand.get());
                    return used && late.contains(used);
                  });
    if (isLate)
      late.insert(&instruction);
    written |= instruction.mayWriteToMemory();
  }
  // A value that the next iteration starts from must not be one of the late
  // instructions.
  for (const PHINode &phi : block.phis())
    if (auto *carried =
            dyn_cast<Instruction>(phi.getIncomingValueForBlock(&block)))
      if (late.contains(carried))
        return {};
  return late;
}

/// Emits `loop.factor` iterations; the phis of the first have the values
/// `begin`. For each iteration, `maps` gets the values of the loop's
/// instructions.
static void emitIterations(const GridLoop &loop, IRBuilder<> &builder,
                           std::vector<ValueToValueMapTy> &maps,
                           ArrayRef<PHINode *> begin) {
  SmallPtrSet<const Instruction *, 16> late = findLate(*loop.block);
  auto emit = [&](unsigned iteration, bool wantsLate) {
    for (Instruction &instruction : *loop.block) {
      if (isa<PHINode>(instruction) || instruction.isTerminator() ||
          &instruction == loop.condition ||
          late.contains(&instruction) != wantsLate)
        continue;
      Instruction *clone = instruction.clone();
      builder.Insert(clone, instruction.getName());
      RemapInstruction(clone, maps[iteration],
                       RF_NoModuleLevelChanges | RF_IgnoreMissingLocals);
      maps[iteration][&instruction] = clone;
    }
  };
  for (unsigned iteration = 0; iteration < loop.factor; ++iteration) {
    for (auto [phi, value] : llvm::zip(loop.block->phis(), begin)) {
      if (iteration == 0) {
        maps[0][&phi] = value;
        continue;
      }
      Value *carried = phi.getIncomingValueForBlock(loop.block);
      Value *mapped = maps[iteration - 1].lookup(carried);
      maps[iteration][&phi] = mapped ? mapped : carried;
    }
    emit(iteration, /*wantsLate=*/false);
  }
  for (unsigned iteration = 0; iteration < loop.factor; ++iteration)
    emit(iteration, /*wantsLate=*/true);
}

static void unroll(const GridLoop &loop) {
  LLVMContext &context = loop.block->getContext();
  Function *function = loop.block->getParent();
  Value *limit = loop.condition->getOperand(1);
  CmpInst::Predicate predicate = loop.condition->getPredicate();
  auto *many = BasicBlock::Create(context, "many", function, loop.block);
  auto *rest = BasicBlock::Create(context, "rest", function, loop.block);

  // Emits the test whether the last iteration of a group of `factor` iterations
  // is still within the loop's bound.
  IRBuilder<> builder(loop.preheader->getTerminator());
  Value *reach = builder.CreateMul(
      loop.stride, ConstantInt::get(loop.stride->getType(), loop.factor - 1));
  // There is at least one iteration, so neither index nor limit is negative.
  // Their sum may overflow to a negative number where the limit is close to the
  // largest index, so the comparison is unsigned.
  auto comparesLast = [&](Value *index) {
    return builder.CreateICmpULT(builder.CreateAdd(index, reach), limit);
  };
  Value *first = loop.index->getIncomingValueForBlock(loop.preheader);
  builder.CreateCondBr(comparesLast(first), many, loop.block);
  loop.preheader->getTerminator()->eraseFromParent();

  builder.SetInsertPoint(many);
  SmallVector<PHINode *> begin;
  for (PHINode &phi : loop.block->phis()) {
    begin.push_back(builder.CreatePHI(phi.getType(), 2));
    begin.back()->addIncoming(phi.getIncomingValueForBlock(loop.preheader),
                              loop.preheader);
  }
  std::vector<ValueToValueMapTy> maps(loop.factor);
  emitIterations(loop, builder, maps, begin);
  auto lastValue = [&](Value *value) -> Value * {
    Value *mapped = maps.back().lookup(value);
    return mapped ? mapped : value;
  };
  for (auto [phi, value] : llvm::zip(loop.block->phis(), begin)) {
    Value *carried = lastValue(phi.getIncomingValueForBlock(loop.block));
    value->addIncoming(carried, many);
    phi.addIncoming(carried, rest);
  }
  Value *next = lastValue(loop.next);
  builder.CreateCondBr(comparesLast(next), many, rest);

  builder.SetInsertPoint(rest);
  builder.CreateCondBr(builder.CreateICmp(predicate, next, limit), loop.block,
                       loop.exit);
  for (PHINode &phi : loop.exit->phis())
    phi.addIncoming(lastValue(phi.getIncomingValueForBlock(loop.block)), rest);

  // The unrolled loop and the loop of the remaining iterations are marked, so
  // that LLVM does not unroll them further.
  MDNode *disable =
      MDNode::get(context, MDString::get(context, "llvm.loop.unroll.disable"));
  for (BasicBlock *block : {many, loop.block}) {
    auto *id = MDNode::getDistinct(context, {nullptr, disable});
    id->replaceOperandWith(0, id);
    block->getTerminator()->setMetadata(LLVMContext::MD_loop, id);
  }
}

PreservedAnalyses UnrollGridLoops::run(Function &function,
                                       FunctionAnalysisManager &analyses) {
  if (function.getCallingConv() != CallingConv::PTX_Kernel)
    return PreservedAnalyses::all();
  LoopInfo &loopInfo = analyses.getResult<LoopAnalysis>(function);
  SmallVector<std::pair<Loop *, GridLoop>> loops;
  for (Loop *loop : loopInfo)
    if (std::optional<GridLoop> found = match(*loop))
      if (found->factor > 1)
        loops.push_back({loop, *found});
  for (auto &[loop, found] : loops) {
    found.preheader = InsertPreheaderForLoop(
        loop, &analyses.getResult<DominatorTreeAnalysis>(function), &loopInfo,
        /*MSSAU=*/nullptr, /*PreserveLCSSA=*/false);
    if (found.preheader)
      unroll(found);
  }
  return loops.empty() ? PreservedAnalyses::all() : PreservedAnalyses::none();
}
