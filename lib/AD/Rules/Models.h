//===- Models.h - Derivatives by dialect ------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// One registration function for each dialect: it attaches the interfaces of
// tai/Interfaces/Differentiable.h to the ops of that dialect.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_RULES_MODELS_H
#define TAI_LIB_AD_RULES_MODELS_H

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/AD/Forward/TangentBuilder.h"

namespace mlir {
class DialectRegistry;
} // namespace mlir

namespace mlir::tai {
void registerArithModels(DialectRegistry &registry);
void registerMathModels(DialectRegistry &registry);
void registerVectorModels(DialectRegistry &registry);
void registerMemRefModels(DialectRegistry &registry);
void registerSCFModels(DialectRegistry &registry);
void registerTaiModels(DialectRegistry &registry);
void registerMatrixModels(DialectRegistry &registry);
void registerDecompositionModels(DialectRegistry &registry);

/// True if a region of `scf.reduce` adds its two arguments.
bool isSumReduction(Region &region);

/// Forward mode of structured control flow (SCFTangents.cpp).
LogicalResult extendIf(scf::IfOp op, TangentBuilder &b);
LogicalResult extendFor(scf::ForOp op, TangentBuilder &b);
LogicalResult extendWhile(scf::WhileOp op, TangentBuilder &b);
LogicalResult extendParallel(scf::ParallelOp op, TangentBuilder &b);

/// How an atomic update combines the old value of an element with a new value.
enum class UpdateKind { Product, Greatest, Least };
/// The tangent of an element after an update, given the element and its tangent
/// before, and the value and its tangent. On a tie the derivative goes to the
/// value, as to the second operand of `arith.maximumf`, or half to each under
/// the convention ties = "split".
Value createUpdatedTangent(TangentBuilder &b, UpdateKind kind, Value old,
                           Value oldTangent, Value value);
} // namespace mlir::tai

#endif // TAI_LIB_AD_RULES_MODELS_H
