//===- CountWrites.h - Count activity tests of writes -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_LAYOUTTORT_COUNTWRITES_H
#define TAI_LIB_CONVERSION_LAYOUTTORT_COUNTWRITES_H

namespace mlir {
class Operation;
namespace tai {

/// Updates the skip counters of writes to sparse fields below `root`: of writes
/// to cells known to be active, and of writes that test or activate their cell.
void countWrites(Operation *root);

} // namespace tai
} // namespace mlir

#endif // TAI_LIB_CONVERSION_LAYOUTTORT_COUNTWRITES_H
