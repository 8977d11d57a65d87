//===- Program.h - A whole file in a session --------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The trees, fields, kernels and host functions of one module. The C API and
// tai-run use it.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_MODULES_PROGRAM_H
#define TAI_EXECUTIONENGINE_MODULES_PROGRAM_H

#include "tai/ExecutionEngine/Session/Session.h"
#include "llvm/ADT/StringMap.h"

namespace mlir::tai {

/// A loaded module. Must not outlive its session. Trees and fields belong to
/// the session, and remain when the program is destroyed.
class Program {
public:
  /// Reads a module from text or bytecode (see ModuleFile.h), without verifying
  /// it.
  static OwningOpRef<ModuleOp> read(Session &session, StringRef bytes,
                                    StringRef file);
  /// Verifies the module, fuses launches where the session's options say so,
  /// and declares its trees, fields and kernels. On failure, the session is
  /// left as it was.
  static FailureOr<std::unique_ptr<Program>> load(Session &session,
                                                  OwningOpRef<ModuleOp> file);
  ~Program();
  Program(const Program &) = delete;
  Program &operator=(const Program &) = delete;

  ModuleOp getModule() const { return *file; }
  /// The kernel of the program called `name`, or null.
  SessionKernel *findKernel(StringRef name) const {
    return kernels.lookup(name);
  }
  /// Runs the host function called `name`, a `func.func` that has neither
  /// arguments nor results.
  LogicalResult run(StringRef name);

private:
  Program(Session &session, OwningOpRef<ModuleOp> file)
      : session(session), file(std::move(file)) {}
  LogicalResult declare();
  LogicalResult checkFunction(StringRef name);

  Session &session;
  OwningOpRef<ModuleOp> file;
  llvm::StringMap<SessionKernel *> kernels;
  /// Compiled host functions by name.
  llvm::StringMap<Session::HostFunction> functions;
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_MODULES_PROGRAM_H
