//===- CompileReports.cpp - Reports of compilations -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Reports/CompileReports.h"
#include "llvm/Support/FormatVariadic.h"
#include "llvm/Support/Process.h"

using namespace mlir;
using namespace mlir::tai;

CompileReports::CompileReports()
    : printsProfile(
          llvm::sys::Process::GetEnv("TAI_COMPILE_PROFILE").has_value()) {}

void CompileReports::write(const std::string &text) {
  std::lock_guard<std::mutex> lock(mutex);
  llvm::errs() << text;
}

void CompileReports::printStages(Compiler &compiler, CompileRequest request,
                                 const CompileOptions &options) {
  bool isAdjoint = request.goal != CompileRequest::Goal::Primal;
  for (const std::string &stage : stages) {
    if ((isAdjoint || request.forward) && stage == "tai")
      continue;
    // The stage "autodiff" is left out for primals, which are not
    // differentiated.
    if (!isAdjoint && !request.forward && stage == "autodiff")
      continue;
    if (!options.device && Compiler::isDeviceStage(stage))
      continue;
    Failure failure;
    std::optional<std::string> text =
        compiler.print(request, stage, options, failure);
    write((Twine("// -----// ") + stage + " of " +
           (request.forward ? "the tangent of " : "") +
           (isAdjoint ? "the adjoint of " : "") + request.name +
           " //----- //\n" + (text ? *text : failure.text) + "\n")
              .str());
  }
}

static StringRef getGoalName(CompileRequest::Goal goal) {
  switch (goal) {
  case CompileRequest::Goal::Primal:
    return "primal";
  case CompileRequest::Goal::Adjoint:
  case CompileRequest::Goal::StoredAdjoint:
    return "adjoint";
  case CompileRequest::Goal::ZeroingAdjoint:
  case CompileRequest::Goal::StoredZeroingAdjoint:
    return "taking";
  }
  llvm_unreachable("unknown goal");
}

void CompileReports::printProfile(StringRef name, CompileRequest::Goal goal,
                                  const Compiler::Function &function) {
  if (!printsProfile)
    return;
  std::string line =
      llvm::formatv("{0,-32} {1,-8} {2,-5}", name, getGoalName(goal),
                    function.fromCache ? "hit" : "miss");
  for (unsigned i = 0; i < kNumPhases; ++i)
    line +=
        llvm::formatv(" {0} {1,7:F2} ms", stringifyPhase(static_cast<Phase>(i)),
                      function.times[i] * 1e3);
  write(line + "\n");
}
