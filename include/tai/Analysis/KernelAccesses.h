//===- KernelAccesses.h - Access summaries of kernels -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The fields that a kernel reads, writes and accumulates, by name; and the
// elements, if the arguments of a launch alone decide them.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_KERNELACCESSES_H
#define TAI_ANALYSIS_KERNELACCESSES_H

#include "tai/ABI/LaunchAccesses.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include <optional>
#include <string>

namespace mlir::tai {

/// The number of argument slots that values of `types` occupy; see Abi.h.
int64_t countSlots(TypeRange types);

/// One access of a kernel's summary: a field by name, and how it is accessed.
struct NamedAccess {
  std::string field;
  runtime::AccessKind kind;
  /// See runtime::Access.
  std::vector<runtime::FixedIndex> fixed;

  bool operator==(const NamedAccess &other) const {
    return field == other.field && kind == other.kind && fixed == other.fixed;
  }
};

/// The accesses of the ops under `root` to fields, with fixed indices in terms
/// of the kernel's arguments.
std::vector<NamedAccess> listAccesses(Operation *root);

/// For each of `accesses`, all accesses of the kernel and of its callees: the
/// boxes of elements that a launch stores, whatever fields hold. Empty for an
/// access that is not a write, and where the stored elements depend on the
/// contents of fields or do not form boxes.
std::vector<std::vector<runtime::StoredBox>>
findStoredBoxes(ModuleOp module, KernelOp kernel,
                ArrayRef<NamedAccess> accesses);

/// The boxes of elements that a launch stores in an array argument of the
/// kernel.
std::vector<runtime::StoredBox> findStoredBoxes(KernelOp kernel,
                                                BlockArgument array);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_KERNELACCESSES_H
