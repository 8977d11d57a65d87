//===- Canonicalization.h - Patterns that must not run ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_UTILS_CANONICALIZATION_H
#define TAI_TRANSFORMS_UTILS_CANONICALIZATION_H

#include "llvm/ADT/ArrayRef.h"
#include <string>

namespace mlir::tai {

/// Canonicalisation patterns of MLIR 22 that crash on valid modules, by their
/// debug names.
///
/// The pattern of the gpu dialect for the size of a `gpu.alloc` looks at any
/// `memref.dim` and reads the shape at a negative dimension, which is only
/// undefined where it is executed. No pass here makes a `gpu.alloc`.
inline llvm::ArrayRef<std::string> getBrokenPatterns() {
  // The name of the pattern's type as Clang and as GCC write it.
  static const std::string names[] = {
      "(anonymous namespace)::SimplifyDimOfAllocOp",
      "{anonymous}::SimplifyDimOfAllocOp"};
  return names;
}

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_CANONICALIZATION_H
