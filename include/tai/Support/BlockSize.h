//===- BlockSize.h - Block sizes of device functions ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A loop may specify its block size, and the order of additions of a loop that
// is distributed over a warp depends on it. So the device function of the loop
// carries the block size as an LLVM function attribute in `passthrough`, which
// is inherent: passes may drop discardable attributes.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_SUPPORT_BLOCKSIZE_H
#define TAI_SUPPORT_BLOCKSIZE_H

#include "mlir/Dialect/LLVMIR/LLVMDialect.h"

namespace mlir::tai {

constexpr llvm::StringLiteral kBlockSizeAttrName = "tai.block_size";

inline void addPassthrough(LLVM::LLVMFuncOp function, Attribute attribute) {
  SmallVector<Attribute> attributes;
  if (ArrayAttr others = function.getPassthroughAttr())
    llvm::append_range(attributes, others);
  attributes.push_back(attribute);
  function.setPassthroughAttr(
      ArrayAttr::get(function.getContext(), attributes));
}

inline void setBlockSize(LLVM::LLVMFuncOp function, int64_t threads) {
  addPassthrough(function, Builder(function.getContext())
                               .getStrArrayAttr({kBlockSizeAttrName,
                                                 std::to_string(threads)}));
}

/// The block size of a device function, from 1 to 1024; none if the function
/// specifies none.
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
