//===- KernelTables.h - Fields and trees that a launch uses -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The trees and fields of a kernel, looked up once for all of its launches.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_KERNELTABLES_H
#define TAI_RUNTIME_LAUNCH_KERNELTABLES_H

#include "tai/Runtime/Storage/Field.h"
#include <vector>

namespace mlir::tai::runtime {

struct KernelTables {
  /// The addresses of the kernel's trees.
  std::vector<void *> bases;
  /// If the kernel only loops over active cells: the sparse levels of its
  /// loops. Otherwise empty.
  std::vector<const SparseNode *> loopLevels;
  /// True if the kernel accesses an adjoint field, for which zeros may have to
  /// be stored first.
  bool usesAdjoints = false;
  /// The adjoint fields that a launch of this kernel may change.
  std::vector<Field *> changedAdjoints;
  /// Fields to whose adjoints the adjoint kernel adds: the fields that this
  /// kernel reads.
  std::vector<Field *> adjointTargets;
  /// Fields whose adjoints the adjoint kernel reads: the fields that this
  /// kernel changes.
  std::vector<Field *> adjointSources;
  /// The fields that the kernel overwrites rather than adds to; a subset of
  /// `adjointSources`.
  std::vector<Field *> overwritten;
  /// Sparse levels of the kernel's trees.
  std::vector<SparseNode *> sparseNodes;

  /// True if the kernel only loops over active cells of sparse levels, and no
  /// such level has an active cell.
  bool hasNoActiveCells() const {
    for (const SparseNode *level : loopLevels)
      if (level->mayBeActive())
        return false;
    return true;
  }
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_KERNELTABLES_H
