//===- HugeBodies.cpp - Limits of superlinear passes ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The time of scheduling and register allocation is quadratic in the size of a
// block, and the vectoriser makes three copies of a loop's body, in which each
// call of a function like sin becomes one call for each vector element.
// Unrolled programs have blocks of thousands of instructions, which would take
// minutes.
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/HugeBodies.h"
#include "tai/CodeGen/Passes/ManyLoops.h"
#include "llvm/Analysis/LoopInfo.h"
#include "llvm/Analysis/TargetLibraryInfo.h"
#include "llvm/Analysis/TargetTransformInfo.h"
#include "llvm/Analysis/VectorUtils.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/IntrinsicInst.h"
#include "llvm/IR/Module.h"
#include "llvm/Target/TargetMachine.h"
#include "llvm/Transforms/Utils/LoopUtils.h"

using namespace llvm;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Loops
//===----------------------------------------------------------------------===//

namespace {
/// The number of elements of a vector that the size estimates assume.
constexpr unsigned kLanes = 8;

/// Marks functions that contain a loop with too many pairs of accesses.
constexpr StringLiteral kManyPairs = "tai-many-pairs";
} // namespace

/// Estimates the number of instructions that a call of a library function
/// becomes once the loop around it is vectorised.
static uint64_t getVectorizedSize(const CallBase &call,
                                  const TargetTransformInfo &target,
                                  const TargetLibraryInfo &library) {
  Function *callee = call.getCalledFunction();
  Type *type = call.getType();
  if (!callee || !callee->isIntrinsic() || type->isVoidTy() ||
      !VectorType::isValidElementType(type) ||
      !isTriviallyVectorizable(callee->getIntrinsicID()))
    return 1;
  std::string name = callee->getName().str();
  if (library.isFunctionVectorizable(name))
    return 1;
  SmallVector<Type *> types;
  for (Value *argument : call.args())
    types.push_back(VectorType::isValidElementType(argument->getType())
                        ? FixedVectorType::get(argument->getType(), kLanes)
                        : argument->getType());
  IntrinsicCostAttributes attributes(callee->getIntrinsicID(),
                                     FixedVectorType::get(type, kLanes), types);
  InstructionCost cost = target.getIntrinsicInstrCost(
      attributes, TargetTransformInfo::TCK_CodeSize);
  return cost.isValid() ? std::max<int64_t>(cost.getValue(), 1) : kLanes;
}

PreservedAnalyses KeepHugeLoopsScalar::run(Function &function,
                                           FunctionAnalysisManager &analyses) {
  uint64_t count = function.getInstructionCount();
  bool isPart = function.hasFnAttribute(kLoopPart);
  if (!isPart && count * kLanes * 4 < limits.vectorized &&
      count * count < limits.loopPairs)
    return PreservedAnalyses::all();
  auto &loops = analyses.getResult<LoopAnalysis>(function);
  auto &target = analyses.getResult<TargetIRAnalysis>(function);
  auto &library = analyses.getResult<TargetLibraryAnalysis>(function);
  SmallVector<Loop *, 4> all = loops.getLoopsInPreorder();
  for (Loop *loop : all) {
    if (isPart || all.size() > limits.loops)
      addStringMetadataToLoop(loop, "llvm.loop.unroll.disable");
    if (!loop->isInnermost())
      continue;
    uint64_t size = 0, accesses = 0, writes = 0;
    for (const BasicBlock *block : loop->blocks())
      for (const Instruction &instruction : *block) {
        const auto *call = dyn_cast<CallBase>(&instruction);
        size += call ? getVectorizedSize(*call, target, library) : 1;
        accesses += instruction.mayReadOrWriteMemory();
        writes += instruction.mayWriteToMemory();
      }
    bool hasManyPairs = writes * accesses > limits.loopPairs;
    if (size > limits.vectorized || hasManyPairs)
      addStringMetadataToLoop(loop, "llvm.loop.vectorize.enable", 0);
    if (hasManyPairs)
      function.addFnAttr(kManyPairs);
  }
  return PreservedAnalyses::all();
}

/// True if some block of the function has more instructions than `limit`.
static bool hasBlockAbove(const Function &function, unsigned limit) {
  return any_of(function,
                [&](const BasicBlock &block) { return block.size() > limit; });
}

bool KeepHugeLoopsScalar::canRun(StringRef pass, const Any &ir) {
  const auto *function = any_cast<const Function *>(&ir);
  if (!function)
    return true;
  if (pass == "LoopLoadEliminationPass")
    return !(*function)->hasFnAttribute(kManyPairs);
  // The SLP vectoriser does not run on functions with huge blocks, which are
  // made by unrolling consecutive short loops.
  return pass != "SLPVectorizerPass" ||
         !hasBlockAbove(**function, HugeBodyLimits().block);
}

//===----------------------------------------------------------------------===//
// Blocks
//===----------------------------------------------------------------------===//

/// Estimates the number of machine instructions that one IR instruction
/// becomes.
static uint64_t getMachineSize(const Instruction &instruction,
                               const TargetTransformInfo &target) {
  const auto *call = dyn_cast<IntrinsicInst>(&instruction);
  if (!call || !call->getType()->isVectorTy())
    return 1;
  InstructionCost cost =
      target.getInstructionCost(call, TargetTransformInfo::TCK_CodeSize);
  return cost.isValid() ? std::max<int64_t>(cost.getValue(), 1) : 1;
}

/// True if an instruction cannot be moved to another function.
static bool mustStay(const Instruction &instruction) {
  if (isa<PHINode>(instruction) || isa<AllocaInst>(instruction) ||
      instruction.isTerminator() || instruction.isEHPad() ||
      instruction.getType()->isTokenTy())
    return true;
  const auto *call = dyn_cast<CallBase>(&instruction);
  if (!call)
    return false;
  if (call->hasFnAttr(Attribute::ReturnsTwice) || call->hasOperandBundles())
    return true;
  if (const auto *tail = dyn_cast<CallInst>(call);
      tail && tail->isMustTailCall())
    return true;
  switch (call->getIntrinsicID()) {
  case Intrinsic::lifetime_start:
  case Intrinsic::lifetime_end:
  case Intrinsic::stacksave:
  case Intrinsic::stackrestore:
  case Intrinsic::vastart:
  case Intrinsic::vaend:
  case Intrinsic::vacopy:
  case Intrinsic::frameaddress:
  case Intrinsic::returnaddress:
    return true;
  default:
    return false;
  }
}

namespace {
using Part = SmallVector<Instruction *, 0>;

/// Divides one huge block into parts that are outlined into functions.
class BlockDivider {
public:
  BlockDivider(BasicBlock &block, ArrayRef<Part> parts)
      : block(block), function(*block.getParent()), parts(parts),
        layout(function.getDataLayout()) {}

  void divide();

private:
  /// Returns the offset, in the memory that the parts share, of a value that
  /// other parts may use.
  uint64_t getPlace(Value *value);
  Value *getAddress(IRBuilder<> &builder, Value *memory, Value *value);
  void storeTo(IRBuilder<> &builder, Value *memory, Value *value);
  Value *loadFrom(IRBuilder<> &builder, Value *memory, Value *value);
  void outline(const Part &part, unsigned number);

  BasicBlock &block;
  Function &function;
  ArrayRef<Part> parts;
  const DataLayout &layout;
  /// For each instruction of the block, the number of the part that contains
  /// it.
  DenseMap<const Instruction *, unsigned> partOf;
  DenseMap<const Value *, uint64_t> places;
  uint64_t size = 0;
  AllocaInst *memory = nullptr;
};
} // namespace

uint64_t BlockDivider::getPlace(Value *value) {
  auto [found, isNew] = places.try_emplace(value, 0);
  if (isNew) {
    Type *type = value->getType();
    found->second = alignTo(size, layout.getABITypeAlign(type));
    size = found->second + layout.getTypeAllocSize(type);
  }
  return found->second;
}

Value *BlockDivider::getAddress(IRBuilder<> &builder, Value *memory,
                                Value *value) {
  return builder.CreatePtrAdd(memory, builder.getInt64(getPlace(value)));
}

void BlockDivider::storeTo(IRBuilder<> &builder, Value *memory, Value *value) {
  builder.CreateAlignedStore(value, getAddress(builder, memory, value),
                             layout.getABITypeAlign(value->getType()));
}

Value *BlockDivider::loadFrom(IRBuilder<> &builder, Value *memory,
                              Value *value) {
  return builder.CreateAlignedLoad(value->getType(),
                                   getAddress(builder, memory, value),
                                   layout.getABITypeAlign(value->getType()));
}

/// Moves the instructions of a part to a new function, and inserts a call of
/// this function in their place.
void BlockDivider::outline(const Part &part, unsigned number) {
  LLVMContext &context = function.getContext();
  auto *type = FunctionType::get(Type::getVoidTy(context),
                                 {PointerType::getUnqual(context)}, false);
  Function *made = Function::Create(
      type, GlobalValue::InternalLinkage, function.getAddressSpace(),
      function.getName() + ".part", function.getParent());
  made->copyAttributesFrom(&function);
  made->setLinkage(GlobalValue::InternalLinkage);
  made->setSubprogram(nullptr);
  made->setComdat(nullptr);
  // Attributes about parameters, memory and the result describe only the whole
  // function, and are dropped for its parts.
  AttrBuilder attributes(context, made->getAttributes().getFnAttrs());
  attributes.removeAttribute(Attribute::Memory);
  attributes.removeAttribute(Attribute::AlwaysInline);
  attributes.addAttribute(Attribute::NoInline);
  made->setAttributes(
      AttributeList::get(context, AttributeList::FunctionIndex, attributes));
  made->addParamAttr(0, Attribute::NoUndef);
  made->setCallingConv(CallingConv::C);

  IRBuilder<> outer(part.front());
  outer.SetCurrentDebugLocation(DebugLoc());
  CallInst *call = outer.CreateCall(made, {memory});
  call->setDoesNotThrow();

  auto *body = BasicBlock::Create(context, "", made);
  IRBuilder<> builder(body);
  builder.CreateRetVoid();
  Instruction *end = body->getTerminator();
  DenseMap<Value *, Value *> loaded;
  for (Instruction *instruction : part) {
    instruction->moveBefore(end->getIterator());
    instruction->setDebugLoc(DebugLoc());
    instruction->dropDbgRecords();
    builder.SetInsertPoint(instruction);
    for (Use &use : instruction->operands()) {
      Value *value = use.get();
      auto *from = dyn_cast<Instruction>(value);
      if (!isa<Argument>(value) && !from)
        continue;
      if (from) {
        auto found = partOf.find(from);
        if (found != partOf.end() && found->second == number)
          continue;
      }
      Value *&mine = loaded[value];
      if (!mine)
        mine = loadFrom(builder, made->getArg(0), value);
      use.set(mine);
    }
  }
  // The values of this part that other parts use are stored to shared memory,
  // at offsets that `divide` has assigned.
  for (Instruction *instruction : part) {
    if (!places.contains(instruction))
      continue;
    builder.SetInsertPoint(instruction->getNextNode());
    storeTo(builder, made->getArg(0), instruction);
  }
}

void BlockDivider::divide() {
  for (auto [number, part] : enumerate(parts))
    for (Instruction *instruction : part)
      partOf[instruction] = number;
  LLVMContext &context = function.getContext();
  IRBuilder<> entry(&function.getEntryBlock().front());
  memory = entry.CreateAlloca(ArrayType::get(entry.getInt8Ty(), 0), nullptr,
                              "shared");
  memory->setAlignment(Align(64));

  // Finds values that the parts use and that are defined outside of all parts,
  // and uses of a part's values outside of the part.
  SetVector<Value *> given;
  SmallVector<std::pair<Use *, Instruction *>> taken;
  for (auto [number, part] : enumerate(parts)) {
    for (Instruction *instruction : part) {
      for (Value *value : instruction->operands())
        if (isa<Argument>(value) ||
            (isa<Instruction>(value) &&
             !partOf.contains(cast<Instruction>(value))))
          given.insert(value);
      for (Use &use : instruction->uses()) {
        auto *user = cast<Instruction>(use.getUser());
        auto found = partOf.find(user);
        if (found != partOf.end() && found->second == number)
          continue;
        (void)getPlace(instruction);
        if (found == partOf.end())
          taken.push_back({&use, user});
      }
    }
  }
  // A value from outside of the parts is stored to the shared memory after its
  // definition if it is defined in this block, or else before the first part.
  for (Value *value : given) {
    auto *from = dyn_cast<Instruction>(value);
    bool isHere = from && from->getParent() == &block && !isa<PHINode>(from);
    IRBuilder<> builder(isHere ? from->getNextNode() : parts.front().front());
    builder.SetCurrentDebugLocation(DebugLoc());
    storeTo(builder, memory, value);
  }
  for (auto [number, part] : enumerate(parts))
    outline(part, number);
  // A use outside of the parts loads the value from the shared memory: in this
  // block, right before the use; in other blocks, at the end of this block.
  DenseMap<Value *, Value *> atEnd;
  for (auto [use, user] : taken) {
    Value *value = use->get();
    bool isHere = user->getParent() == &block && !isa<PHINode>(user);
    if (isHere && !user->isTerminator()) {
      IRBuilder<> builder(user);
      use->set(loadFrom(builder, memory, value));
      continue;
    }
    Value *&last = atEnd[value];
    if (!last) {
      IRBuilder<> builder(block.getTerminator());
      builder.SetCurrentDebugLocation(DebugLoc());
      last = loadFrom(builder, memory, value);
    }
    use->set(last);
  }
  memory->setAllocatedType(
      ArrayType::get(Type::getInt8Ty(context), std::max<uint64_t>(size, 1)));
}

namespace {
/// Estimates how many machine instructions the instructions of one function
/// become.
class Sizes {
public:
  Sizes(const Function &function, const TargetMachine *machine)
      : target(machine ? machine->getTargetTransformInfo(function)
                       : TargetTransformInfo(function.getDataLayout())) {}

  uint64_t of(const Instruction &instruction) const {
    return getMachineSize(instruction, target);
  }
  bool isHuge(const BasicBlock &block, const HugeBodyLimits &limits) const;
  SmallVector<Part, 0> getParts(BasicBlock &block, unsigned limit) const;

private:
  TargetTransformInfo target;
};
} // namespace

/// Marks functions in which calls of library functions were kept.
constexpr StringLiteral kCallsKept("tai-calls-kept");

bool Sizes::isHuge(const BasicBlock &block,
                   const HugeBodyLimits &limits) const {
  uint64_t size = 0, accesses = 0, writes = 0;
  for (const Instruction &instruction : block) {
    size += of(instruction);
    accesses += instruction.mayReadOrWriteMemory();
    writes += instruction.mayWriteToMemory();
  }
  bool hasCalls = block.getParent()->hasFnAttribute(kCallsKept);
  return size > (hasCalls ? limits.blockOfCalls : limits.block) ||
         writes * accesses > limits.pairs;
}

/// Groups the movable instructions of a block, in order, into parts of
/// consecutive instructions.
SmallVector<Part, 0> Sizes::getParts(BasicBlock &block, unsigned limit) const {
  SmallVector<Part, 0> parts;
  uint64_t size = limit;
  for (Instruction &instruction : block) {
    if (mustStay(instruction)) {
      size = limit;
      continue;
    }
    if (size >= limit) {
      parts.emplace_back();
      size = 0;
    }
    parts.back().push_back(&instruction);
    size += of(instruction);
  }
  return parts;
}

void mlir::tai::divideHugeBlocks(Module &module, const TargetMachine *machine,
                                 HugeBodyLimits limits) {
  // An upper bound of the machine instructions that one IR instruction becomes,
  // including library calls in vectorised loops: blocks with few IR
  // instructions need no estimate.
  constexpr unsigned most = 64;
  SmallVector<BasicBlock *> huge;
  for (Function &function : module) {
    std::optional<Sizes> sizes;
    for (BasicBlock &block : function) {
      uint64_t size = block.size();
      if (size * most <= std::min(limits.block, limits.blockOfCalls) &&
          size * size <= limits.pairs)
        continue;
      if (!sizes)
        sizes.emplace(function, machine);
      if (sizes->isHuge(block, limits))
        huge.push_back(&block);
    }
  }
  for (BasicBlock *block : huge) {
    SmallVector<Part, 0> parts =
        Sizes(*block->getParent(), machine).getParts(*block, limits.part);
    if (!parts.empty())
      BlockDivider(*block, parts).divide();
  }
}

//===----------------------------------------------------------------------===//
// Calls
//===----------------------------------------------------------------------===//

void mlir::tai::keepCallsInHugeFunctions(Module &module, StringRef prefix,
                                         HugeBodyLimits limits) {
  // A library function with fewer instructions than this is no longer than a
  // call of it.
  constexpr unsigned shortest = 10;
  for (Function &function : module) {
    if (function.getName().starts_with(prefix))
      continue;
    SmallVector<CallInst *> calls;
    uint64_t size = 0;
    for (Instruction &instruction : instructions(function)) {
      auto *call = dyn_cast<CallInst>(&instruction);
      Function *callee = call ? call->getCalledFunction() : nullptr;
      if (!callee || callee->isDeclaration() ||
          !callee->getName().starts_with(prefix))
        continue;
      unsigned inside = callee->getInstructionCount();
      size += inside;
      if (inside > shortest)
        calls.push_back(call);
    }
    if (size <= limits.inlined)
      continue;
    function.addFnAttr(kCallsKept);
    for (CallInst *call : calls)
      call->setIsNoInline();
  }
}
