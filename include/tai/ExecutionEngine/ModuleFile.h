//===- ModuleFile.h - Modules that come from outside ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The one way in which the library takes a module that somebody else has
// written: as text, or as bytecode behind its checksum. MLIR's reader trusts
// bytecode, and some damaged files end the process.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_MODULEFILE_H
#define TAI_EXECUTIONENGINE_MODULEFILE_H

#include "mlir/IR/AsmState.h"
#include "mlir/IR/BuiltinOps.h"
#include "mlir/IR/OwningOpRef.h"

namespace mlir::tai {

/// Reads text, or what `writeModule` has written. Emits an error at `file` and
/// returns null for bytecode that is damaged or has no checksum.
OwningOpRef<ModuleOp> readModule(StringRef bytes, const ParserConfig &config,
                                 StringRef file);

/// Writes the module as bytecode behind its checksum.
LogicalResult writeModule(ModuleOp module, llvm::raw_ostream &stream);

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_MODULEFILE_H
