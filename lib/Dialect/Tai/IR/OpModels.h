//===- OpModels.h - Interfaces attached to ops ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Interfaces of upstream's passes and printer that the ops of the dialect
// implement by external models: no code of tai calls them.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_DIALECT_TAI_IR_OPMODELS_H
#define TAI_LIB_DIALECT_TAI_IR_OPMODELS_H

namespace mlir {
class MLIRContext;
} // namespace mlir

namespace mlir::tai {
class TaiDialect;

/// Locals, for upstream's `mem2reg`, and the memory effects of launches.
void attachMemoryModels(MLIRContext &context);

/// Names of SSA values in printed IR.
void attachAsmNames(MLIRContext &context);

/// Folders of ops that only mark values for differentiation.
void addMarkerFolds(TaiDialect &dialect);

} // namespace mlir::tai

#endif // TAI_LIB_DIALECT_TAI_IR_OPMODELS_H
