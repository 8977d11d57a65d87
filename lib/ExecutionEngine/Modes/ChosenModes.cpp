//===- ChosenModes.cpp - The effect of modes on kernel code ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Modes/ChosenModes.h"
#include "tai/Dialect/Tai/IR/Modes.h"

using namespace mlir;
using namespace mlir::tai;

/// Returns the reason why `modes` contradict each other or the options of the
/// context; empty if they do not.
static std::string findContradiction(const Modes &modes,
                                     const CompileOptions &options) {
  bool isFast =
      modes.math ? modes.math == MathMode::Fast : options.codegen.fastMath;
  if (isFast && options.shadow)
    return "'shadow' and 'math=\"fast\"' contradict one another: the first "
           "rounds every operation by itself, the second reorders them; choose "
           "one";
  if (!isFast || !modes.isCompensated())
    return "";
  std::string fast = modes.math ? "math=\"fast\"" : "fast_math=True";
  return "sums=\"compensated\" and " + fast +
         " contradict one another: the first keeps what a sum rounds away, the "
         "second may cancel it by reordering; choose one";
}

FailureOr<CompileOptions>
mlir::tai::getKernelOptions(KernelOp kernel, const CompileOptions &options) {
  Modes modes = Modes::of(kernel);
  auto fail = [&](const Twine &problem) {
    return kernel.emitError()
           << "kernel '" << kernel.getSymName() << "': " << problem;
  };
  std::string problem = findContradiction(modes, options);
  if (!problem.empty())
    return fail(problem);
  if (options.interpret &&
      (modes.flushes() || modes.isCompensated() || modes.isAccurate()))
    return fail(Twine(modes.flushes()         ? "ftz=True"
                      : modes.isCompensated() ? "sums=\"compensated\""
                                              : "math=\"accurate\"") +
                " cannot be had where no code is made; choose arch=ti.cpu");
  CompileOptions result = options;
  result.deterministic =
      (options.deterministic ? modes.inDeterministicContext() : modes)
          .isDeterministic();
  if (options.device && result.deterministic && !options.deterministic)
    return fail("sums=\"deterministic\" cannot be had for one kernel on a GPU; "
                "give it to ti.init, for all");
  if (modes.math)
    result.codegen.fastMath = modes.math == MathMode::Fast;
  // The mode `accurate` concerns only functions of libm, so in a strict context
  // the kernel remains strict.
  bool isStrict = modes.math && !modes.isAccurate()
                      ? modes.math == MathMode::Strict
                      : !options.codegen.contract;
  // In deterministic mode products and sums are not fused: other numbers of
  // threads divide loops differently, and whether an operation is fused may
  // depend on the end of a vectorised loop.
  result.codegen.contract = !isStrict && !result.deterministic;
  result.codegen.combineScatters &= !isStrict && !result.deterministic;
  return result;
}
