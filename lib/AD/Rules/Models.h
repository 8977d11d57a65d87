//===- Models.h - Derivatives by dialect ------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// One function for each dialect: it attaches the interfaces of Differentiable.h
// to the ops of that dialect.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_RULES_MODELS_H
#define TAI_LIB_AD_RULES_MODELS_H

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
} // namespace mlir::tai

#endif // TAI_LIB_AD_RULES_MODELS_H
