//===- FormerNames.h - Former names of passes -------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_PIPELINES_FORMERNAMES_H
#define TAI_LIB_PIPELINES_FORMERNAMES_H

namespace mlir::tai {

/// Registers the former names of passes. Call after the passes are registered.
void registerFormerNames();

} // namespace mlir::tai

#endif // TAI_LIB_PIPELINES_FORMERNAMES_H
