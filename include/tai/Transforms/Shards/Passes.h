//===- Passes.h - Passes on sharded fields ----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_SHARDS_PASSES_H
#define TAI_TRANSFORMS_SHARDS_PASSES_H

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/BuiltinOps.h"
#include "mlir/Pass/Pass.h"
#include "tai/Dialect/Mesh/IR/Mesh.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include <memory>

namespace mlir::tai {

#define GEN_PASS_DECL
#define GEN_PASS_REGISTRATION
#include "tai/Transforms/Shards/Passes.h.inc"

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_SHARDS_PASSES_H
