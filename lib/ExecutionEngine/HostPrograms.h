//===- HostPrograms.h - Modules of host functions ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_EXECUTIONENGINE_HOSTPROGRAMS_H
#define TAI_LIB_EXECUTIONENGINE_HOSTPROGRAMS_H

#include "mlir/IR/BuiltinOps.h"
#include "mlir/IR/OwningOpRef.h"

namespace mlir::tai {

/// What the program `entry` of a module needs: a copy in which kernels are
/// nothing but their signatures, for the host reaches them through the runtime.
OwningOpRef<ModuleOp> makeHostModule(ModuleOp module, StringRef entry);

/// Whether a host function names a field other than for a launch or a tape.
bool usesFields(ModuleOp module);

} // namespace mlir::tai

#endif // TAI_LIB_EXECUTIONENGINE_HOSTPROGRAMS_H
