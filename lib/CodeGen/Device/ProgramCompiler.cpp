//===- ProgramCompiler.cpp - Fuses kernels into a program -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Links the bodies of kernels into one module. Repeated steps of a program
// become loops that call these bodies. A function of the device library
// executes the other steps from a table, with a generated function that calls
// the body of a step.
//
//===----------------------------------------------------------------------===//

#include "ProgramParts.h"
#include "TileBuilder.h"
#include "tai/ABI/DeviceAbi.h"
#include "tai/CodeGen/Device/DeviceCompiler.h"
#include "llvm/Bitcode/BitcodeReader.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/InlineAsm.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/Linker/Linker.h"
#include "llvm/Target/TargetMachine.h"

using namespace mlir;
using namespace mlir::tai;
using llvm::createStringError;
using llvm::Expected;

static constexpr llvm::StringLiteral programName = TAI_PROGRAM_FUNCTION;

/// The maximum number of instructions of a program. Longer programs are
/// refused: ptxas takes 1.4 s for 6,000 instructions, 10 s for 11,600, 28 s for
/// 24,000, and 88 s for 45,000.
static constexpr unsigned kMostInstructions = 12000;

static StringRef getRunnerName(int scope) {
  switch (scope) {
  case TAI_SCOPE_BLOCK:
    return "tai_dev_program_block";
  case TAI_SCOPE_CLUSTER:
    return "tai_dev_program_cluster";
  default:
    return "tai_dev_program_grid";
  }
}

Expected<llvm::Function *> tai::addPart(llvm::Module &module, StringRef bytes,
                                        StringRef name, size_t number) {
  auto part = llvm::parseBitcodeFile(llvm::MemoryBufferRef(bytes, "part"),
                                     module.getContext());
  if (!part)
    return part.takeError();
  llvm::Function *body = (*part)->getFunction(name);
  if (!body || body->isDeclaration())
    return createStringError("the code of a kernel holds no '%s'",
                             name.str().c_str());
  std::string unique = ("part" + Twine(number) + "." + name).str();
  body->setName(unique);
  for (llvm::GlobalValue &value : (*part)->global_values())
    if (!value.isDeclaration() && &value != body) {
      // Each part has its own copies of library functions, possibly specialised
      // in different ways, so the copies are renamed.
      if (value.hasName())
        value.setName("part" + Twine(number) + "." + value.getName());
      value.setLinkage(llvm::GlobalValue::InternalLinkage);
    }
  if (llvm::Linker::linkModules(module, std::move(*part)))
    return createStringError("the code of kernels does not link");
  body = module.getFunction(unique);
  body->setLinkage(llvm::GlobalValue::InternalLinkage);
  body->setCallingConv(llvm::CallingConv::C);
  body->removeFnAttr(llvm::Attribute::OptimizeNone);
  body->removeFnAttr(llvm::Attribute::NoInline);
  body->removeFnAttr("nvvm.maxntid");
  body->addFnAttr(llvm::Attribute::AlwaysInline);
  return body;
}

void tai::dropInvariantLoads(llvm::Function &function) {
  for (llvm::Instruction &instruction : llvm::instructions(function))
    instruction.setMetadata(llvm::LLVMContext::MD_invariant_load, nullptr);
}

static StringRef getBarrierName(int scope) {
  switch (scope) {
  case TAI_SCOPE_BLOCK:
    return "tai_dev_program_wait_block";
  case TAI_SCOPE_CLUSTER:
    return "tai_dev_program_wait_cluster";
  default:
    return "tai_dev_program_wait_grid";
  }
}

/// Emits a call of the program part `body`, whose parameters are in the memory
/// `slots`.
static void callPart(llvm::IRBuilder<> &builder, llvm::Function *body,
                     llvm::Value *slots, bool isCuda) {
  // On the emulated device, a part of a program takes the pointer to its
  // parameter slots.
  if (!isCuda) {
    builder.CreateCall(body, {slots});
    return;
  }
  SmallVector<llvm::Value *> arguments;
  for (llvm::Argument &parameter : body->args()) {
    llvm::Type *type = parameter.getType();
    llvm::Value *slot = builder.CreateConstInBoundsGEP1_64(
        builder.getInt64Ty(), slots, parameter.getArgNo());
    llvm::Value *value;
    if (type->isPointerTy()) {
      // Pointer parameters of kernels point to global memory. An address that
      // is loaded as an integer needs the cast that says so.
      llvm::Value *address = builder.CreateLoad(builder.getInt64Ty(), slot);
      value = builder.CreateAddrSpaceCast(
          builder.CreateIntToPtr(address, builder.getPtrTy(/*AddrSpace=*/1)),
          type);
    } else if (type->isIntegerTy(1)) {
      value = builder.CreateTrunc(builder.CreateLoad(builder.getInt8Ty(), slot),
                                  type);
    } else {
      value = builder.CreateLoad(type, slot);
    }
    arguments.push_back(value);
  }
  builder.CreateCall(body, arguments);
}

/// Adds the function `tai_program_dispatch`, which calls a part by its number.
static void addDispatch(llvm::Module &module,
                        ArrayRef<runtime::ProgramPart> parts,
                        ArrayRef<llvm::Function *> bodies, bool isCuda) {
  llvm::LLVMContext &context = module.getContext();
  llvm::IRBuilder<> builder(context);
  auto *type = llvm::FunctionType::get(
      builder.getVoidTy(), {builder.getInt64Ty(), builder.getPtrTy()}, false);
  // The device library calls this function, so it stays external until the
  // program is linked.
  auto *dispatch = llvm::Function::Create(
      type, llvm::GlobalValue::ExternalLinkage, "tai_program_dispatch", module);
  dispatch->addFnAttr(llvm::Attribute::AlwaysInline);
  auto *entry = llvm::BasicBlock::Create(context, "", dispatch);
  auto *exit = llvm::BasicBlock::Create(context, "", dispatch);
  builder.SetInsertPoint(exit);
  builder.CreateRetVoid();
  builder.SetInsertPoint(entry);
  llvm::SwitchInst *choice =
      builder.CreateSwitch(dispatch->getArg(0), exit, bodies.size());
  for (auto [i, body] : llvm::enumerate(bodies)) {
    if (!parts[i].isInTable)
      continue;
    auto *block = llvm::BasicBlock::Create(context, "", dispatch);
    choice->addCase(builder.getInt64(TAI_FIRST_PART + i), block);
    builder.SetInsertPoint(block);
    callPart(builder, body, dispatch->getArg(1), isCuda);
    builder.CreateBr(exit);
  }
}

namespace {
/// Builds the kernel that runs a whole program (the fused bodies of several
/// kernels).
class ProgramBuilder {
public:
  ProgramBuilder(llvm::Module &module, const runtime::ProgramPlan &plan,
                 ArrayRef<llvm::Function *> bodies, bool isCuda)
      : module(module), plan(plan), bodies(bodies), isCuda(isCuda),
        builder(module.getContext()) {}
  llvm::Function *build();

private:
  void addRows(const runtime::ProgramSegment &segment, uint64_t row);
  void addLoop(const runtime::ProgramSegment &segment);
  void addStep(const runtime::ProgramLoopStep &step);
  void addChain(const runtime::ProgramLoopStep &step);
  void addHalf(const runtime::ProgramLoopStep &step, bool isSecond);
  const runtime::TileChain *getChain(const runtime::ProgramLoopStep &step) {
    return step.part < runtime::firstChainPart
               ? nullptr
               : &plan.chains[step.part - runtime::firstChainPart];
  }
  void makeOverlays();
  llvm::Value *getOverlay();
  llvm::Value *getParameter(const runtime::ProgramSlot &slot);
  void prefetch(llvm::Value *address);
  void addGroups(const runtime::ProgramSegment &segment);
  void wait();
  void noteClock(llvm::Value *steps);
  llvm::FunctionCallee getLibrary(StringRef name,
                                  ArrayRef<llvm::Type *> types) {
    return module.getOrInsertFunction(
        name, llvm::FunctionType::get(builder.getVoidTy(), types, false));
  }

  /// The first arguments of the program's kernel; from FirstWord on, arguments
  /// are the parameters of loops.
  enum { Table, Stride, Header, FirstWord };

  llvm::Module &module;
  const runtime::ProgramPlan &plan;
  ArrayRef<llvm::Function *> bodies;
  bool isCuda;
  llvm::IRBuilder<> builder;
  llvm::Function *kernel = nullptr;
  /// Stack memory for the parameters of a part, if the part takes the address
  /// of its parameters.
  llvm::AllocaInst *room = nullptr;
  /// Memory for the overlays of tile chains: the shared memory of the block; on
  /// an emulated device, one memory for the overlays of all blocks.
  llvm::Value *overlays = nullptr;
  int64_t overlayBytes = 0;
  /// Inside of a loop of the program: the number of the iteration, and the
  /// address of the row that the loop's list has for the iteration.
  llvm::PHINode *turn = nullptr;
  llvm::Value *listRow = nullptr;
};
} // namespace

llvm::Function *ProgramBuilder::build() {
  llvm::LLVMContext &context = module.getContext();
  llvm::Type *pointer = builder.getPtrTy(), *i64 = builder.getInt64Ty();
  SmallVector<llvm::Type *> types{pointer, i64, pointer};
  types.append(plan.words, i64);
  auto *type = llvm::FunctionType::get(builder.getVoidTy(), types, false);
  kernel = llvm::Function::Create(type, llvm::GlobalValue::ExternalLinkage,
                                  programName, module);
  builder.SetInsertPoint(llvm::BasicBlock::Create(context, "", kernel));
  room = builder.CreateAlloca(llvm::ArrayType::get(i64, TAI_PROGRAM_STRIDE));
  makeOverlays();
  noteClock(builder.getInt64(0));
  uint64_t row = 0;
  for (const runtime::ProgramSegment &segment : plan.segments) {
    if (segment.isLoop()) {
      addLoop(segment);
      continue;
    }
    addRows(segment, row);
    row += segment.count;
  }
  builder.CreateRetVoid();
  if (isCuda) {
    kernel->setCallingConv(llvm::CallingConv::PTX_Kernel);
    kernel->addFnAttr("nvvm.maxntid", std::to_string(plan.threads));
  }
  return kernel;
}

/// Adds a kernel that does nothing but call the function `name` of the device
/// library.
static Expected<llvm::Function *> addLibraryKernel(llvm::Module &module,
                                                   const llvm::Module &library,
                                                   StringRef name,
                                                   bool isCuda) {
  const llvm::Function *function = library.getFunction(name);
  if (!function)
    return createStringError("the device library has no '%s'",
                             name.str().c_str());
  llvm::LLVMContext &context = module.getContext();
  llvm::IRBuilder<> builder(context);
  llvm::FunctionCallee callee =
      module.getOrInsertFunction(name, function->getFunctionType());
  auto *kernel = llvm::Function::Create(function->getFunctionType(),
                                        llvm::GlobalValue::ExternalLinkage,
                                        name + "_kernel", module);
  builder.SetInsertPoint(llvm::BasicBlock::Create(context, "", kernel));
  SmallVector<llvm::Value *> arguments;
  for (llvm::Argument &argument : kernel->args())
    arguments.push_back(&argument);
  builder.CreateCall(callee, arguments);
  builder.CreateRetVoid();
  if (isCuda)
    kernel->setCallingConv(llvm::CallingConv::PTX_Kernel);
  return kernel;
}

static Expected<runtime::DeviceImage>
makeLibrary(DeviceCompiler &compiler, ArrayRef<runtime::ProgramPart> parts) {
  bool isCuda = compiler.isCuda();
  DeviceCode code = compiler.createCode("library");
  llvm::Module &module = *code.module;
  llvm::ArrayRef<char> bytes = getDeviceLibrary(
      isCuda ? runtime::DeviceKind::Cuda : runtime::DeviceKind::Emulated);
  auto library = llvm::getLazyBitcodeModule(
      llvm::MemoryBufferRef(StringRef(bytes.data(), bytes.size()), "library"),
      *code.context);
  if (!library)
    return library.takeError();
  llvm::DenseSet<const llvm::GlobalValue *> visible;
  for (const runtime::ProgramPart &part : parts) {
    auto kernel = addLibraryKernel(module, **library, part.function, isCuda);
    if (!kernel)
      return kernel.takeError();
    code.functions.push_back((*kernel)->getName().str());
    visible.insert(isCuda ? *kernel : addSlotsFunction(**kernel));
  }
  return compiler.finish(code, [&](const llvm::GlobalValue &value) {
    return visible.contains(&value);
  });
}

/// Emits a call of the device library's function that runs steps from the step
/// table.
void ProgramBuilder::addRows(const runtime::ProgramSegment &segment,
                             uint64_t row) {
  llvm::Type *pointer = builder.getPtrTy(), *i64 = builder.getInt64Ty();
  llvm::FunctionCallee runner =
      getLibrary(getRunnerName(plan.scope), {pointer, i64, i64, pointer, i64});
  llvm::Value *stride = kernel->getArg(Stride);
  llvm::Value *from =
      builder.CreateGEP(i64, kernel->getArg(Table),
                        builder.CreateMul(stride, builder.getInt64(row)));
  builder.CreateCall(runner,
                     {from, builder.getInt64(segment.count), stride,
                      kernel->getArg(Header), builder.getInt64(segment.first)});
}

void ProgramBuilder::addLoop(const runtime::ProgramSegment &segment) {
  llvm::LLVMContext &context = module.getContext();
  llvm::BasicBlock *before = builder.GetInsertBlock();
  auto *body = llvm::BasicBlock::Create(context, "", kernel);
  auto *after = llvm::BasicBlock::Create(context, "", kernel);
  builder.CreateBr(body);
  builder.SetInsertPoint(body);
  llvm::Type *i64 = builder.getInt64Ty();
  turn = builder.CreatePHI(i64, 2);
  turn->addIncoming(builder.getInt64(0), before);
  llvm::Value *first = nullptr;
  if (plan.isTimed)
    first = builder.CreateAdd(
        builder.getInt64(segment.first),
        builder.CreateMul(turn, builder.getInt64(segment.steps.size())));
  if (segment.listWidth > 0) {
    llvm::Value *words =
        builder.CreateMul(turn, builder.getInt64(segment.listWidth));
    listRow = builder.CreateGEP(
        i64, kernel->getArg(Table),
        builder.CreateAdd(words, builder.getInt64(segment.listStart)));
    // The parameters of the next iteration, in the loop's list, are prefetched.
    constexpr size_t lineWords = 16;
    for (size_t i = 0; isCuda && i < segment.listWidth; i += lineWords)
      prefetch(builder.CreateConstGEP1_64(i64, listRow, segment.listWidth + i));
  }
  if (!isCuda)
    addGroups(segment);
  for (size_t i = 0; isCuda && i < segment.steps.size(); ++i) {
    addStep(segment.steps[i]);
    if (segment.steps[i].waits)
      wait();
    if (plan.isTimed)
      noteClock(builder.CreateAdd(first, builder.getInt64(i + 1)));
  }
  llvm::Value *next = builder.CreateAdd(turn, builder.getInt64(1));
  turn->addIncoming(next, builder.GetInsertBlock());
  llvm::Instruction *back = builder.CreateCondBr(
      builder.CreateICmpULT(next, builder.getInt64(segment.count)), body,
      after);
  // The body of the loop is not unrolled: it is long, since it holds whole
  // kernels.
  disableUnrolling(back);
  builder.SetInsertPoint(after);
}

/// Emits a loop for the emulated device, where threads run one after another,
/// each from one barrier to the next; see tai_emu_begin_group.
void ProgramBuilder::addGroups(const runtime::ProgramSegment &segment) {
  llvm::LLVMContext &context = module.getContext();
  llvm::Type *i32 = builder.getInt32Ty();
  // A step that is a tile chain is split in two halves, loads and stores, if
  // all blocks must have loaded before any block stores.
  enum Half { First, Second, Both };
  SmallVector<SmallVector<std::pair<const runtime::ProgramLoopStep *, Half>>>
      groups(1);
  for (const runtime::ProgramLoopStep &step : segment.steps) {
    const runtime::TileChain *chain = getChain(step);
    if (chain && chain->mustWait) {
      groups.back().push_back({&step, First});
      groups.emplace_back();
      groups.back().push_back({&step, Second});
    } else {
      groups.back().push_back({&step, Both});
    }
    if (step.waits)
      groups.emplace_back();
  }
  for (const auto &group : groups) {
    if (group.empty())
      continue;
    llvm::Value *threads = builder.CreateCall(
        module.getOrInsertFunction("tai_emu_begin_group",
                                   llvm::FunctionType::get(i32, false)),
        {});
    llvm::BasicBlock *before = builder.GetInsertBlock();
    auto *body = llvm::BasicBlock::Create(context, "", kernel);
    auto *after = llvm::BasicBlock::Create(context, "", kernel);
    builder.CreateBr(body);
    builder.SetInsertPoint(body);
    llvm::PHINode *thread = builder.CreatePHI(i32, 2);
    thread->addIncoming(builder.getInt32(0), before);
    builder.CreateCall(getLibrary("tai_emu_next_in_group", {}), {});
    for (auto [step, half] : group) {
      if (!getChain(*step)) {
        addStep(*step);
        continue;
      }
      if (half != Second)
        addHalf(*step, /*isSecond=*/false);
      if (half != First)
        addHalf(*step, /*isSecond=*/true);
    }
    llvm::Value *next = builder.CreateAdd(thread, builder.getInt32(1));
    thread->addIncoming(next, builder.GetInsertBlock());
    builder.CreateCondBr(builder.CreateICmpSLT(next, threads), body, after);
    builder.SetInsertPoint(after);
    builder.CreateCall(getLibrary("tai_emu_end_group", {}), {});
  }
}

void ProgramBuilder::prefetch(llvm::Value *address) {
  auto *type =
      llvm::FunctionType::get(builder.getVoidTy(), {builder.getPtrTy()}, false);
  builder.CreateCall(llvm::InlineAsm::get(type, "prefetch.global.L1 [$0];", "l",
                                          /*hasSideEffects=*/true),
                     {address});
}

/// Allocates the overlay of a thread block, as large as the largest tile chain
/// requires.
void ProgramBuilder::makeOverlays() {
  for (const runtime::TileChain &chain : plan.chains)
    overlayBytes = std::max(overlayBytes, chain.bytes);
  if (overlayBytes == 0)
    return;
  llvm::Type *bytes = llvm::ArrayType::get(builder.getInt8Ty(), overlayBytes);
  llvm::Align alignment(16);
  if (!isCuda) {
    int64_t most = 1;
    for (const runtime::TileChain &chain : plan.chains)
      most = std::max(most, chain.numTiles());
    llvm::AllocaInst *all =
        builder.CreateAlloca(llvm::ArrayType::get(bytes, most));
    all->setAlignment(alignment);
    overlays = all;
    return;
  }
  constexpr unsigned shared = 3;
  auto *memory = new llvm::GlobalVariable(
      module, bytes, /*isConstant=*/false, llvm::GlobalValue::InternalLinkage,
      llvm::UndefValue::get(bytes), "tai_program_overlay", nullptr,
      llvm::GlobalValue::NotThreadLocal, shared);
  memory->setAlignment(alignment);
  overlays = llvm::ConstantExpr::getAddrSpaceCast(memory, builder.getPtrTy());
}

/// Emits the address of the overlay of the current thread block.
llvm::Value *ProgramBuilder::getOverlay() {
  if (isCuda)
    return overlays;
  llvm::Value *block = builder.CreateCall(
      module.getOrInsertFunction(
          "tai_dev_block_id",
          llvm::FunctionType::get(builder.getInt32Ty(), false)),
      {});
  // The emulated device has an overlay for each block, even for blocks without
  // a tile.
  return builder.CreateGEP(
      builder.getInt8Ty(), overlays,
      builder.CreateMul(builder.CreateZExt(block, builder.getInt64Ty()),
                        builder.getInt64(overlayBytes)));
}

/// Emits one half of a tile chain: its loads, or its stages and stores, which
/// run after all blocks have loaded.
void ProgramBuilder::addHalf(const runtime::ProgramLoopStep &step,
                             bool isSecond) {
  SmallVector<llvm::Value *> slots;
  for (const runtime::ProgramSlot &slot : step.slots)
    slots.push_back(getParameter(slot));
  TileBuilder tiles(builder, *getChain(step), bodies, getOverlay(),
                    plan.threads, isCuda);
  if (!isSecond)
    return tiles.emitLoads(slots);
  tiles.emitStages(slots);
  tiles.emitStores(slots);
}

/// In a tile chain, a block computes its tile when it has loaded the overlay,
/// and stores the tile when all blocks have loaded theirs.
void ProgramBuilder::addChain(const runtime::ProgramLoopStep &step) {
  const runtime::TileChain &chain = *getChain(step);
  SmallVector<llvm::Value *> slots;
  for (const runtime::ProgramSlot &slot : step.slots)
    slots.push_back(getParameter(slot));
  TileBuilder tiles(builder, chain, bodies, overlays, plan.threads, isCuda);
  // The block waits for all its threads, because some may still be using the
  // previous contents of the overlay.
  builder.CreateCall(getLibrary("tai_dev_block_barrier", {}), {});
  tiles.emitLoads(slots);
  llvm::Type *i32 = builder.getInt32Ty(), *pointer = builder.getPtrTy();
  llvm::Value *header = kernel->getArg(Header), *before = nullptr;
  if (chain.mustWait)
    before =
        builder.CreateCall(module.getOrInsertFunction(
                               "tai_dev_program_arrive",
                               llvm::FunctionType::get(i32, {pointer}, false)),
                           {header});
  else if (llvm::any_of(chain.rows, [](const runtime::TileRow &row) {
             return row.isLoaded;
           }))
    builder.CreateCall(getLibrary("tai_dev_block_barrier", {}), {});
  tiles.emitStages(slots);
  if (before)
    builder.CreateCall(getLibrary("tai_dev_program_await", {pointer, i32}),
                       {header, before});
  tiles.emitStores(slots);
}

void ProgramBuilder::addStep(const runtime::ProgramLoopStep &step) {
  if (getChain(step))
    return addChain(step);
  llvm::Type *i64 = builder.getInt64Ty();
  llvm::Function *body =
      step.part < TAI_FIRST_PART ? nullptr : bodies[step.part - TAI_FIRST_PART];
  if (body && isCuda) {
    SmallVector<llvm::Value *> arguments;
    for (auto [slot, parameter] : llvm::zip_first(step.slots, body->args()))
      arguments.push_back(convertSlot(builder, getParameter(slot),
                                      parameter.getType(), isCuda));
    builder.CreateCall(body, arguments);
    return;
  }
  for (auto [i, slot] : llvm::enumerate(step.slots))
    builder.CreateStore(getParameter(slot),
                        builder.CreateConstInBoundsGEP1_64(i64, room, i));
  if (body)
    builder.CreateCall(body, {room});
  else
    builder.CreateCall(
        getLibrary("tai_dev_program_part", {i64, builder.getPtrTy()}),
        {builder.getInt64(step.part), room});
}

llvm::Value *ProgramBuilder::getParameter(const runtime::ProgramSlot &slot) {
  if (slot.kind == runtime::ProgramSlot::Listed) {
    llvm::Type *i64 = builder.getInt64Ty();
    llvm::LoadInst *load = builder.CreateLoad(
        i64, builder.CreateConstInBoundsGEP1_64(i64, listRow, slot.word));
    load->setMetadata(llvm::LLVMContext::MD_invariant_load,
                      llvm::MDNode::get(module.getContext(), {}));
    return load;
  }
  llvm::Value *value = kernel->getArg(FirstWord + slot.word);
  if (slot.kind == runtime::ProgramSlot::Fixed)
    return value;
  return builder.CreateAdd(
      value,
      builder.CreateMul(turn, kernel->getArg(FirstWord + slot.word + 1)));
}

void ProgramBuilder::wait() {
  builder.CreateCall(
      getLibrary(getBarrierName(plan.scope), {builder.getPtrTy()}),
      {kernel->getArg(Header)});
}

void ProgramBuilder::noteClock(llvm::Value *steps) {
  if (plan.isTimed)
    builder.CreateCall(getLibrary("tai_dev_program_clock",
                                  {builder.getPtrTy(), builder.getInt64Ty()}),
                       {kernel->getArg(Header), steps});
}

/// Removes the device functions that run a single iteration of a loop, which
/// tile chains have copied into functions of their own.
static void removeTileFunctions(llvm::Module &module) {
  llvm::Function *site = module.getFunction(runtime::tileSiteFunction);
  while (site && !site->use_empty()) {
    llvm::Function *user =
        cast<llvm::Instruction>(*site->user_begin())->getFunction();
    user->replaceAllUsesWith(llvm::PoisonValue::get(user->getType()));
    user->eraseFromParent();
  }
  if (site)
    site->eraseFromParent();
}

Expected<runtime::DeviceImage>
mlir::tai::makeProgram(DeviceCompiler &compiler,
                       const runtime::ProgramPlan &plan) {
  if (plan.scope == TAI_SCOPE_NONE)
    return makeLibrary(compiler, plan.parts);
  if (plan.scope == TAI_SCOPE_LAUNCHES)
    return makeOverlapped(compiler, plan.parts);
  bool isCuda = compiler.isCuda();
  DeviceCode code = compiler.createCode("program");
  code.functions.push_back(programName.str());
  llvm::Module &module = *code.module;
  SmallVector<llvm::Function *> bodies;
  for (auto [i, part] : llvm::enumerate(plan.parts)) {
    if (!part.bitcode) {
      bodies.push_back(nullptr);
      continue;
    }
    std::string name = part.function;
    if (!isCuda && !part.isTile)
      name += kSlotsSuffix;
    auto body = addPart(module, *part.bitcode, name, i);
    if (!body)
      return body.takeError();
    if ((*body)->arg_size() + 1 > TAI_PROGRAM_STRIDE)
      return createStringError("'%s' has more parameters than a step can have",
                               part.function.c_str());
    bodies.push_back(*body);
  }
  if (unsigned size = module.getInstructionCount(); size > kMostInstructions)
    return createStringError(
        "its kernels have %u instructions, and a program of more than %u is "
        "compiled for too long",
        size, kMostInstructions);
  addDispatch(module, plan.parts, bodies, isCuda);
  llvm::Function *kernel = ProgramBuilder(module, plan, bodies, isCuda).build();
  removeTileFunctions(module);

  llvm::GlobalValue *visible = isCuda ? kernel : addSlotsFunction(*kernel);
  auto isVisible = [&](const llvm::GlobalValue &value) {
    return &value == visible;
  };
  return compiler.finish(code, isVisible, [&] {
    for (llvm::Function &function : module)
      if (&function != kernel)
        dropInvariantLoads(function);
    // The device library's function that runs the step table is inlined if it
    // is called once; so are the functions for barriers and for part
    // parameters, whose arguments are then constants.
    if (llvm::Function *runner = module.getFunction(getRunnerName(plan.scope)))
      if (runner->hasOneUse())
        runner->addFnAttr(llvm::Attribute::AlwaysInline);
    for (StringRef name :
         {getBarrierName(plan.scope), StringRef("tai_dev_program_part")})
      if (llvm::Function *function = module.getFunction(name))
        function->addFnAttr(llvm::Attribute::AlwaysInline);
  });
}
