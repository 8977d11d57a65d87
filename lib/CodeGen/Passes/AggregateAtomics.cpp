//===- AggregateAtomics.cpp - One atomic addition for a warp --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// In an adjoint, all iterations may add to the adjoint of a value that all of
// them read, such as an input of a dense layer. The memory system serialises
// such additions.
//
// A full warp reduces several sums at once: for each pair of sums, half of the
// threads continue with one sum and half with the other, so that 32 sums take
// 31 shuffles instead of 160, and each sum ends in one thread. If the threads
// of a warp have consecutive iterations, values that depend only on the leading
// digits of the iteration number are uniform. Addresses that change in loops
// are compared at run time, because threads may be in different iterations of a
// loop.
//
// Data-dependent addresses, as in `grid[at[i]] += x[i]`, are compared too: a
// comparison costs little next to 32 additions that wait for each other if all
// threads add to one element. A thread that adds to many elements belongs to a
// stencil, whose neighbouring threads are rarely in the same cell: there,
// copies of the code would cost more than they save.
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/AggregateAtomics.h"
#include "Addresses.h"
#include "tai/ABI/DeviceAccesses.h"
#include "llvm/Analysis/AliasAnalysis.h"
#include "llvm/Analysis/MemoryLocation.h"
#include "llvm/Analysis/UniformityAnalysis.h"
#include "llvm/Analysis/ValueTracking.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/Instructions.h"
#include "llvm/IR/IntrinsicInst.h"
#include "llvm/IR/IntrinsicsNVPTX.h"
#include "llvm/Transforms/Utils/BasicBlockUtils.h"
#include <vector>

using namespace llvm;
using namespace mlir::tai;

static constexpr unsigned warpSize = 32;
/// The maximum depth to which address computations are analysed: addresses are
/// sums of few terms.
static constexpr unsigned maxDepth = 12;
/// Limits of groups with data-dependent addresses: the number of additions in a
/// group (the components of a vector), of compared addresses in a group, and of
/// groups in a function.
static constexpr unsigned maxChosen = 4, maxChosenBases = 2,
                          maxChosenGroups = 4;

/// Name of metadata on additions that were not combined and that later runs of
/// the pass must not combine either: a program contains the code of many
/// functions.
static constexpr char kApartName[] = "tai.apart";

namespace {
/// A group of atomic additions that are all moved to the place of the last of
/// them.
using Group = SmallVector<AtomicRMWInst *, 8>;

class GroupFinder {
public:
  GroupFinder(const UniformityInfo &uniformity, AAResults &aliases)
      : uniformity(uniformity), aliases(aliases) {}
  /// Fills `known` and `chosen`.
  void find(BasicBlock &block);

  /// Groups of additions whose addresses are provably equal in a warp
  /// (`known`), and groups with data-dependent addresses (`chosen`).
  std::vector<Group> known, chosen;

private:
  bool mayPass(Instruction &instruction, const Group &open);
  bool isSameInWarp(const Value *value, unsigned depth);
  bool isChosen(const Value *value, unsigned depth, bool &isLoaded);
  void closeKnown();
  void closeChosen();

  const UniformityInfo &uniformity;
  BatchAAResults aliases;
  Group openKnown, openChosen;
};

/// Emits the combined additions of a warp for one group.
class GroupEmitter {
public:
  explicit GroupEmitter(Group &group)
      : group(group), builder(group.back()->getContext()) {}
  void emit();

private:
  void emitFull(BasicBlock *tail);
  void emitFirstThreads(BasicBlock *tail);
  void emitAdditions(ArrayRef<Value *> values);
  Value *emitComparison();
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
         op->getOrdering() == AtomicOrdering::Monotonic &&
         !op->hasMetadata(kApartName);
}

/// True for numbers that are provably multiples of the size of a warp, assuming
/// that a block consists of whole warps.
static bool isWholeWarps(const Value *value, unsigned depth) {
  if (auto *constant = dyn_cast<ConstantInt>(value))
    return constant->getValue().countr_zero() >= Log2_32(warpSize);
  if (depth == 0)
    return false;
  auto *op = dyn_cast<Instruction>(value);
  if (!op)
    return false;
  auto isWhole = [&](unsigned operand) {
    return isWholeWarps(op->getOperand(operand), depth - 1);
  };
  switch (op->getOpcode()) {
  case Instruction::Add:
  case Instruction::Sub:
    return isWhole(0) && isWhole(1);
  case Instruction::Mul:
    return isWhole(0) || isWhole(1);
  case Instruction::Shl:
    if (auto *by = dyn_cast<ConstantInt>(op->getOperand(1)))
      return by->getValue().uge(Log2_32(warpSize)) || isWhole(0);
    return isWhole(0);
  case Instruction::ZExt:
  case Instruction::SExt:
  case Instruction::Trunc:
    return isWhole(0);
  case Instruction::Call:
    return cast<CallInst>(op)->getIntrinsicID() ==
           Intrinsic::nvvm_read_ptx_sreg_ntid_x;
  default:
    return false;
  }
}

/// True for the number of a thread, or of a thread's iteration: the threads of
/// a warp then have consecutive numbers, starting at a multiple of the warp's
/// size.
static bool isThreadNumber(const Value *value, unsigned depth) {
  auto *op = dyn_cast<Instruction>(value);
  if (!op || depth == 0)
    return false;
  if (auto *phi = dyn_cast<PHINode>(op))
    // A loop over iterations advances by the number of all threads of the grid.
    return all_of(phi->incoming_values(), [&](const Value *from) {
      auto *step = dyn_cast<BinaryOperator>(from);
      if (step && step->getOpcode() == Instruction::Add)
        for (unsigned k : {0, 1})
          if (step->getOperand(k) == phi)
            return isWholeWarps(step->getOperand(1 - k), depth - 1);
      return isThreadNumber(from, depth - 1);
    });
  switch (op->getOpcode()) {
  case Instruction::Add:
    for (unsigned k : {0, 1})
      if (isThreadNumber(op->getOperand(k), depth - 1) &&
          isWholeWarps(op->getOperand(1 - k), depth - 1))
        return true;
    return false;
  case Instruction::Or:
    return cast<PossiblyDisjointInst>(op)->isDisjoint() &&
           ((isThreadNumber(op->getOperand(0), depth - 1) &&
             isWholeWarps(op->getOperand(1), depth - 1)) ||
            (isThreadNumber(op->getOperand(1), depth - 1) &&
             isWholeWarps(op->getOperand(0), depth - 1)));
  case Instruction::ZExt:
  case Instruction::SExt:
  case Instruction::Trunc:
    return isThreadNumber(op->getOperand(0), depth - 1);
  case Instruction::Call:
    return cast<CallInst>(op)->getIntrinsicID() ==
           Intrinsic::nvvm_read_ptx_sreg_tid_x;
  default:
    return false;
  }
}

/// True if all threads of a warp have the same number in `value`.
bool GroupFinder::isSameInWarp(const Value *value, unsigned depth) {
  if (uniformity.isUniform(value))
    return true;
  auto *op = dyn_cast<Instruction>(value);
  if (!op || depth == 0 || op->mayReadOrWriteMemory() || isa<PHINode>(op))
    return false;
  // The quotient of an iteration's number by a multiple of the warp's size is
  // equal for all threads of a warp.
  bool isDivision = op->getOpcode() == Instruction::UDiv ||
                    op->getOpcode() == Instruction::SDiv;
  bool isShift = op->getOpcode() == Instruction::LShr ||
                 op->getOpcode() == Instruction::AShr;
  if (isDivision || isShift) {
    auto *by = dyn_cast<ConstantInt>(op->getOperand(1));
    bool isWhole = by && (isShift ? by->getValue().uge(Log2_32(warpSize))
                                  : !by->isZero() && isWholeWarps(by, 0));
    if (isWhole && isThreadNumber(op->getOperand(0), maxDepth))
      return true;
  }
  if (!isa<BinaryOperator, CastInst, GetElementPtrInst>(op))
    return false;
  return all_of(op->operands(), [&](const Use &operand) {
    return isSameInWarp(operand, depth - 1);
  });
}

/// True for values computed from loaded and from uniform values: the data
/// decides whether threads have the same value. Values that depend on the
/// thread's number are excluded: most threads then add to different elements.
bool GroupFinder::isChosen(const Value *value, unsigned depth, bool &isLoaded) {
  if (uniformity.isUniform(value))
    return true;
  auto *op = dyn_cast<Instruction>(value);
  if (!op || depth == 0)
    return false;
  if (isa<LoadInst>(op)) {
    isLoaded = true;
    return !op->isVolatile() && !op->isAtomic();
  }
  if (auto *call = dyn_cast<CallInst>(op)) {
    if (!isa<IntrinsicInst>(call) || call->isConvergent() ||
        call->mayReadOrWriteMemory() || call->arg_empty())
      return false;
    return all_of(call->args(), [&](const Use &operand) {
      return isChosen(operand, depth - 1, isLoaded);
    });
  }
  if (!isa<BinaryOperator, UnaryOperator, CastInst, GetElementPtrInst,
           SelectInst, CmpInst>(op))
    return false;
  return all_of(op->operands(), [&](const Use &operand) {
    return isChosen(operand, depth - 1, isLoaded);
  });
}

bool GroupFinder::mayPass(Instruction &instruction, const Group &open) {
  // Atomic additions to one element may be reordered, so they do not end the
  // group.
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

/// True if the addition is to a field. Additions of the device library, which
/// one thread does, lack this metadata.
static bool isOfField(const AtomicRMWInst &op) {
  return op.hasMetadata(LLVMContext::MD_noalias);
}

void GroupFinder::closeKnown() {
  if (openKnown.size() > 1 ||
      (openKnown.size() == 1 && isOfField(*openKnown.front())))
    known.push_back(openKnown);
  openKnown.clear();
}

void GroupFinder::closeChosen() {
  SmallPtrSet<Value *, 8> bases;
  for (AtomicRMWInst *op : openChosen)
    bases.insert(
        mlir::tai::splitAddress(op->getPointerOperand(), op->getDataLayout())
            .first);
  if (!openChosen.empty() && openChosen.size() <= maxChosen &&
      bases.size() <= maxChosenBases)
    chosen.push_back(openChosen);
  openChosen.clear();
}

void GroupFinder::find(BasicBlock &block) {
  for (Instruction &instruction : block) {
    if (openKnown.size() == warpSize ||
        (!openKnown.empty() && !mayPass(instruction, openKnown)))
      closeKnown();
    if (!openChosen.empty() && !mayPass(instruction, openChosen))
      closeChosen();
    if (!isAddition(instruction))
      continue;
    auto *op = cast<AtomicRMWInst>(&instruction);
    bool isLoaded = false;
    if (isSameInWarp(op->getPointerOperand(), maxDepth))
      openKnown.push_back(op);
    else if (isOfField(*op) &&
             isChosen(op->getPointerOperand(), maxDepth, isLoaded) && isLoaded)
      openChosen.push_back(op);
  }
  closeKnown();
  closeChosen();
}

void GroupEmitter::emitAdditions(ArrayRef<Value *> values) {
  for (auto [op, value] : zip_first(group, values)) {
    auto *copy = cast<AtomicRMWInst>(op->clone());
    copy->setOperand(1, value);
    builder.Insert(copy);
  }
}

/// True for values that do not change while the function runs: constants and
/// arguments.
static bool isInvariant(const Value *value, unsigned depth) {
  if (isa<Argument, Constant>(value))
    return true;
  auto *op = dyn_cast<Instruction>(value);
  if (!op || depth == 0)
    return false;
  if (!isa<BinaryOperator, CastInst, GetElementPtrInst>(op))
    return false;
  return all_of(op->operands(), [&](const Use &operand) {
    return isInvariant(operand, depth - 1);
  });
}

/// Emits the test whether the active threads of a warp add to the same
/// elements; null where they always do. An address may be equal for all threads
/// in each iteration of a loop, but the active threads need not be in the same
/// iteration.
Value *GroupEmitter::emitComparison() {
  SmallPtrSet<Value *, 8> bases;
  Value *isSame = nullptr;
  const DataLayout &layout = group.back()->getDataLayout();
  for (AtomicRMWInst *op : group) {
    Value *base =
        mlir::tai::splitAddress(op->getPointerOperand(), layout).first;
    if (isInvariant(base, maxDepth) || !bases.insert(base).second)
      continue;
    Value *match = builder.CreateIntrinsic(
        Intrinsic::nvvm_match_all_sync_i64p, {},
        {mask, builder.CreatePtrToInt(base, builder.getInt64Ty())});
    Value *matches = builder.CreateExtractValue(match, 1);
    isSame = isSame ? builder.CreateAnd(isSame, matches) : matches;
  }
  return isSame;
}

/// Emits the reduction of a warp's values for the case that all threads of the
/// warp are active.
void GroupEmitter::emitFull(BasicBlock *tail) {
  // Base and offset of an address are selected separately: most addresses are
  // one of few bases plus a constant, which needs no register.
  SmallVector<Value *> values, bases, offsets;
  const DataLayout &layout = group.back()->getDataLayout();
  for (AtomicRMWInst *op : group) {
    Value *pointer = op->getPointerOperand();
    auto [base, offset] = mlir::tai::splitAddress(pointer, layout);
    bool isAlike = base->getType() == pointer->getType();
    bases.push_back(isAlike ? base : pointer);
    offsets.push_back(builder.getInt64(isAlike ? offset : 0));
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
      bool hasOther = i + 1 < values.size();
      Value *mine = values[i], *theirs = values[i];
      if (hasOther) {
        mine = builder.CreateSelect(isUpper, values[i + 1], values[i]);
        theirs = builder.CreateSelect(isUpper, values[i], values[i + 1]);
      }
      size_t other = hasOther ? i + 1 : i;
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
  // Threads whose number exceeds the number of sums hold a copy of another
  // thread's sum, and do not add it.
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

/// Emits the reduction of a warp's values for the case that exactly the first
/// threads of the warp are active.
void GroupEmitter::emitFirstThreads(BasicBlock *tail) {
  SmallVector<Value *> sums;
  for (AtomicRMWInst *op : group)
    sums.push_back(op->getValOperand());
  // Inactive threads contribute -0, because adding -0 changes no value.
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
  if (Value *isSame = emitComparison()) {
    BasicBlock *same = addBlock();
    builder.CreateCondBr(isSame, same, single);
    builder.SetInsertPoint(same);
  }
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
  if (function.hasFnAttribute(runtime::kFewIterationsAttrName)) {
    MDNode *apart = MDNode::get(function.getContext(), {});
    for (Instruction &instruction : instructions(function))
      if (isAddition(instruction))
        instruction.setMetadata(kApartName, apart);
    return PreservedAnalyses::all();
  }
  GroupFinder finder(analyses.getResult<UniformityInfoAnalysis>(function),
                     analyses.getResult<AAManager>(function));
  for (BasicBlock &block : function)
    finder.find(block);
  if (!combinesScatters || finder.chosen.size() > maxChosenGroups)
    finder.chosen.clear();
  // The groups are handled from the last to the first: splitting a block then
  // leaves the part before the split intact for the remaining groups.
  for (Group &group : reverse(finder.known))
    GroupEmitter(group).emit();
  for (Group &group : reverse(finder.chosen))
    GroupEmitter(group).emit();
  if (finder.known.empty() && finder.chosen.empty())
    return PreservedAnalyses::all();
  function.setConvergent();
  return PreservedAnalyses::none();
}
