//===- DetachExits.h - Carried values that do not wait for an exit --------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TOLLVM_DETACHEXITS_H
#define TAI_LIB_CONVERSION_TOLLVM_DETACHEXITS_H

namespace mlir {
class Operation;

namespace tai {
/// Rewrites each `scf.while` in `root` that a carried flag ends: the carried
/// values that decide on the next flag are computed without waiting for it.
void detachExits(Operation *root);
} // namespace tai
} // namespace mlir

#endif // TAI_LIB_CONVERSION_TOLLVM_DETACHEXITS_H
