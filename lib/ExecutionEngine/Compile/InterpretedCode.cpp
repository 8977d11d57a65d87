//===- InterpretedCode.cpp - Interpreted functions ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The runtime launches function pointers. Each interpreted function gets a stub
// that passes the frame and its interpreter to a common function.
//
//===----------------------------------------------------------------------===//

#include "InterpretedCode.h"
#include "tai/Conversion/Passes.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Interpreter/Interpreter.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"

using namespace mlir;
using namespace mlir::tai;

static int32_t runInterpreter(const Interpreter *interpreter, TaiFrame *frame) {
  return interpreter->run(frame);
}

void mlir::tai::buildInterpreterEntry(llvm::Module &module, StringRef symbol,
                                      const Interpreter *interpreter) {
  llvm::LLVMContext &context = module.getContext();
  auto *i32 = llvm::Type::getInt32Ty(context);
  auto *pointer = llvm::PointerType::getUnqual(context);
  auto *entry = llvm::Function::Create(
      llvm::FunctionType::get(i32, {pointer}, /*isVarArg=*/false),
      llvm::Function::ExternalLinkage, symbol, module);
  llvm::IRBuilder<> builder(llvm::BasicBlock::Create(context, "", entry));
  auto address = [&](const void *value) {
    return builder.CreateIntToPtr(
        builder.getInt64(reinterpret_cast<uintptr_t>(value)), pointer);
  };
  builder.CreateRet(builder.CreateCall(
      llvm::FunctionType::get(i32, {pointer, pointer}, /*isVarArg=*/false),
      address(reinterpret_cast<const void *>(&runInterpreter)),
      {address(interpreter), entry->getArg(0)}));
}

std::shared_ptr<const Interpreter>
mlir::tai::makeInterpreter(OwningOpRef<ModuleOp> module, StringRef symbol,
                           const CompileOptions &options, Failure &failure) {
  StringRef name;
  for (Operation &op : *module->getBody())
    if (auto candidate = dyn_cast<FunctionOpInterface>(op);
        candidate && getEntryPointName(candidate.getName()) == symbol)
      name = candidate.getName();
  DiagnosticCollector collector(module->getContext());
  std::shared_ptr<const Interpreter> interpreter = Interpreter::create(
      std::move(module), name, {options.debug, options.orderSeed});
  if (!interpreter)
    failure = collector.take(FailureKind::Type, "the kernel is not valid");
  return interpreter;
}
