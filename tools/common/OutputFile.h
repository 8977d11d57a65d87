//===- OutputFile.h - Files that tools write --------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// MLIR's drivers empty the file of `-o` before they read their input. A tool of
// tai writes to a temporary file beside it instead, which takes the name at the
// end: on an error, or on a full disk, the former file remains.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TOOLS_COMMON_OUTPUTFILE_H
#define TAI_TOOLS_COMMON_OUTPUTFILE_H

#include "mlir/Support/LLVM.h"

namespace mlir::tai {

/// Runs `driver` with the arguments of `main`, of which `-o` names a temporary
/// file. Returns the status of the process.
int runWithOutput(int argc, char **argv,
                  llvm::function_ref<LogicalResult(int, char **)> driver);

} // namespace mlir::tai

#endif // TAI_TOOLS_COMMON_OUTPUTFILE_H
