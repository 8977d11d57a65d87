//===- TapeValues.h - Derivatives that a tape would lose --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef LIB_DIALECT_TAI_IR_TAPEVALUES_H
#define LIB_DIALECT_TAI_IR_TAPEVALUES_H

#include "mlir/IR/SymbolTable.h"

namespace mlir::tai {

/// Rejects, in the region of `tape` and in the host functions that it calls,
/// values with a derivative that pass from one launch to another through the
/// host, and stores of the host between launches: a tape records launches only.
LogicalResult verifyTapeValues(Operation *tape, SymbolTableCollection &symbols);

} // namespace mlir::tai

#endif // LIB_DIALECT_TAI_IR_TAPEVALUES_H
