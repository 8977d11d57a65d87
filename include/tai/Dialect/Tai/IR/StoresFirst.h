//===- StoresFirst.h - Adjoints that a kernel may store first ---*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The attribute with which `tai-store-first` tells the runtime which adjoint
// fields a kernel can store without reading them before: a list of names, in
// the order of the bits of TaiFrame::zeroAdjoints. A kernel without the
// attribute is always launched with adjoints in memory, so that passes are free
// to drop it.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_STORESFIRST_H
#define TAI_DIALECT_TAI_IR_STORESFIRST_H

#include "mlir/IR/BuiltinAttributes.h"
#include <string>
#include <vector>

namespace mlir::tai {

constexpr llvm::StringLiteral kStoresFirst = "tai.stores_first";
/// The number of bits of TaiFrame::zeroAdjoints.
constexpr size_t kMostStoresFirst = 64;

/// Copies the list of a kernel to the function that it becomes, whose attribute
/// `passthrough` holds it.
void setStoresFirst(Operation *function, ArrayAttr fields);
/// Returns the list of such a function; empty if it has none.
std::vector<std::string> getStoresFirst(Operation *function);

} // namespace mlir::tai

#endif // TAI_DIALECT_TAI_IR_STORESFIRST_H
