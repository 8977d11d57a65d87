//===- LaunchAccesses.h - What kernels do to memory -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What a kernel reads, writes and accumulates, by the names of fields; which
// elements that are is told from the arguments of a launch where they alone
// decide.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_LAUNCHACCESSES_H
#define TAI_ANALYSIS_LAUNCHACCESSES_H

#include "tai/ABI/LaunchAccesses.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include <optional>
#include <string>

namespace mlir::tai {

/// Slots of values of these types; see Abi.h.
int64_t countSlots(TypeRange types);

/// A line of a summary, by the name of the field.
struct NamedAccess {
  std::string field;
  runtime::AccessKind kind;
  std::optional<runtime::FixedIndex> fixed;

  bool operator==(const NamedAccess &other) const {
    return field == other.field && kind == other.kind && fixed == other.fixed;
  }
};

/// What the ops under `root` do to fields; indices are told from the arguments
/// of kernels.
std::vector<NamedAccess> listAccesses(Operation *root);

/// For each of the accesses, which are those of the kernel and of the functions
/// that it calls: the elements that a launch stores, whatever fields hold. None
/// where that depends on them, is no box, or is no write.
std::vector<std::vector<runtime::StoredBox>>
findStoredBoxes(ModuleOp module, KernelOp kernel,
                ArrayRef<NamedAccess> accesses);

/// The same, of an array among the arguments of the kernel.
std::vector<runtime::StoredBox> findStoredBoxes(KernelOp kernel,
                                                BlockArgument array);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_LAUNCHACCESSES_H
