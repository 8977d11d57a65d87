//===- StridedOrder.h - Loops whose accesses keep order ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_LAYOUTTORT_STRIDEDORDER_H
#define TAI_LIB_CONVERSION_LAYOUTTORT_STRIDEDORDER_H

#include "tai/Transforms/Utils/FieldAddress.h"

namespace mlir::tai {

/// The attribute of a parallel loop whose iterations are independent, but which
/// must not be annotated as parallel for LLVM.
constexpr llvm::StringLiteral kKeepsOrderAttrName = "tai.keeps_order";

/// True if an iteration of the loop stores to an element and then accesses an
/// element that may be the same, if LLVM could combine accesses of several
/// iterations into strided (interleaved) groups. In a loop annotated as
/// parallel, LLVM's vectoriser looks for no dependences at all, not even within
/// an iteration, and moves such groups past one another. `fields` must contain
/// all fields of the loop.
bool needsOrderWithin(ParallelForOp loop, FieldTable &fields);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_LAYOUTTORT_STRIDEDORDER_H
