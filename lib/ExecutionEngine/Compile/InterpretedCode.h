//===- InterpretedCode.h - Interpreted functions ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_EXECUTIONENGINE_COMPILE_INTERPRETEDCODE_H
#define TAI_LIB_EXECUTIONENGINE_COMPILE_INTERPRETEDCODE_H

#include "tai/ExecutionEngine/Compile/Compiler.h"
#include "llvm/IR/Module.h"

namespace mlir::tai {

/// Makes an interpreter for the function whose entry point has the symbol;
/// null, with the reason in `failure`, if the interpreter does not support an
/// op.
std::shared_ptr<const Interpreter>
makeInterpreter(OwningOpRef<ModuleOp> module, StringRef symbol,
                const CompileOptions &options, Failure &failure);

/// Adds the function `i32 @symbol(ptr %frame)`, which calls the interpreter
/// with the frame.
void buildInterpreterEntry(llvm::Module &module, StringRef symbol,
                           const Interpreter *interpreter);

} // namespace mlir::tai

#endif // TAI_LIB_EXECUTIONENGINE_COMPILE_INTERPRETEDCODE_H
