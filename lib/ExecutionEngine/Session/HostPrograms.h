//===- HostPrograms.h - Modules of host functions ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_EXECUTIONENGINE_SESSION_HOSTPROGRAMS_H
#define TAI_LIB_EXECUTIONENGINE_SESSION_HOSTPROGRAMS_H

#include "mlir/IR/BuiltinOps.h"
#include "mlir/IR/OwningOpRef.h"

namespace mlir::tai {

/// Returns a copy of the module for the host program `entry`, in which kernels
/// are reduced to signatures, because the host calls them through the runtime.
OwningOpRef<ModuleOp> makeHostModule(ModuleOp module, StringRef entry);

/// True if a host function names a field in an op other than a launch or a
/// tape.
bool usesFields(ModuleOp module);

} // namespace mlir::tai

#endif // TAI_LIB_EXECUTIONENGINE_SESSION_HOSTPROGRAMS_H
