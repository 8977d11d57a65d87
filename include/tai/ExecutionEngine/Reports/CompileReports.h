//===- CompileReports.h - Reports of compilations ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The options `print_ir` and `compile_profile`: stages of the IR and times of
// phases, written to the standard error as kernels are compiled.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_REPORTS_COMPILEREPORTS_H
#define TAI_EXECUTIONENGINE_REPORTS_COMPILEREPORTS_H

#include "tai/ExecutionEngine/Compile/Compiler.h"

namespace mlir::tai {

/// Writes the reports of compilations. Thread-safe: reports of several threads
/// are not interleaved.
class CompileReports {
public:
  CompileReports();

  /// See Compiler::getStages.
  void setStages(SmallVector<std::string> names) { stages = std::move(names); }
  void setProfile(bool on) { printsProfile = on; }

  /// Prints the IR of a kernel at each requested stage that the kernel passes
  /// through.
  void printStages(Compiler &compiler, CompileRequest request,
                   const CompileOptions &options);
  /// Prints a line with the origin of a kernel's code (cache or compiler) and
  /// the times of the compile phases.
  void printProfile(StringRef name, CompileRequest::Goal goal,
                    const Compiler::Function &function);

private:
  /// Writes a report by a single call: the standard error is unbuffered, and
  /// output of other threads, such as warnings, could come in between.
  void write(const std::string &text);

  SmallVector<std::string> stages;
  bool printsProfile;
  std::mutex mutex;
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_REPORTS_COMPILEREPORTS_H
