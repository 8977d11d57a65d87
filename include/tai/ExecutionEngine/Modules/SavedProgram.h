//===- SavedProgram.h - A recorded tape as a module -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// docs/decisions/0064-saved-programs.md describes the module.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_MODULES_SAVEDPROGRAM_H
#define TAI_EXECUTIONENGINE_MODULES_SAVEDPROGRAM_H

#include "tai/ExecutionEngine/Session/Session.h"

namespace mlir::tai {

/// The attribute of a saved module: a dictionary of `version`, `loss` and
/// `wrt`.
constexpr llvm::StringLiteral kSaved = "tai.saved";
/// The version of saved modules that is written, and the only one that is read.
constexpr int64_t kSavedVersion = 1;

/// The launches of a tape as a module, with the present contents of the fields
/// that they use: `@run` launches them, and `@gradient` does so under a tape.
/// Fails for a tape that has more than launches.
FailureOr<OwningOpRef<ModuleOp>> saveTape(Session &session,
                                          const runtime::Tape &tape,
                                          const runtime::Field &loss,
                                          ArrayRef<runtime::FieldPtr> wrt);

/// Checks the version of a module that was made by saveTape; succeeds for other
/// modules.
LogicalResult checkSaved(ModuleOp module);

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_MODULES_SAVEDPROGRAM_H
