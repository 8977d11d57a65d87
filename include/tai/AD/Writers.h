//===- Writers.h - Which iteration's store remains --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Iterations of a parallel loop that may store to the same element. A
// derivative belongs to the iteration whose value remains, so that a kernel
// that is differentiated decides which one it is: the last, in the order of
// iterations. See docs/decisions/0052-colliding-stores.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_WRITERS_H
#define TAI_AD_WRITERS_H

#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Interfaces/Differentiable.h"

namespace mlir::tai {

/// Tells whether a derivative passes through an access.
using StoreFilter = llvm::function_ref<bool(DifferentiableAccessInterface)>;

/// True if iterations of a parallel loop of the function may store to the same
/// element, by stores of which one passes `matters`, and nothing decides yet
/// which value remains. With `isReversed`, also if an iteration reads what
/// another one writes as soon as the loop is long enough, in a loop with an
/// access that passes.
bool hasOpenStores(FunctionOpInterface function, StoreFilter matters,
                   bool isReversed);

/// Lets the last of such iterations store, and the others not. Where that
/// cannot be decided before the loop, runs it on one thread. With `isReversed`
/// the loop must have an adjoint that runs backwards; fails after an error
/// where it has none.
LogicalResult chooseWriters(FunctionOpInterface function, StoreFilter matters,
                            bool isReversed);

} // namespace mlir::tai

#endif // TAI_AD_WRITERS_H
