//===- BlockSize.h - Threads of the blocks of a device function -*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A loop may say how many threads its blocks have, and one whose iterations a
// warp shares adds in an order that depends on it. So its function carries the
// number as a function attribute of LLVM, which is part of the op: passes may
// drop what is discardable.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_SUPPORT_BLOCKSIZE_H
#define TAI_SUPPORT_BLOCKSIZE_H

#include "mlir/Dialect/LLVMIR/LLVMDialect.h"

namespace mlir::tai {

constexpr llvm::StringLiteral kBlockSizeAttrName = "tai.block_size";

inline void setBlockSize(LLVM::LLVMFuncOp function, int64_t threads) {
  Builder builder(function.getContext());
  SmallVector<Attribute> attributes;
  if (ArrayAttr others = function.getPassthroughAttr())
    llvm::append_range(attributes, others);
  attributes.push_back(
      builder.getStrArrayAttr({kBlockSizeAttrName, std::to_string(threads)}));
  function.setPassthroughAttr(builder.getArrayAttr(attributes));
}

/// From 1 to 1024; nothing where any number will do.
inline std::optional<int64_t> getBlockSize(LLVM::LLVMFuncOp function) {
  ArrayAttr attributes = function.getPassthroughAttr();
  if (!attributes)
    return std::nullopt;
  for (Attribute attribute : attributes) {
    auto pair = dyn_cast<ArrayAttr>(attribute);
    if (!pair || pair.size() != 2)
      continue;
    auto name = dyn_cast<StringAttr>(pair[0]);
    auto number = dyn_cast<StringAttr>(pair[1]);
    int64_t threads;
    if (name && number && name.getValue() == kBlockSizeAttrName &&
        !number.getValue().getAsInteger(10, threads))
      return threads;
  }
  return std::nullopt;
}

} // namespace mlir::tai

#endif // TAI_SUPPORT_BLOCKSIZE_H
