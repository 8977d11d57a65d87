//===- WidenSums.cpp - Sums of f32 in f64 ---------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The error of a sequential sum of n numbers is about n roundings. A loop that
// LLVM has vectorised keeps several vectors of partial sums. This pass adds up
// the terms of one iteration pairwise, in f32, and adds their sum to one vector
// of f64: for four terms, four additions become three additions in f32, two
// conversions and two additions in f64, whose cost is hidden by loads unless
// the numbers are in the L1 cache. A loop that is not vectorised adds in f64
// only, with the same latency.
//
// The lowering of loops marks the functions with such sums. The flags of an
// addition alone do not distinguish these sums from sums that the program
// writes.
//
// If the lowering emitted f64 sums, LLVM would choose its vector width by f64
// for the whole loop.
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/WidenSums.h"
#include "tai/ABI/SumModes.h"
#include "llvm/Analysis/LoopInfo.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/IntrinsicInst.h"
#include "llvm/Transforms/Utils/Local.h"

using namespace llvm;
using namespace mlir::tai;

/// The number of terms that are added up in f32 before their sum is converted
/// to f64.
static constexpr size_t kTermsInF32 = 4;
/// The maximum number of simultaneous sums for which there are registers in
/// f64. The adjoint of a layer of a network, for example, has a sum for each of
/// its inputs.
static constexpr size_t kMostSums = 8;

namespace {
/// A term of a sum: a number that is added, or subtracted if `isNegative`.
struct Term {
  Value *value;
  bool isNegative;
};

/// The additions by which a loop computes a sum that it carries: from the phi
/// of the sum to its value for the next iteration.
struct Chain {
  PHINode *phi = nullptr;
  BinaryOperator *last = nullptr;
  SmallVector<Term> terms;
};

class SumWidener {
public:
  explicit SumWidener(LoopInfo &loops) : loops(loops) {}
  bool run(Function &function);

private:
  bool widenLanes(IntrinsicInst &reduction);
  Loop *findLanes(IntrinsicInst &reduction, SmallVectorImpl<Chain> &chains);
  bool widenScalar(Loop &loop, PHINode &phi);
  bool findLeaves(Value *value, const Loop *outside, Loop *&loop,
                  SmallVectorImpl<Value *> &leaves);
  Value *widenTree(Value *root, Instruction *user, size_t most);
  bool isRounded(Value *value, SmallPtrSetImpl<PHINode *> &phis);
  bool skipRounding(Function &function);

  LoopInfo &loops;
  /// The f32 values that this pass has computed by rounding f64 sums.
  SmallPtrSet<Value *, 8> rounded;
  /// Instructions without users, which are deleted at the end: if they were
  /// deleted earlier, a new instruction could get the address of a deleted one.
  SmallVector<WeakTrackingVH> dead;
  SmallVector<WeakVH> deadPhis;
};
} // namespace

/// Returns `value` as an f32 addition or subtraction if its operands may be
/// reassociated; else null.
static BinaryOperator *getFreeSum(Value *value) {
  auto *sum = dyn_cast<BinaryOperator>(value);
  if (!sum || !sum->getType()->getScalarType()->isFloatTy() ||
      (sum->getOpcode() != Instruction::FAdd &&
       sum->getOpcode() != Instruction::FSub) ||
      !sum->hasAllowReassoc())
    return nullptr;
  return sum;
}

/// Finds the chain of additions that leads from `phi`, a value that the loop
/// carries, to its value for the next iteration.
static std::optional<Chain> findChain(Loop &loop, PHINode &phi,
                                      const LoopInfo &loops) {
  BasicBlock *latch = loop.getLoopLatch();
  Chain chain;
  chain.phi = &phi;
  chain.last = getFreeSum(phi.getIncomingValueForBlock(latch));
  if (!chain.last)
    return std::nullopt;
  Value *sum = &phi;
  while (sum != chain.last) {
    if (!sum->hasOneUse())
      return std::nullopt;
    BinaryOperator *next = getFreeSum(*sum->user_begin());
    if (!next || loops.getLoopFor(next->getParent()) != &loop)
      return std::nullopt;
    bool isSecond = next->getOperand(1) == sum;
    bool isNegative = next->getOpcode() == Instruction::FSub;
    if (isNegative && isSecond)
      return std::nullopt;
    chain.terms.push_back({next->getOperand(isSecond ? 0 : 1), isNegative});
    sum = next;
  }
  return chain;
}

/// Finds the vectors of partial sums that a tree of additions after a loop adds
/// up.
bool SumWidener::findLeaves(Value *value, const Loop *outside, Loop *&loop,
                            SmallVectorImpl<Value *> &leaves) {
  auto *instruction = dyn_cast<Instruction>(value);
  if (!instruction)
    return false;
  Loop *own = loops.getLoopFor(instruction->getParent());
  if (own != outside) {
    if (!own || own->getParentLoop() != outside || (loop && own != loop))
      return false;
    loop = own;
    leaves.push_back(value);
    return true;
  }
  if (!value->hasOneUse())
    return false;
  if (auto *phi = dyn_cast<PHINode>(instruction))
    return phi->getNumIncomingValues() == 1 &&
           findLeaves(phi->getIncomingValue(0), outside, loop, leaves);
  BinaryOperator *sum = getFreeSum(value);
  return sum && sum->getOpcode() == Instruction::FAdd &&
         findLeaves(sum->getOperand(0), outside, loop, leaves) &&
         findLeaves(sum->getOperand(1), outside, loop, leaves);
}

static Type *getWide(Type *type) {
  return type->getWithNewType(Type::getDoubleTy(type->getContext()));
}

/// Emits the sum of the terms of one iteration, and converts it to f64.
static Value *emitSum(IRBuilder<> &builder, ArrayRef<Term> terms, size_t most) {
  Value *total = nullptr;
  for (; !terms.empty();
       terms = terms.drop_front(std::min(most, terms.size()))) {
    SmallVector<Value *> level;
    for (Term term : terms.take_front(most))
      level.push_back(term.isNegative ? builder.CreateFNeg(term.value)
                                      : term.value);
    while (level.size() > 1) {
      SmallVector<Value *> next;
      for (size_t i = 0; i + 1 < level.size(); i += 2)
        next.push_back(builder.CreateFAdd(level[i], level[i + 1]));
      if (level.size() % 2)
        next.push_back(level.back());
      level = std::move(next);
    }
    Value *inF64 =
        builder.CreateFPExt(level.front(), getWide(level.front()->getType()));
    total = total ? builder.CreateFAdd(total, inF64) : inF64;
  }
  return total;
}

/// Adds to the loop a carried sum of type f64, which sums the terms of all
/// `chains`. Returns its value after an iteration.
static Value *emitWideChain(Loop &loop, ArrayRef<Chain> chains, size_t most) {
  BasicBlock *latch = loop.getLoopLatch(), *before = loop.getLoopPreheader();
  Type *inF64 = getWide(chains.front().phi->getType());
  FastMathFlags flags = chains.front().last->getFastMathFlags();

  IRBuilder<> builder(before->getTerminator());
  builder.setFastMathFlags(flags);
  Value *start = nullptr;
  SmallVector<Term> terms;
  for (const Chain &chain : chains) {
    Value *initial = chain.phi->getIncomingValueForBlock(before);
    llvm::append_range(terms, chain.terms);
    Value *own = builder.CreateFPExt(initial, inF64);
    start = start ? builder.CreateFAdd(start, own) : own;
  }
  builder.SetInsertPoint(loop.getHeader(), loop.getHeader()->begin());
  PHINode *carried = builder.CreatePHI(inF64, 2);
  builder.SetInsertPoint(latch->getTerminator());
  Value *next = builder.CreateFAdd(carried, emitSum(builder, terms, most));
  carried->addIncoming(start, before);
  carried->addIncoming(next, latch);
  return next;
}

/// Adds up again, in f64, the terms of a tree of additions whose only user is
/// `user`: the remainder of a loop that LLVM has unrolled. Each part of the
/// tree is added where the last of its terms was. Returns null if there is no
/// such tree.
Value *SumWidener::widenTree(Value *root, Instruction *user, size_t most) {
  SmallVector<BinaryOperator *> sums;
  SmallVector<Value *> open = {root};
  while (!open.empty()) {
    Value *value = open.pop_back_val();
    BinaryOperator *sum = getFreeSum(value);
    if (!sum || !sum->hasOneUse() || sum->hasApproxFunc() ||
        sum->getParent() != user->getParent())
      continue;
    sums.push_back(sum);
    append_range(open, sum->operands());
  }
  if (sums.size() < 2)
    return nullptr;
  llvm::sort(sums, [](BinaryOperator *a, BinaryOperator *b) {
    return a->comesBefore(b);
  });
  // For each term of the tree of additions, from its root downwards, this
  // determines whether the term is added or subtracted.
  SmallDenseMap<Value *, bool> isNegative;
  for (BinaryOperator *sum : llvm::reverse(sums)) {
    bool sign = isNegative.lookup(sum);
    isNegative[sum->getOperand(0)] = sign;
    isNegative[sum->getOperand(1)] =
        sign != (sum->getOpcode() == Instruction::FSub);
    // A number that occurs twice in an addition would need two signs.
    if (sum->getOperand(0) == sum->getOperand(1))
      return nullptr;
  }
  SmallPtrSet<Value *, 8> inner(sums.begin(), sums.end());
  SmallPtrSet<Value *, 8> seen;
  for (BinaryOperator *sum : sums)
    for (Value *operand : sum->operands())
      if (!inner.contains(operand) && !seen.insert(operand).second)
        return nullptr;
  Value *total = nullptr;
  SmallVector<Term> terms;
  IRBuilder<> builder(user);
  builder.setFastMathFlags(sums.back()->getFastMathFlags());
  auto add = [&](Value *inF64) {
    total = total ? builder.CreateFAdd(total, inF64) : inF64;
  };
  for (BinaryOperator *sum : sums) {
    builder.SetInsertPoint(sum);
    for (Value *operand : sum->operands()) {
      if (inner.contains(operand))
        continue;
      if (!rounded.contains(operand)) {
        terms.push_back({operand, isNegative.lookup(operand)});
        continue;
      }
      Value *inF64 = cast<FPTruncInst>(operand)->getOperand(0);
      add(isNegative.lookup(operand) ? builder.CreateFNeg(inF64) : inF64);
    }
    if (terms.size() >= most || sum == sums.back()) {
      if (!terms.empty())
        add(emitSum(builder, terms, most));
      terms.clear();
    }
  }
  return total;
}

/// True for a loop with a preheader, whose only latch is its only exiting
/// block.
static bool isSimple(Loop &loop) {
  return loop.getLoopLatch() && loop.getLoopPreheader() &&
         loop.getExitingBlock() == loop.getLoopLatch();
}

/// Finds the loop whose vectors of partial sums the tree that ends in
/// `reduction` adds up; null if there is none. `chains` gets the additions of
/// each partial sum in the loop.
Loop *SumWidener::findLanes(IntrinsicInst &reduction,
                            SmallVectorImpl<Chain> &chains) {
  const Loop *outside = loops.getLoopFor(reduction.getParent());
  Loop *loop = nullptr;
  SmallVector<Value *> leaves;
  if (!findLeaves(reduction.getArgOperand(1), outside, loop, leaves) || !loop ||
      !isSimple(*loop))
    return nullptr;
  for (PHINode &phi : loop->getHeader()->phis()) {
    Value *last = phi.getIncomingValueForBlock(loop->getLoopLatch());
    if (!is_contained(leaves, last))
      continue;
    std::optional<Chain> chain = findChain(*loop, phi, loops);
    // The partial sum may be used only by the next iteration and by the tree
    // after the loop.
    if (!chain || !chain->last->hasNUses(2))
      return nullptr;
    chains.push_back(std::move(*chain));
  }
  return chains.size() == leaves.size() ? loop : nullptr;
}

/// Widens the partial sums of a loop that `reduction` adds up after it.
bool SumWidener::widenLanes(IntrinsicInst &reduction) {
  if (!reduction.getType()->isFloatTy() || !reduction.hasAllowReassoc())
    return false;
  SmallVector<Chain> chains;
  Value *lanes = nullptr;
  if (Loop *loop = findLanes(reduction, chains))
    lanes = emitWideChain(*loop, chains, kTermsInF32);
  else
    lanes = widenTree(reduction.getArgOperand(1), &reduction, kTermsInF32);
  if (!lanes)
    return false;
  IRBuilder<> builder(&reduction);
  builder.setFastMathFlags(reduction.getFastMathFlags());
  Value *start =
      builder.CreateFPExt(reduction.getArgOperand(0), builder.getDoubleTy());
  Value *total = builder.CreateFAddReduce(start, lanes);
  Value *narrow = builder.CreateFPTrunc(total, reduction.getType());
  rounded.insert(narrow);
  reduction.replaceAllUsesWith(narrow);
  dead.push_back(&reduction);
  for (const Chain &chain : chains)
    deadPhis.push_back(chain.phi);
  return true;
}

/// Widens a sum of a loop that is not vectorised.
bool SumWidener::widenScalar(Loop &loop, PHINode &phi) {
  if (!phi.getType()->isFloatTy() || !isSimple(loop))
    return false;
  BasicBlock *exit = loop.getExitBlock();
  if (!exit || !exit->getSinglePredecessor())
    return false;
  std::optional<Chain> chain = findChain(loop, phi, loops);
  // With fast-math, sums that the program itself writes may be reassociated,
  // too, but are not widened.
  if (!chain || chain->last->hasApproxFunc())
    return false;
  SmallVector<Use *> outside;
  for (Use &use : chain->last->uses()) {
    auto *user = cast<Instruction>(use.getUser());
    if (!loop.contains(user))
      outside.push_back(&use);
    else if (user != &phi)
      return false;
  }
  if (outside.empty())
    return false;
  Value *inF64 = emitWideChain(loop, *chain, 1);
  IRBuilder<> builder(exit, exit->getFirstInsertionPt());
  Value *narrow = builder.CreateFPTrunc(inF64, phi.getType());
  rounded.insert(narrow);
  for (Use *use : outside) {
    auto *user = cast<Instruction>(use->getUser());
    if (auto *closed = dyn_cast<PHINode>(user);
        closed && closed->getParent() == exit) {
      closed->replaceAllUsesWith(narrow);
      closed->eraseFromParent();
    } else {
      use->set(narrow);
    }
  }
  deadPhis.push_back(&phi);
  return true;
}

/// True if a value is, on every path, a constant or a sum rounded by this pass.
/// Collects the phis in between.
bool SumWidener::isRounded(Value *value, SmallPtrSetImpl<PHINode *> &phis) {
  if (isa<ConstantFP>(value) || rounded.contains(value))
    return true;
  auto *phi = dyn_cast<PHINode>(value);
  if (!phi)
    return false;
  return !phis.insert(phi).second ||
         llvm::all_of(phi->incoming_values(),
                      [&](Use &use) { return isRounded(use.get(), phis); });
}

/// Widens phis that merge sums rounded to f32, so that a value extended to f64
/// after a phi was never rounded; likewise the phis of remainder loops over
/// single numbers.
bool SumWidener::skipRounding(Function &function) {
  bool changed = false;
  SmallVector<FPExtInst *> extensions;
  for (BasicBlock &block : function)
    for (Instruction &instruction : block)
      if (auto *extension = dyn_cast<FPExtInst>(&instruction);
          extension && extension->getSrcTy()->isFloatTy() &&
          extension->getDestTy()->isDoubleTy())
        extensions.push_back(extension);
  DenseMap<PHINode *, PHINode *> inF64;
  for (FPExtInst *extension : extensions) {
    SmallPtrSet<PHINode *, 8> phis;
    if (Value *sum = widenTree(extension->getOperand(0), extension, 1)) {
      extension->replaceAllUsesWith(sum);
      dead.push_back(extension);
      changed = true;
      continue;
    }
    if (!isRounded(extension->getOperand(0), phis))
      continue;
    for (PHINode *phi : phis)
      if (!inF64.contains(phi))
        inF64[phi] =
            PHINode::Create(extension->getDestTy(), phi->getNumIncomingValues(),
                            "", phi->getIterator());
    auto widen = [&](Value *value) -> Value * {
      if (auto *phi = dyn_cast<PHINode>(value))
        return inF64.lookup(phi);
      if (rounded.contains(value))
        return cast<FPTruncInst>(value)->getOperand(0);
      return ConstantFP::get(
          extension->getDestTy(),
          cast<ConstantFP>(value)->getValueAPF().convertToFloat());
    };
    for (PHINode *phi : phis)
      if (PHINode *made = inF64[phi]; made->getNumIncomingValues() == 0)
        for (unsigned i = 0, e = phi->getNumIncomingValues(); i < e; ++i)
          made->addIncoming(widen(phi->getIncomingValue(i)),
                            phi->getIncomingBlock(i));
    extension->replaceAllUsesWith(widen(extension->getOperand(0)));
    dead.push_back(extension);
    changed = true;
  }
  for (auto [narrow, made] : inF64)
    deadPhis.push_back(narrow);
  return changed;
}

bool SumWidener::run(Function &function) {
  SmallVector<IntrinsicInst *> reductions;
  for (BasicBlock &block : function)
    for (Instruction &instruction : block)
      if (auto *call = dyn_cast<IntrinsicInst>(&instruction);
          call && call->getIntrinsicID() == Intrinsic::vector_reduce_fadd)
        reductions.push_back(call);
  if (reductions.size() > kMostSums)
    return false;
  bool changed = false;
  for (IntrinsicInst *reduction : reductions)
    changed |= widenLanes(*reduction);
  for (Loop *loop : loops.getLoopsInPreorder()) {
    SmallVector<PHINode *> phis;
    for (PHINode &phi : loop->getHeader()->phis())
      if (phi.getType()->isFloatTy())
        phis.push_back(&phi);
    if (phis.size() > kMostSums)
      continue;
    for (PHINode *phi : phis)
      changed |= widenScalar(*loop, *phi);
  }
  changed |= skipRounding(function);
  append_range(dead, rounded);
  RecursivelyDeleteTriviallyDeadInstructionsPermissive(dead);
  for (WeakVH &phi : deadPhis)
    if (phi)
      RecursivelyDeleteDeadPHINode(cast<PHINode>(phi));
  return changed;
}

PreservedAnalyses WidenSums::run(Function &function,
                                 FunctionAnalysisManager &analyses) {
  if (!function.hasFnAttribute(runtime::kFreeSumsAttrName))
    return PreservedAnalyses::all();
  LoopInfo &loops = analyses.getResult<LoopAnalysis>(function);
  if (!SumWidener(loops).run(function))
    return PreservedAnalyses::all();
  PreservedAnalyses preserved;
  preserved.preserveSet<CFGAnalyses>();
  return preserved;
}
