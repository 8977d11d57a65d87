//===- LocalArrays.h - Arrays local to a kernel -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_LAYOUTTORT_LOCALARRAYS_H
#define TAI_LIB_CONVERSION_LAYOUTTORT_LOCALARRAYS_H

#include "mlir/Interfaces/FunctionInterfaces.h"

namespace mlir::tai {

/// Lowers the memrefs that a kernel allocates, such as the history of a loop in
/// an adjoint, with all accesses to them: `memref.alloc` to `malloc`,
/// `memref.alloca` to the stack of the kernel, or, on the host, to that of the
/// function of a parallel loop.
LogicalResult lowerLocalArrays(FunctionOpInterface function, bool onDevice);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_LAYOUTTORT_LOCALARRAYS_H
