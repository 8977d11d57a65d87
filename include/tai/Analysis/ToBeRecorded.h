//===- ToBeRecorded.h - To-be-recorded (TBR) analysis -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The primal values that an adjoint reads: a tape records these values before
// they are overwritten, long before the adjoint has been compiled. So the
// analysis runs as soon as a kernel has been differentiated, and its result is
// cached with the code.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_TOBERECORDED_H
#define TAI_ANALYSIS_TOBERECORDED_H

#include "tai/Analysis/KernelAccesses.h"
#include "tai/Analysis/ZeroAdjoints.h"

namespace mlir::tai {

/// The memory that an adjoint reads and changes.
struct ToBeRecorded {
  /// The fields that the adjoint of the kernel reads, adjoint fields included.
  std::vector<NamedAccess> reads;
  /// True if there is a variant of the adjoint that loads outputs stored by the
  /// kernel, and the reads that this variant makes in addition to `reads`.
  bool loadsStored = false;
  std::vector<NamedAccess> stored;
  /// Fields whose contents before the launch of the kernel the adjoint reads.
  std::vector<std::string> before;
  /// Fields for which the adjoint reads which cells of the levels above them
  /// are active.
  std::vector<std::string> activity;
  std::vector<LoopFlags> flags;
  /// Array arguments whose elements the adjoint reads, by the numbers of the
  /// argument slots that hold their pointers.
  std::vector<int64_t> arrays;
  /// True if the adjoint executes stores of the kernel again, which changes
  /// fields that the adjoint reads.
  bool reexecutes = false;
  /// If not empty, the text of the module with the parts that the kernel was
  /// split into.
  std::string parts;

  std::string serialize() const;
  /// Restores a ToBeRecorded from `bytes`; no value if they are not a
  /// serialized ToBeRecorded.
  static std::optional<ToBeRecorded> deserialize(StringRef bytes);
};

/// Analyses the kernel called `name`, in a module that has been differentiated.
ToBeRecorded findToBeRecorded(ModuleOp module, StringRef name);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_TOBERECORDED_H
