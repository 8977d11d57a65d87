//===- Writers.h - Which iteration's store remains --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Iterations of a parallel loop that may store to the same element. A
// derivative belongs to the iteration whose value remains, so a kernel that is
// differentiated must decide which value remains: the value of the last
// iteration, in the order of iterations. See
// docs/decisions/0052-colliding-stores.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_PREPARE_WRITERS_H
#define TAI_AD_PREPARE_WRITERS_H

#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Interfaces/Differentiable.h"

namespace mlir::tai {

/// Decides for an access to memory whether derivatives pass through it.
using StoreFilter = llvm::function_ref<bool(DifferentiableAccessInterface)>;

/// True if iterations of a parallel loop of the function may store to the same
/// element, one of the stores passes `matters`, and nothing decides yet which
/// value remains. With `isReversed`, also true for a loop with an access that
/// passes `matters` where, if the loop is long enough, an iteration reads an
/// element that another iteration writes.
bool hasOpenStores(FunctionOpInterface function, StoreFilter matters,
                   bool isReversed);

/// If several iterations store to one element, lets only the last of them
/// store. Where the last one cannot be found before the loop, runs the loop on
/// one thread. With `isReversed`, the loop must have an adjoint that runs
/// backwards; emits an error and fails where it has none.
LogicalResult chooseWriters(FunctionOpInterface function, StoreFilter matters,
                            bool isReversed);

} // namespace mlir::tai

#endif // TAI_AD_PREPARE_WRITERS_H
