//===- VectorizeAtomics.cpp - Several atomic additions at once ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A scatter of vectors adds to each component separately, with one memory
// operation for each. From Hopper on, one operation can add to two or four
// adjacent elements, each addition still being atomic.
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/VectorizeAtomics.h"
#include "Addresses.h"
#include "llvm/ADT/MapVector.h"
#include "llvm/Analysis/AliasAnalysis.h"
#include "llvm/Analysis/AssumptionCache.h"
#include "llvm/Analysis/MemoryLocation.h"
#include "llvm/Analysis/ValueTracking.h"
#include "llvm/IR/DataLayout.h"
#include "llvm/IR/Dominators.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/InlineAsm.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/Instructions.h"
#include "llvm/IR/Operator.h"
#include "llvm/Pass.h"

using namespace llvm;

namespace {
/// An atomic addition whose result is unused.
struct Addition {
  AtomicRMWInst *op;
  /// The distance in bytes of the addition's address from its base address.
  int64_t offset;
};

class VectorizeAtomics : public FunctionPass {
public:
  static char ID;
  VectorizeAtomics() : FunctionPass(ID) {}

  StringRef getPassName() const override { return "Vectorize atomics"; }

  void getAnalysisUsage(AnalysisUsage &usage) const override {
    usage.addRequired<AAResultsWrapperPass>();
    usage.addRequired<AssumptionCacheTracker>();
    usage.addRequired<DominatorTreeWrapperPass>();
    usage.setPreservesCFG();
  }

  bool runOnFunction(Function &function) override {
    aliases = &getAnalysis<AAResultsWrapperPass>().getAAResults();
    assumptions =
        &getAnalysis<AssumptionCacheTracker>().getAssumptionCache(function);
    dominators = &getAnalysis<DominatorTreeWrapperPass>().getDomTree();
    layout = &function.getDataLayout();
    changed = false;
    for (BasicBlock &block : function)
      runOnBlock(block);
    return changed;
  }

private:
  void runOnBlock(BasicBlock &block);
  void combine();
  void combineAt(MutableArrayRef<Addition> additions);
  void emit(ArrayRef<Addition> additions);
  /// True if the additions in `waiting` may be moved past `instruction`.
  bool mayPass(Instruction &instruction);

  AAResults *aliases = nullptr;
  AssumptionCache *assumptions = nullptr;
  DominatorTree *dominators = nullptr;
  const DataLayout *layout = nullptr;
  bool changed = false;
  /// Additions seen so far that can still be combined, by the base of their
  /// address. Additions that are combined move to the place of the last of
  /// them.
  MapVector<Value *, SmallVector<Addition>> waiting;
  SmallVector<AtomicRMWInst *> order;
};
} // namespace

char VectorizeAtomics::ID = 0;

Pass *mlir::tai::createVectorizeAtomicsPass() { return new VectorizeAtomics(); }

/// Returns the known alignment of an address. LLVM's own analysis does not look
/// through the cast from the generic to the global address space.
static Align getAlignment(Value *pointer, Instruction *at,
                          const DataLayout &layout,
                          AssumptionCache *assumptions = nullptr,
                          DominatorTree *dominators = nullptr) {
  Align alignment = Align(Value::MaximumAlignment);
  for (;;) {
    if (auto *cast = dyn_cast<AddrSpaceCastInst>(pointer)) {
      pointer = cast->getPointerOperand();
      continue;
    }
    auto *element = dyn_cast<GEPOperator>(pointer);
    if (!element)
      break;
    unsigned width = layout.getIndexTypeSizeInBits(pointer->getType());
    SmallMapVector<Value *, APInt, 4> indices;
    APInt offset(width, 0);
    if (!element->collectOffset(layout, width, indices, offset))
      return Align(1);
    auto limit = [&](unsigned zeros) {
      alignment =
          std::min(alignment, Align(uint64_t(1) << std::min(zeros, 8u)));
    };
    if (!offset.isZero())
      limit(offset.countTrailingZeros());
    for (auto &[index, scale] : indices)
      limit(scale.countTrailingZeros() +
            computeKnownBits(index, layout, assumptions, at, dominators)
                .countMinTrailingZeros());
    pointer = element->getPointerOperand();
  }
  return std::min(alignment, pointer->getPointerAlignment(layout));
}

void mlir::tai::noteAtomicAlignment(Function &function) {
  const llvm::DataLayout &layout = function.getDataLayout();
  for (Instruction &instruction : instructions(function))
    if (auto *op = dyn_cast<AtomicRMWInst>(&instruction))
      op->setAlignment(
          std::max(op->getAlign(),
                   std::min(getAlignment(op->getPointerOperand(), op, layout),
                            Align(16))));
}

static bool isCandidate(const AtomicRMWInst &op) {
  constexpr unsigned globalSpace = 1;
  return op.getOperation() == AtomicRMWInst::FAdd &&
         op.getType()->isFloatTy() && op.use_empty() && !op.isVolatile() &&
         op.getOrdering() == AtomicOrdering::Monotonic &&
         op.getPointerAddressSpace() == globalSpace;
}

bool VectorizeAtomics::mayPass(Instruction &instruction) {
  if (!instruction.mayReadOrWriteMemory())
    return !instruction.mayThrow();
  // Other atomic additions can be passed, even if they are to the same element,
  // because additions may be reordered.
  if (auto *atomic = dyn_cast<AtomicRMWInst>(&instruction))
    if (isCandidate(*atomic))
      return true;
  // A load with this metadata reads memory that is never written while the
  // kernel runs.
  if (isa<LoadInst>(instruction) &&
      instruction.hasMetadata(LLVMContext::MD_invariant_load))
    return true;
  if (instruction.isVolatile() || instruction.isAtomic() ||
      isa<FenceInst>(instruction))
    return false;
  if (auto *call = dyn_cast<CallBase>(&instruction))
    if (call->isConvergent() || call->isInlineAsm())
      return false;
  return all_of(order, [&](AtomicRMWInst *op) {
    return isNoModRef(
        aliases->getModRefInfo(&instruction, MemoryLocation::get(op)));
  });
}

void VectorizeAtomics::runOnBlock(BasicBlock &block) {
  for (Instruction &instruction : make_early_inc_range(block)) {
    // Each waiting addition is compared with each later access, so their number
    // is limited.
    constexpr size_t most = 64;
    if (order.size() == most || (!order.empty() && !mayPass(instruction)))
      combine();
    auto *op = dyn_cast<AtomicRMWInst>(&instruction);
    if (!op || !isCandidate(*op))
      continue;
    auto [base, offset] =
        mlir::tai::splitAddress(op->getPointerOperand(), *layout);
    waiting[base].push_back({op, offset});
    order.push_back(op);
  }
  combine();
}

void VectorizeAtomics::combine() {
  for (auto &[base, additions] : waiting)
    if (additions.size() > 1)
      combineAt(additions);
  waiting.clear();
  order.clear();
}

/// Finds, in `additions` to one base address, runs of adjacent elements that
/// can be combined, where the alignment allows a vector operation.
void VectorizeAtomics::combineAt(MutableArrayRef<Addition> additions) {
  constexpr int64_t size = sizeof(float);
  llvm::sort(additions, [](const Addition &a, const Addition &b) {
    return a.offset != b.offset ? a.offset < b.offset
                                : a.op != b.op && a.op->comesBefore(b.op);
  });
  size_t begin = 0;
  while (begin < additions.size()) {
    size_t length = 1;
    while (length < 4 && begin + length < additions.size() &&
           additions[begin + length].offset ==
               additions[begin].offset + static_cast<int64_t>(length) * size)
      ++length;
    AtomicRMWInst *first = additions[begin].op;
    Align alignment = std::max(getAlignment(first->getPointerOperand(), first,
                                            *layout, assumptions, dominators),
                               first->getAlign());
    if (length == 4 && alignment >= Align(16))
      emit(additions.slice(begin, 4));
    else if (length >= 2 && alignment >= Align(8))
      emit(additions.slice(begin, length = 2));
    else
      length = 1;
    begin += length;
  }
}

void VectorizeAtomics::emit(ArrayRef<Addition> additions) {
  // The combined operation is placed at the last addition, where all values
  // have been computed.
  Instruction *last = additions.front().op;
  for (const Addition &addition : additions)
    if (last->comesBefore(addition.op))
      last = addition.op;
  IRBuilder<> builder(last);
  // `additions` are sorted by address: the first is not necessarily the first
  // instruction.
  Value *pointer = additions.front().op->getPointerOperand();
  SmallVector<Value *> arguments = {pointer};
  SmallVector<Type *> types = {pointer->getType()};
  std::string values, constraints = "l";
  for (const Addition &addition : additions) {
    values += (values.empty() ? "$" : ", $") + std::to_string(arguments.size());
    constraints += ",f";
    arguments.push_back(addition.op->getValOperand());
    types.push_back(builder.getFloatTy());
  }
  std::string text = "red.relaxed.gpu.global.add.v" +
                     std::to_string(additions.size()) + ".f32 [$0], {" +
                     values + "};";
  auto *type = FunctionType::get(builder.getVoidTy(), types, false);
  CallInst *call =
      builder.CreateCall(InlineAsm::get(type, text, constraints + ",~{memory}",
                                        /*hasSideEffects=*/true),
                         arguments);
  // The call gets the properties of the additions, so that accesses to other
  // memory can be moved past it.
  call->setMemoryEffects(MemoryEffects::argMemOnly());
  call->setDoesNotThrow();
  call->addFnAttr(Attribute::WillReturn);
  AAMDNodes tags = additions.front().op->getAAMetadata();
  for (const Addition &addition : additions.drop_front())
    tags = tags.merge(addition.op->getAAMetadata());
  call->setAAMetadata(tags);
  for (const Addition &addition : additions)
    addition.op->eraseFromParent();
  changed = true;
}
