//===- AccessOrder.h - Order of accesses to a storage -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// All accesses of a function by storage, in program order, and queries about
// two accesses: may one run after the other and reach the same element.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_ACCESSORDER_H
#define TAI_ANALYSIS_ACCESSORDER_H

#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Interfaces/Differentiable.h"
#include "llvm/ADT/MapVector.h"

namespace mlir::tai {

using Accesses = SmallVector<DifferentiableAccessInterface>;

/// The accesses of a function by storage (see getStorageKey), each list in
/// program order.
class AccessTable {
public:
  explicit AccessTable(FunctionOpInterface function);

  const llvm::MapVector<const void *, Accesses> &getStorages() const {
    return storages;
  }

  /// A write that may run after `access` and reach the same element, or null.
  DifferentiableAccessInterface
  findLaterWrite(DifferentiableAccessInterface access) const;
  /// A write that may run before `access` and reach the same element, or null.
  DifferentiableAccessInterface
  findEarlierWrite(DifferentiableAccessInterface access) const;

private:
  llvm::MapVector<const void *, Accesses> storages;
  /// The accesses of the function that write or update memory, by storage.
  llvm::DenseMap<const void *, Accesses> writes;
};

/// True if both accesses reach the same element, or one access reaches a
/// component of the element that the other reaches: in the same iteration of
/// the loops around both, and in corresponding iterations of two loops over the
/// same range.
bool reachSameElement(DifferentiableAccessInterface lhs,
                      DifferentiableAccessInterface rhs);

/// False if `second` cannot run after `first` and reach the same element: in
/// the same iteration of the loops around both, or in a later iteration of a
/// serial loop. Iterations of one parallel loop are assumed not to conflict: a
/// program in which they do has no defined result. Conservative: true unless
/// proven otherwise. With `scope`, a block around both accesses, only the order
/// within one execution of `scope` counts.
bool mayReachLater(DifferentiableAccessInterface first,
                   DifferentiableAccessInterface second,
                   Block *scope = nullptr);

/// True if the op runs iterations one after another.
bool isSerialLoop(Operation *op);

/// The innermost block around both ops; replaces `lhs` and `rhs` by the ops of
/// that block that contain them. Null if the ops are in different functions.
Block *findCommonBlock(Operation *&lhs, Operation *&rhs);

/// True if `second` runs after `first`, in the same iteration of the loops
/// around both, whenever both run; and at least one of them is not under a
/// condition, so that they are not on exclusive branches.
bool runsAfter(Operation *first, Operation *second);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_ACCESSORDER_H
