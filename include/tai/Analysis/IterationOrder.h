//===- IterationOrder.h - Do iterations depend on order ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Whether different iterations of a loop access the same memory. Iterations of
// a parallel loop have no order, so that most passes need not ask. A loop on
// one thread has an order, which the loop must keep if its iterations access
// the same memory. See docs/decisions/0051-one-thread-in-order.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_ITERATIONORDER_H
#define TAI_ANALYSIS_ITERATIONORDER_H

#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// On a loop: no array argument that it writes overlaps with another one. A
/// dropped attribute costs time only.
constexpr llvm::StringLiteral kApartAttrName = "tai.apart";

/// The position of an access in its storage: the indices of the element, and
/// the indices of the component if the access reaches only one component.
struct ElementPlace {
  ValueRange indices, components;
};

/// False if accesses at the two places reach different elements in any two
/// different iterations of `loop`. Conservative: true unless proven otherwise.
/// Indices are assumed to be in range; an index that wraps around is not
/// considered.
bool mayMeet(ParallelForOp loop, ElementPlace first, ElementPlace second);

/// True unless it is proven that the order of the iterations changes neither
/// the contents of memory nor the values that iterations read, apart from the
/// order in which sums and other updates that commute are combined.
bool dependsOnOrder(ParallelForOp loop);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_ITERATIONORDER_H
