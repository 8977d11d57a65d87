//===- ToBeRecorded.h - To-be-recorded (TBR) analysis -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Which primal values an adjoint reads: a tape records those before anything
// overwrites them, long before the adjoint has been compiled. So the analysis
// runs as soon as a kernel has been differentiated, and its result is kept
// beside the code.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_TOBERECORDED_H
#define TAI_ANALYSIS_TOBERECORDED_H

#include "tai/Analysis/LaunchAccesses.h"
#include "tai/Analysis/ZeroAdjoints.h"

namespace mlir::tai {

/// What must be in memory when an adjoint runs, and what it changes there.
struct ToBeRecorded {
  /// Fields that the adjoint reads, those of other adjoints among them.
  std::vector<NamedAccess> reads;
  /// There is a form of it that loads what the kernel has stored; and what else
  /// that one reads.
  bool loadsStored = false;
  std::vector<NamedAccess> stored;
  /// Those that it reads as they were before the launch.
  std::vector<std::string> before;
  /// Fields above which it asks for activity.
  std::vector<std::string> activity;
  std::vector<LoopFlags> flags;
  /// Array arguments whose elements it reads, by the slots of their pointers.
  std::vector<int64_t> arrays;
  /// It executes the kernel forward again, which changes these.
  bool reexecutes = false;
  /// If not empty, the module with the parts of the kernel, as text.
  std::string parts;

  std::string serialize() const;
  /// Nothing where the bytes are not those of a result.
  static std::optional<ToBeRecorded> deserialize(StringRef bytes);
};

/// Of the kernel of this name, in a module that has been differentiated.
ToBeRecorded findToBeRecorded(ModuleOp module, StringRef name);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_TOBERECORDED_H
