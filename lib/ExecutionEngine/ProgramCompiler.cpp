//===- ProgramCompiler.cpp - Many kernels made one ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Puts the bodies of kernels into one module, with the kernel of the device
// library that goes through a table of steps, and a function that calls the
// body of a step.
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/DeviceCompiler.h"
#include "tai/Runtime/DeviceAbi.h"
#include "llvm/Bitcode/BitcodeReader.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/Linker/Linker.h"
#include "llvm/Target/TargetMachine.h"

using namespace mlir;
using namespace mlir::tai;
using llvm::createStringError;
using llvm::Error;
using llvm::Expected;

static constexpr llvm::StringLiteral programName = "tai_program";

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

/// Adds the bitcode of a part to a module, and yields its function there: one
/// that is called and has a name of its own.
static Expected<llvm::Function *> addPart(llvm::Module &module, StringRef bytes,
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
    if (!value.isDeclaration() && &value != body)
      value.setLinkage(llvm::GlobalValue::InternalLinkage);
  if (llvm::Linker::linkModules(module, std::move(*part)))
    return createStringError("the code of kernels does not link");
  body = module.getFunction(unique);
  body->setLinkage(llvm::GlobalValue::InternalLinkage);
  body->setCallingConv(llvm::CallingConv::C);
  body->removeFnAttr(llvm::Attribute::NoInline);
  body->removeFnAttr("nvvm.maxntid");
  body->addFnAttr(llvm::Attribute::AlwaysInline);
  return body;
}

/// What one step reads may have been written by another: no load goes past the
/// caches of writes.
static void forgetInvariance(llvm::Module &module) {
  for (llvm::Function &function : module)
    for (llvm::Instruction &instruction : llvm::instructions(function))
      instruction.setMetadata(llvm::LLVMContext::MD_invariant_load, nullptr);
}

/// Calls a part with the parameters in its slots.
static void callPart(llvm::IRBuilder<> &builder, llvm::Function *body,
                     llvm::Value *slots, bool isCuda) {
  // That of the emulated device takes the slots themselves.
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
      // Parameters of kernels point to device memory; so do these.
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

/// Makes the function that calls the part with a number.
static void addDispatch(llvm::Module &module, ArrayRef<llvm::Function *> bodies,
                        bool isCuda) {
  llvm::LLVMContext &context = module.getContext();
  llvm::IRBuilder<> builder(context);
  auto *type = llvm::FunctionType::get(
      builder.getVoidTy(), {builder.getInt64Ty(), builder.getPtrTy()}, false);
  // The library calls it; afterwards it is hidden like the rest.
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
    auto *block = llvm::BasicBlock::Create(context, "", dispatch);
    choice->addCase(builder.getInt64(TAI_FIRST_PART + i), block);
    builder.SetInsertPoint(block);
    callPart(builder, body, dispatch->getArg(1), isCuda);
    builder.CreateBr(exit);
  }
}

/// Makes the kernel itself.
static llvm::Function *addKernel(llvm::Module &module, int scope,
                                 unsigned threads, bool isCuda) {
  llvm::LLVMContext &context = module.getContext();
  llvm::IRBuilder<> builder(context);
  llvm::Type *pointer = builder.getPtrTy(), *i64 = builder.getInt64Ty();
  auto *type = llvm::FunctionType::get(builder.getVoidTy(),
                                       {pointer, i64, i64, pointer}, false);
  llvm::FunctionCallee runner =
      module.getOrInsertFunction(getRunnerName(scope), type);
  auto *kernel = llvm::Function::Create(
      type, llvm::GlobalValue::ExternalLinkage, programName, module);
  builder.SetInsertPoint(llvm::BasicBlock::Create(context, "", kernel));
  SmallVector<llvm::Value *> arguments;
  for (llvm::Argument &argument : kernel->args())
    arguments.push_back(&argument);
  builder.CreateCall(runner, arguments);
  builder.CreateRetVoid();
  if (isCuda) {
    kernel->setCallingConv(llvm::CallingConv::PTX_Kernel);
    kernel->addFnAttr("nvvm.maxntid", std::to_string(threads));
  }
  return kernel;
}

/// Makes a kernel that does what a function of the device library does.
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

Expected<runtime::DeviceImage>
DeviceCompiler::makeLibrary(ArrayRef<runtime::ProgramPart> parts) {
  DeviceCode code;
  code.context = std::make_unique<llvm::LLVMContext>();
  code.module = std::make_unique<llvm::Module>("library", *code.context);
  llvm::Module &module = *code.module;
  setTarget(module);
  llvm::ArrayRef<char> bytes = getDeviceLibrary(target.kind);
  auto library = llvm::getLazyBitcodeModule(
      llvm::MemoryBufferRef(StringRef(bytes.data(), bytes.size()), "library"),
      *code.context);
  if (!library)
    return library.takeError();
  llvm::DenseSet<llvm::GlobalValue *> visible;
  for (const runtime::ProgramPart &part : parts) {
    auto kernel = addLibraryKernel(module, **library, part.function, isCuda());
    if (!kernel)
      return kernel.takeError();
    code.functions.push_back((*kernel)->getName().str());
    visible.insert(isCuda() ? *kernel : addSlotsFunction(**kernel));
  }
  if (Error error = link(module))
    return error;
  for (llvm::GlobalValue &value : module.global_values())
    if (!value.isDeclaration() && !visible.contains(&value))
      value.setLinkage(llvm::GlobalValue::InternalLinkage);
  if (isCuda())
    prepareForCuda(module);
  if (Error error = optimize(code))
    return error;
  return emit(code);
}

Expected<runtime::DeviceImage>
DeviceCompiler::makeProgram(ArrayRef<runtime::ProgramPart> parts, int scope,
                            unsigned threads) {
  if (scope == TAI_SCOPE_NONE)
    return makeLibrary(parts);
  DeviceCode code;
  code.context = std::make_unique<llvm::LLVMContext>();
  code.module = std::make_unique<llvm::Module>("program", *code.context);
  code.functions.push_back(programName.str());
  llvm::Module &module = *code.module;
  setTarget(module);
  SmallVector<llvm::Function *> bodies;
  for (auto [i, part] : llvm::enumerate(parts)) {
    std::string name = part.function;
    if (!isCuda())
      name += kSlotsSuffix;
    auto body = addPart(module, *part.bitcode, name, i);
    if (!body)
      return body.takeError();
    if ((*body)->arg_size() + 1 > TAI_PROGRAM_STRIDE)
      return createStringError("'%s' has more parameters than a step can have",
                               part.function.c_str());
    bodies.push_back(*body);
  }
  addDispatch(module, bodies, isCuda());
  llvm::Function *kernel = addKernel(module, scope, threads, isCuda());
  llvm::GlobalValue *visible = isCuda() ? kernel : addSlotsFunction(*kernel);
  if (Error error = link(module))
    return error;
  forgetInvariance(module);
  for (llvm::GlobalValue &value : module.global_values())
    if (!value.isDeclaration() && &value != visible)
      value.setLinkage(llvm::GlobalValue::InternalLinkage);
  if (llvm::Function *runner = module.getFunction(getRunnerName(scope)))
    runner->addFnAttr(llvm::Attribute::AlwaysInline);
  if (isCuda())
    prepareForCuda(module);
  if (Error error = optimize(code))
    return error;
  return emit(code);
}
