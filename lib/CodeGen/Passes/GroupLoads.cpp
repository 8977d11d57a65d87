//===- GroupLoads.cpp - Loads before stores -------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Adjoints add to many elements one after another: load, add, store, and again.
// A load that comes after the previous store waits for memory separately,
// several hundred clocks each time. Loads also wait after an IEEE 754 division
// or square root: ptxas expands these to branches, and moves nothing across
// them.
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/GroupLoads.h"
#include "llvm/ADT/SmallPtrSet.h"
#include "llvm/Analysis/AliasAnalysis.h"
#include "llvm/Analysis/MemoryLocation.h"
#include "llvm/Analysis/ValueTracking.h"
#include "llvm/IR/DataLayout.h"
#include "llvm/IR/Instructions.h"

using namespace llvm;

/// The maximum size of a group's loads, in words of four bytes: each word
/// occupies a register for longer.
static constexpr unsigned mostWords = 48;

/// The maximum number of writes with which a load is compared.
static constexpr size_t mostWrites = 128;

namespace {
class LoadGrouping {
public:
  LoadGrouping(BasicBlock &block, AAResults &aliases)
      : block(block), aliases(aliases), layout(block.getDataLayout()) {}
  bool run();

private:
  bool join(LoadInst &load);
  bool collectAddress(Value *value, SmallVectorImpl<Instruction *> &chain);
  void startGroup(LoadInst *load);

  BasicBlock &block;
  BatchAAResults aliases;
  const DataLayout &layout;
  /// The last load of the current group; further loads that join the group are
  /// moved after it.
  Instruction *last = nullptr;
  unsigned words = 0;
  /// Instructions after `last`, the last load of the group, that are not part
  /// of the group: `writes` are those that write memory, `behind` is the set of
  /// all.
  SmallVector<Instruction *> writes;
  SmallPtrSet<Instruction *, 32> behind;
  /// True if an instruction after the last load of the group is one that ptxas
  /// expands to branches.
  bool branches = false;
  bool changed = false;
};
} // namespace

/// True if ptxas expands `instruction` to branches, past which it moves no
/// loads.
static bool isSplitting(const Instruction &instruction) {
  switch (instruction.getOpcode()) {
  case Instruction::FDiv:
    return !instruction.hasApproxFunc();
  case Instruction::FRem:
    return true;
  case Instruction::Call: {
    auto *callee = cast<CallBase>(instruction).getCalledFunction();
    return callee && callee->isIntrinsic() &&
           (callee->getIntrinsicID() == Intrinsic::sqrt ||
            callee->getName().starts_with("llvm.nvvm.sqrt.r") ||
            callee->getName().starts_with("llvm.nvvm.div.r"));
  }
  default:
    return instruction.isIntDivRem() &&
           instruction.getType()->getScalarSizeInBits() > 32;
  }
}

/// True if an instruction may be moved to an earlier place in its block.
static bool isSafeToMove(const Instruction &instruction) {
  return isa<GetElementPtrInst, CastInst, BinaryOperator, SelectInst, ICmpInst>(
             instruction) &&
         !instruction.isIntDivRem() && !isSplitting(instruction);
}

static unsigned countWords(const LoadInst &load, const DataLayout &layout) {
  return static_cast<unsigned>(
      divideCeil(layout.getTypeStoreSize(load.getType()).getFixedValue(), 4));
}

void LoadGrouping::startGroup(LoadInst *load) {
  last = load;
  words = load ? countWords(*load, layout) : 0;
  writes.clear();
  behind.clear();
  branches = false;
}

/// Collects in `chain`, in their order, the instructions after the group from
/// which `value` is computed. False if one of them cannot be moved before the
/// group's end.
bool LoadGrouping::collectAddress(Value *value,
                                  SmallVectorImpl<Instruction *> &chain) {
  auto *instruction = dyn_cast<Instruction>(value);
  if (!instruction || !behind.contains(instruction) ||
      is_contained(chain, instruction))
    return true;
  constexpr size_t longest = 24;
  if (chain.size() >= longest || instruction->mayReadOrWriteMemory() ||
      !isSafeToMove(*instruction))
    return false;
  for (Value *operand : instruction->operands())
    if (!collectAddress(operand, chain))
      return false;
  chain.push_back(instruction);
  return true;
}

bool LoadGrouping::join(LoadInst &load) {
  unsigned more = countWords(load, layout);
  if (!last || words + more > mostWords)
    return false;
  MemoryLocation location = MemoryLocation::get(&load);
  for (Instruction *write : writes)
    if (isModSet(aliases.getModRefInfo(write, location)))
      return false;
  SmallVector<Instruction *> chain;
  if (!collectAddress(load.getPointerOperand(), chain))
    return false;
  words += more;
  // If only loads are between the load and the group, ptxas itself groups them.
  if (writes.empty() && !branches) {
    last = &load;
    behind.clear();
    return true;
  }
  for (Instruction *instruction : chain) {
    instruction->moveAfter(last);
    behind.erase(instruction);
    last = instruction;
  }
  load.moveAfter(last);
  last = &load;
  changed = true;
  return true;
}

bool LoadGrouping::run() {
  for (Instruction &instruction : make_early_inc_range(block)) {
    if (auto *load = dyn_cast<LoadInst>(&instruction);
        load && load->isUnordered()) {
      if (!join(*load))
        startGroup(load);
      continue;
    }
    // A barrier or a call of an unknown function ends the group, because no
    // load can move past it.
    auto *call = dyn_cast<CallBase>(&instruction);
    bool isOpaque = isa<FenceInst>(instruction) || instruction.mayThrow() ||
                    (call && instruction.mayReadOrWriteMemory() &&
                     (call->isConvergent() || call->isInlineAsm()));
    if (isOpaque) {
      startGroup(nullptr);
      continue;
    }
    if (!last)
      continue;
    behind.insert(&instruction);
    branches |= isSplitting(instruction);
    if (!instruction.mayWriteToMemory())
      continue;
    writes.push_back(&instruction);
    if (writes.size() > mostWrites)
      startGroup(nullptr);
  }
  return changed;
}

PreservedAnalyses
mlir::tai::GroupLoads::run(Function &function,
                           FunctionAnalysisManager &analyses) {
  AAResults &aliases = analyses.getResult<AAManager>(function);
  bool changed = false;
  for (BasicBlock &block : function)
    changed |= LoadGrouping(block, aliases).run();
  if (!changed)
    return PreservedAnalyses::all();
  PreservedAnalyses preserved;
  preserved.preserveSet<CFGAnalyses>();
  return preserved;
}
