//===- ManyLoops.cpp - Functions with hundreds of loops -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Many LLVM analyses of a loop take time proportional to the number of loops in
// the function: after a change of one loop, scalar evolution invalidates all.
// So consecutive loops, each of which is dominated by the previous one, are
// outlined in groups, divided at blocks between them.
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/ManyLoops.h"
#include "tai/CodeGen/Passes/InsertSafepoints.h"
#include "llvm/ADT/MapVector.h"
#include "llvm/ADT/SetVector.h"
#include "llvm/Analysis/LoopInfo.h"
#include "llvm/IR/Dominators.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/IntrinsicInst.h"
#include "llvm/IR/Module.h"
#include "llvm/Transforms/Utils/BasicBlockUtils.h"

using namespace llvm;
using namespace mlir::tai;

bool mlir::tai::looksThroughCalls(StringRef pass) {
  return pass == "IPSCCPPass" || pass == "DeadArgumentEliminationPass" ||
         pass == "ArgumentPromotionPass";
}

namespace {
/// A group of consecutive loops that becomes a function: the blocks of the
/// loops, with the entry block first.
using Part = SmallSetVector<BasicBlock *, 32>;

class LoopDivider {
public:
  LoopDivider(Function &function, ManyLoopsLimits limits)
      : function(function), limits(limits), mayEnd(mayReturnEarly(function)) {}

  /// Divides one chain of consecutive loops into parts. False if the function
  /// has no chain that is long enough.
  bool divide();
  ArrayRef<Function *> getMade() const { return made; }

private:
  void findParts();
  bool findPartsOf(ArrayRef<Loop *> loops);
  void addPart(BasicBlock *first, BasicBlock *behind);
  void findShared();
  Function *createPart(unsigned number);
  void callPart(unsigned number, Function *made);
  void storeShared(Value *value);
  Value *getAddress(IRBuilder<> &builder, Value *memory, Value *value);
  Value *load(IRBuilder<> &builder, Value *memory, Value *value);
  /// The number of the part that contains the instruction `value`; -1 if none
  /// does, or if `value` is no instruction.
  int getPart(const Value *value) const;
  Value *getMemory(int part) const;
  bool isHandedOver(const Value *value) const {
    return mayEnd && value == function.getArg(0);
  }

  Function &function;
  ManyLoopsLimits limits;
  /// True if the function, and so each part of it, may return early at a
  /// safepoint.
  bool mayEnd;
  DominatorTree tree;
  LoopInfo loops;
  SmallVector<Part, 0> parts;
  /// For each part of the function, the block that is executed after it.
  SmallVector<BasicBlock *> behind;
  DenseMap<const BasicBlock *, int> partOf;
  SmallVector<Function *> made;
  /// Offsets in `memory` of values that several parts use.
  MapVector<Value *, uint64_t> places;
  uint64_t size = 0;
  AllocaInst *memory = nullptr;
};
} // namespace

//===----------------------------------------------------------------------===//
// Parts
//===----------------------------------------------------------------------===//

/// True if an instruction cannot be moved to another function.
static bool mustStay(const Instruction &instruction) {
  if (isa<AllocaInst, ReturnInst, InvokeInst>(instruction) ||
      instruction.getType()->isTokenTy())
    return true;
  const auto *call = dyn_cast<CallInst>(&instruction);
  return call && (call->isMustTailCall() ||
                  call->hasFnAttr(llvm::Attribute::ReturnsTwice));
}

/// Adds the blocks from `first` up to `next` to the parts that become functions
/// of their own, unless the blocks have several entries or exits.
void LoopDivider::addPart(BasicBlock *first, BasicBlock *next) {
  Part part;
  SmallVector<BasicBlock *> pending = {first};
  BasicBlock *end = next->getSinglePredecessor();
  while (!pending.empty()) {
    BasicBlock *block = pending.pop_back_val();
    if (block == next || !part.insert(block))
      continue;
    if (!tree.dominates(first, block) || tree.dominates(next, block) ||
        succ_empty(block) || any_of(*block, mustStay))
      return;
    append_range(pending, successors(block));
  }
  if (!end || !part.contains(end) || partOf.contains(first) ||
      !isa<BranchInst>(end->getTerminator()) || succ_size(end) != 1)
    return;
  for (BasicBlock *block : part)
    partOf[block] = parts.size();
  parts.push_back(std::move(part));
  behind.push_back(next);
}

/// Divides the loops `siblings`, which have the same parent loop, into parts.
/// False if no part was found.
bool LoopDivider::findPartsOf(ArrayRef<Loop *> siblings) {
  // The chain consists of the loops that dominate the last loop, which is the
  // deepest in the dominator tree.
  auto level = [&](const Loop *loop) {
    return tree.getNode(loop->getHeader())->getLevel();
  };
  Loop *last = *llvm::max_element(siblings, [&](Loop *one, Loop *other) {
    return level(one) < level(other);
  });
  Loop *parent = last->getParentLoop();
  BasicBlock *stop = parent ? parent->getHeader() : &function.getEntryBlock();
  SmallPtrSet<BasicBlock *, 32> headers;
  for (Loop *loop : siblings)
    headers.insert(loop->getHeader());
  // Walk up the dominator tree from the last loop of the chain, and collect
  // blocks at which the chain can be cut, with `limits.part` loops between
  // them.
  SmallVector<BasicBlock *> cuts;
  unsigned count = limits.part;
  for (auto *node = tree.getNode(last->getHeader()); node;
       node = node->getIDom()) {
    BasicBlock *block = node->getBlock();
    count += headers.contains(block);
    bool canCut = loops.getLoopFor(block) == parent && !block->isEHPad() &&
                  block != &function.getEntryBlock();
    if (canCut && (count >= limits.part || block == stop)) {
      cuts.push_back(block);
      count = 0;
    }
    if (block == stop)
      break;
  }
  if (cuts.size() < 3)
    return false;
  for (BasicBlock *&cut : cuts)
    cut = SplitBlock(cut, cut->getFirstNonPHIIt(), &tree, &loops);
  std::reverse(cuts.begin(), cuts.end());
  for (auto [first, next] :
       zip(ArrayRef(cuts).drop_back(), ArrayRef(cuts).drop_front()))
    addPart(first, next);
  return !parts.empty();
}

void LoopDivider::findParts() {
  MapVector<Loop *, SmallVector<Loop *>> siblings;
  for (Loop *loop : loops.getLoopsInPreorder())
    siblings[loop->getParentLoop()].push_back(loop);
  for (auto &[parent, list] : siblings)
    if (list.size() > 2 * limits.part && findPartsOf(list))
      return;
}

//===----------------------------------------------------------------------===//
// What parts share
//===----------------------------------------------------------------------===//

int LoopDivider::getPart(const Value *value) const {
  const auto *instruction = dyn_cast<Instruction>(value);
  if (!instruction)
    return -1;
  auto found = partOf.find(instruction->getParent());
  return found == partOf.end() ? -1 : found->second;
}

Value *LoopDivider::getMemory(int part) const {
  if (part < 0)
    return memory;
  return made[part]->getArg(made[part]->arg_size() - 1);
}

void LoopDivider::findShared() {
  const DataLayout &layout = function.getDataLayout();
  auto share = [&](Value &value) {
    int part = getPart(&value);
    if (isHandedOver(&value) || none_of(value.users(), [&](const User *user) {
          return getPart(user) != part;
        }))
      return;
    size = alignTo(size, layout.getABITypeAlign(value.getType()));
    places[&value] = size;
    size += layout.getTypeAllocSize(value.getType());
  };
  for (Argument &argument : function.args())
    share(argument);
  for (BasicBlock &block : function)
    for (Instruction &instruction : block)
      if (!instruction.getType()->isVoidTy())
        share(instruction);
}

Value *LoopDivider::getAddress(IRBuilder<> &builder, Value *memory,
                               Value *value) {
  return builder.CreatePtrAdd(memory, builder.getInt64(places[value]));
}

Value *LoopDivider::load(IRBuilder<> &builder, Value *memory, Value *value) {
  return builder.CreateAlignedLoad(
      value->getType(), getAddress(builder, memory, value),
      function.getDataLayout().getABITypeAlign(value->getType()));
}

/// Stores a value to the memory that parts share, right after its definition.
void LoopDivider::storeShared(Value *value) {
  auto *from = dyn_cast<Instruction>(value);
  IRBuilder<> builder(function.getContext());
  if (!from)
    builder.SetInsertPoint(memory->getNextNode());
  else if (isa<PHINode>(from))
    builder.SetInsertPoint(from->getParent(),
                           from->getParent()->getFirstInsertionPt());
  else
    builder.SetInsertPoint(from->getNextNode());
  builder.SetCurrentDebugLocation(DebugLoc());
  builder.CreateAlignedStore(
      value, getAddress(builder, getMemory(getPart(value)), value),
      function.getDataLayout().getABITypeAlign(value->getType()));
}

//===----------------------------------------------------------------------===//
// Functions
//===----------------------------------------------------------------------===//

Function *LoopDivider::createPart(unsigned number) {
  LLVMContext &context = function.getContext();
  Type *pointer = PointerType::getUnqual(context);
  llvm::FunctionType *type =
      mayEnd
          ? llvm::FunctionType::get(Type::getInt32Ty(context),
                                    {pointer, pointer}, false)
          : llvm::FunctionType::get(Type::getVoidTy(context), {pointer}, false);
  Function *part = Function::Create(
      type, GlobalValue::InternalLinkage, function.getAddressSpace(),
      function.getName() + ".loops", function.getParent());
  part->copyAttributesFrom(&function);
  part->setLinkage(GlobalValue::InternalLinkage);
  part->setSubprogram(nullptr);
  part->setComdat(nullptr);
  part->setCallingConv(CallingConv::C);
  // Attributes about parameters, memory and the result describe only the whole
  // function: drop them.
  AttrBuilder attributes(context, function.getAttributes().getFnAttrs());
  attributes.removeAttribute(llvm::Attribute::Memory);
  attributes.removeAttribute(llvm::Attribute::AlwaysInline);
  attributes.addAttribute(llvm::Attribute::NoInline);
  attributes.addAttribute(kLoopPart);
  part->setAttributes(
      AttributeList::get(context, AttributeList::FunctionIndex, attributes));
  Argument *shared = part->getArg(part->arg_size() - 1);
  shared->addAttr(llvm::Attribute::NoAlias);
  shared->addAttr(llvm::Attribute::NoUndef);
  return part;
}

/// Moves the blocks of part number `number` to the function `part`, and calls
/// it in their place.
void LoopDivider::callPart(unsigned number, Function *part) {
  LLVMContext &context = function.getContext();
  BasicBlock *first = parts[number].front(), *next = behind[number];
  BasicBlock *before = first->getSinglePredecessor();
  BasicBlock *end = next->getSinglePredecessor();
  auto *place = BasicBlock::Create(context, "", &function, next);
  before->getTerminator()->replaceSuccessorWith(first, place);
  IRBuilder<> builder(place);
  SmallVector<Value *> arguments;
  if (mayEnd)
    arguments.push_back(function.getArg(0));
  arguments.push_back(memory);
  CallInst *call = builder.CreateCall(part, arguments);
  call->setDoesNotThrow();
  if (mayEnd) {
    auto *leave = BasicBlock::Create(context, "", &function, next);
    builder.CreateCondBr(builder.CreateICmpNE(call, builder.getInt32(0)), leave,
                         next);
    IRBuilder<> leaving(leave);
    if (function.getReturnType()->isVoidTy())
      leaving.CreateRetVoid();
    else
      leaving.CreateRet(leaving.getInt32(1));
  } else {
    builder.CreateBr(next);
  }
  end->getTerminator()->eraseFromParent();
  IRBuilder<> ending(end);
  if (mayEnd)
    ending.CreateRet(ending.getInt32(0));
  else
    ending.CreateRetVoid();
  auto *entry = BasicBlock::Create(context, "", part);
  IRBuilder<>(entry).CreateBr(first);
  for (BasicBlock *block : parts[number]) {
    block->removeFromParent();
    block->insertInto(part);
    for (Instruction &instruction : *block) {
      instruction.setDebugLoc(DebugLoc());
      instruction.dropDbgRecords();
    }
  }
}

bool LoopDivider::divide() {
  tree.recalculate(function);
  loops.analyze(tree);
  if (loops.getLoopsInPreorder().size() <= limits.loops)
    return false;
  findParts();
  if (parts.empty())
    return false;
  // Remove lifetime markers of stack memory: parts would contain them, but
  // lifetime markers must refer to memory of their own function.
  for (BasicBlock &block : function)
    for (Instruction &instruction : make_early_inc_range(block))
      if (isa<LifetimeIntrinsic>(instruction))
        instruction.eraseFromParent();
  findShared();
  BasicBlock &entry = function.getEntryBlock();
  IRBuilder<> builder(&entry, entry.getFirstInsertionPt());
  auto *type = ArrayType::get(builder.getInt8Ty(), std::max<uint64_t>(size, 1));
  memory = builder.CreateAlloca(type, nullptr, "shared");
  memory->setAlignment(Align(64));
  for (unsigned number = 0; number != parts.size(); ++number)
    made.push_back(createPart(number));

  // Uses of shared values are replaced by loads before any value is stored,
  // because a store is a use as well.
  DenseMap<std::pair<Value *, int>, Value *> loaded;
  for (auto &[value, place] : places)
    for (Use &use : make_early_inc_range(value->uses())) {
      auto *user = cast<Instruction>(use.getUser());
      int part = getPart(user);
      if (part == getPart(value))
        continue;
      Instruction *at = user;
      if (part >= 0) {
        if (Value *known = loaded.lookup({value, part})) {
          use.set(known);
          continue;
        }
        at = &parts[part].front()->front();
      } else if (auto *phi = dyn_cast<PHINode>(user)) {
        at = phi->getIncomingBlock(use)->getTerminator();
      }
      IRBuilder<> loading(at);
      loading.SetCurrentDebugLocation(DebugLoc());
      Value *known = load(loading, getMemory(part), value);
      use.set(known);
      if (part >= 0)
        loaded[{value, part}] = known;
    }
  for (auto &[value, place] : places)
    storeShared(value);
  if (mayEnd)
    for (Use &use : make_early_inc_range(function.getArg(0)->uses()))
      if (int part = getPart(use.getUser()); part >= 0)
        use.set(made[part]->getArg(0));
  for (unsigned number = 0; number != parts.size(); ++number)
    callPart(number, made[number]);
  return true;
}

bool mlir::tai::divideManyLoops(Module &module, ManyLoopsLimits limits) {
  bool changed = false;
  SmallVector<Function *> all;
  for (Function &function : module)
    if (!function.isDeclaration())
      all.push_back(&function);
  while (!all.empty()) {
    Function *function = all.pop_back_val();
    LoopDivider divider(*function, limits);
    if (!divider.divide())
      continue;
    changed = true;
    // The rest of the function, and the new functions, possibly have chains of
    // loops that are still too long.
    all.push_back(function);
    append_range(all, divider.getMade());
  }
  return changed;
}
