//===- Differentiable.cpp - Interfaces of differentiable ops --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Interfaces/Differentiable.h"
#include "Rules/Models.h"
#include "tai/AD/Forward/TangentBuilder.h"
#include "tai/AD/Reverse/AdjointBuilder.h"

using namespace mlir;
using namespace mlir::tai;

#include "tai/Interfaces/DifferentiableInterfaces.cpp.inc"

void mlir::tai::registerDifferentiableModels(DialectRegistry &registry) {
  registerArithModels(registry);
  registerMathModels(registry);
  registerVectorModels(registry);
  registerMemRefModels(registry);
  registerSCFModels(registry);
  registerTaiModels(registry);
  registerMatrixModels(registry);
  registerDecompositionModels(registry);
}
