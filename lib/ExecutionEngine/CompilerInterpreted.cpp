//===- CompilerInterpreted.cpp - Functions that are not compiled ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The runtime launches functions. Of the interpreter each is one that hands the
// frame, and which program it belongs to, to the same function.
//
//===----------------------------------------------------------------------===//

#include "CompilerWorker.h"
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

/// define i32 @symbol(ptr %frame) { return runInterpreter(interpreter, %frame)
/// }
static void buildEntry(llvm::Module &module, StringRef symbol,
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

std::optional<Compiler::Function>
Compiler::interpret(Prepared prepared, CompileRequest request,
                    const CompileOptions &options, Failure &failure) {
  Function function;
  function.times = prepared.times;
  function.skipped = prepared.skipped;
  if (!prepared.module && failed(start(request, options, prepared, failure)))
    return std::nullopt;
  if (prepared.symbol.empty())
    return function;
  StringRef name;
  for (Operation &op : *prepared.module->getBody())
    if (auto candidate = dyn_cast<FunctionOpInterface>(op);
        candidate && getEntryPointName(candidate.getName()) == prepared.symbol)
      name = candidate.getName();
  for (TreeOp tree : prepared.module->getOps<TreeOp>())
    function.trees.push_back(tree.getSymName().str());
  {
    DiagnosticCollector collector(context);
    function.interpreter = Interpreter::create(
        std::move(prepared.module), name, {options.debug, options.orderSeed});
    if (!function.interpreter) {
      failure = collector.take(FailureKind::Type, "the kernel is not valid");
      return std::nullopt;
    }
  }

  WorkerLease lease(*this, options);
  std::unique_ptr<ObjectCompiler> &objects = (*lease).objects;
  auto fail = [&](llvm::Error error) -> std::optional<Function> {
    failure = Failure::get(FailureKind::Internal,
                           "code generation failed: " +
                               llvm::toString(std::move(error)));
    return std::nullopt;
  };
  if (!objects) {
    auto made = ObjectCompiler::create(options.codegen);
    if (!made)
      return fail(made.takeError());
    objects = std::move(*made);
  }
  llvm::LLVMContext context;
  llvm::Module module(prepared.symbol, context);
  buildEntry(module, prepared.symbol, function.interpreter.get());
  if (llvm::Error error = objects->optimize(module))
    return fail(std::move(error));
  auto code = objects->emitObject(module);
  if (!code)
    return fail(code.takeError());
  CompiledObject object;
  object.symbol = prepared.symbol;
  object.code = std::move(*code);
  if (failed(link(object, request.name, function, failure)))
    return std::nullopt;
  return function;
}
