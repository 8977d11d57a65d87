//===- LoopsWithoutOrder.h - Stores of loops without an order ---*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_PREPARE_LOOPSWITHOUTORDER_H
#define TAI_LIB_AD_PREPARE_LOOPSWITHOUTORDER_H

#include "tai/Analysis/Activity.h"

namespace mlir::tai {

/// Refuses stores with a derivative in loops of other dialects, unless it is
/// proven that each iteration has elements of its own.
LogicalResult checkLoopsWithoutOrder(FunctionOpInterface function,
                                     const Activity &activity);

} // namespace mlir::tai

#endif // TAI_LIB_AD_PREPARE_LOOPSWITHOUTORDER_H
