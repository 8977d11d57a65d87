//===- Addresses.h - Addresses and their constant parts ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_PASSES_ADDRESSES_H
#define TAI_LIB_CODEGEN_PASSES_ADDRESSES_H

#include "llvm/ADT/APInt.h"
#include "llvm/IR/DataLayout.h"
#include "llvm/IR/Value.h"
#include <utility>

namespace mlir::tai {

/// An address without its constant offsets, and the sum of the offsets in
/// bytes.
inline std::pair<llvm::Value *, int64_t>
splitAddress(llvm::Value *pointer, const llvm::DataLayout &layout) {
  llvm::APInt offset(layout.getIndexTypeSizeInBits(pointer->getType()), 0);
  llvm::Value *base = pointer->stripAndAccumulateConstantOffsets(
      layout, offset, /*AllowNonInbounds=*/true);
  return {base, offset.getSExtValue()};
}

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_PASSES_ADDRESSES_H
