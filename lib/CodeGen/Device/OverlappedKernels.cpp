//===- OverlappedKernels.cpp - Programmatic dependent launch --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A kernel that begins with `griddepcontrol.wait` can be prepared, and its
// blocks can become resident, while the previous kernel in the queue is still
// running. It must not load through the read-only cache, because the previous
// kernel writes to memory after this kernel has started.
//
//===----------------------------------------------------------------------===//

#include "ProgramParts.h"
#include "tai/CodeGen/Device/DeviceCompiler.h"
#include "llvm/ADT/DenseSet.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/InlineAsm.h"

using namespace mlir;
using namespace mlir::tai;
using llvm::createStringError;
using llvm::Expected;

/// Makes a kernel that calls `body` once all work queued earlier has ended;
/// work queued later can be prepared from the start.
static llvm::Function *addKernel(llvm::Function &body, size_t number) {
  llvm::Module &module = *body.getParent();
  llvm::LLVMContext &context = module.getContext();
  llvm::IRBuilder<> builder(context);
  auto *kernel = llvm::Function::Create(
      body.getFunctionType(), llvm::GlobalValue::ExternalLinkage,
      "tai_overlapped" + Twine(number), module);
  kernel->setCallingConv(llvm::CallingConv::PTX_Kernel);
  builder.SetInsertPoint(llvm::BasicBlock::Create(context, "", kernel));
  // The instructions are emitted as inline assembly that clobbers memory: LLVM
  // could move loads past its intrinsics for them.
  auto *type = llvm::FunctionType::get(builder.getVoidTy(), false);
  for (StringRef text :
       {"griddepcontrol.launch_dependents;", "griddepcontrol.wait;"})
    builder.CreateCall(type, llvm::InlineAsm::get(type, text, "~{memory}",
                                                  /*hasSideEffects=*/true));
  SmallVector<llvm::Value *> arguments;
  for (llvm::Argument &argument : kernel->args())
    arguments.push_back(&argument);
  builder.CreateCall(&body, arguments);
  builder.CreateRetVoid();
  return kernel;
}

Expected<runtime::DeviceImage>
mlir::tai::makeOverlapped(DeviceCompiler &compiler,
                          ArrayRef<runtime::ProgramPart> parts) {
  if (!compiler.isCuda())
    return createStringError("kernels of this device do not overlap");
  DeviceCode code = compiler.createCode("overlapped");
  llvm::Module &module = *code.module;
  llvm::DenseSet<const llvm::GlobalValue *> visible;
  for (auto [i, part] : llvm::enumerate(parts)) {
    if (!part.bitcode)
      return createStringError("'%s' has no code", part.function.c_str());
    auto body = addPart(module, *part.bitcode, part.function, i);
    if (!body)
      return body.takeError();
    llvm::Function *kernel = addKernel(**body, i);
    code.functions.push_back(kernel->getName().str());
    code.mostThreads.push_back(part.threads ? std::to_string(part.threads)
                                            : std::string());
    visible.insert(kernel);
  }
  auto isVisible = [&](const llvm::GlobalValue &value) {
    return visible.contains(&value);
  };
  return compiler.finish(code, isVisible, [&] {
    for (llvm::Function &function : module)
      dropInvariantLoads(function);
  });
}
