//===- Plugins.h - Dialects and passes of others in a session ---*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_SESSION_PLUGINS_H
#define TAI_EXECUTIONENGINE_SESSION_PLUGINS_H

#include "mlir/IR/BuiltinOps.h"

namespace mlir::tai {
class Session;

/// Loads a shared library that is a dialect plugin, a pass plugin or both, as
/// `mlir-opt` does. Fails once the session has kernels, since threads that
/// compile them use the context.
LogicalResult loadPlugin(Session &session, StringRef file);

/// Runs passes on a module: passes of tai, passes of plugins, and the general
/// passes of MLIR (`canonicalize`, `cse`, `inline` and so on). `pipeline` is
/// the text that `--pass-pipeline` takes; without an anchor, the pipeline is
/// anchored on `builtin.module`.
LogicalResult runPasses(Session &session, ModuleOp module, StringRef pipeline);

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_SESSION_PLUGINS_H
