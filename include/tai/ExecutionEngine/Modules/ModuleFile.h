//===- ModuleFile.h - Reading and writing modules ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The only entry for modules from outside of the library: as text, or as
// bytecode preceded by a checksum. MLIR's reader trusts bytecode, and some
// damaged files end the process.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_MODULES_MODULEFILE_H
#define TAI_EXECUTIONENGINE_MODULES_MODULEFILE_H

#include "mlir/IR/AsmState.h"
#include "mlir/IR/BuiltinOps.h"
#include "mlir/IR/OwningOpRef.h"

namespace mlir::tai {

/// Reads a module from text, or from the output of `writeModule`. Emits an
/// error at `file` and returns null for bytecode that is damaged or has no
/// checksum.
OwningOpRef<ModuleOp> readModule(StringRef bytes, const ParserConfig &config,
                                 StringRef file);

/// Whether the parser can read the text of a module, an attribute or a type.
/// Emits an error otherwise.
bool checkText(StringRef text, MLIRContext *context, StringRef file);

/// Writes a module as a checksum followed by bytecode.
LogicalResult writeModule(ModuleOp module, llvm::raw_ostream &stream);

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_MODULES_MODULEFILE_H
