//===- ZeroAdjoints.h - Zero-adjoint skipping -------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_EXECUTIONENGINE_ZEROADJOINTS_H
#define TAI_LIB_EXECUTIONENGINE_ZEROADJOINTS_H

#include "tai/ExecutionEngine/ToBeRecorded.h"

namespace mlir::tai {

/// What the loops of an adjoint over sparse fields do where adjoints are zero;
/// see docs/decisions/0007-adjoint-flags.md.
std::vector<LoopFlags> findLoopFlags(KernelOp primal, KernelOp adjoint);

} // namespace mlir::tai

#endif // TAI_LIB_EXECUTIONENGINE_ZEROADJOINTS_H
