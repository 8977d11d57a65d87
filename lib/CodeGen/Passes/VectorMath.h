//===- VectorMath.h - Elementary functions of vectors -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Calls of elementary functions keep a loop scalar, unless the vectoriser knows
// forms for vectors. Here it learns those of VectorMath.def: of the runtime,
// for f32, and of SLEEF. Calls that may not be contracted (those of strict
// kernels) stay calls of libm.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_PASSES_VECTORMATH_H
#define TAI_LIB_CODEGEN_PASSES_VECTORMATH_H

#include "llvm/ADT/SmallVector.h"
#include "llvm/ADT/StringMap.h"
#include "llvm/ADT/StringRef.h"
#include "llvm/IR/PassManager.h"
#include <string>
#include <utility>

namespace llvm {
class CallInst;
class TargetMachine;
} // namespace llvm

namespace mlir::tai {

/// The libraries by the names under which they are loaded.
inline constexpr llvm::StringLiteral kGlibcVectors = "libmvec.so.1";
inline constexpr llvm::StringLiteral kSleef = "libsleef.so.3";

/// The functions of vectors that code for one processor may call.
class VectorMath {
public:
  /// The names of one function's forms; an empty one is missing.
  struct Forms {
    std::string scalar;
    /// The vector forms, each with its number of lanes.
    llvm::SmallVector<std::pair<unsigned, std::string>, 3> vectors;
  };

  VectorMath(const llvm::TargetMachine &machine, bool hasSleef);

  /// The forms of the called function, if they may replace it.
  const Forms *find(const llvm::CallInst &call) const;

private:
  /// By the names of LLVM's intrinsic and of libm's function.
  llvm::StringMap<Forms> forms;
};

/// Runs before the loop vectoriser: annotates calls with their vector forms,
/// as the vector function ABI does. With `besideOthers`, functions for which
/// the target library has shorter forms keep those.
struct NameVectorMath : llvm::PassInfoMixin<NameVectorMath> {
  NameVectorMath(const VectorMath &math, bool besideOthers)
      : math(&math), besideOthers(besideOthers) {}
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);
  const VectorMath *math;
  bool besideOthers;
};

/// Runs after the vectorisers: in a function that calls vector forms, the
/// remaining calls take the scalar forms, which have the same bits, so that a
/// result does not depend on its place in a loop. Elsewhere libm, which is
/// faster for one number, stays; with `everywhere`, a result does not depend on
/// the function that it stands in either.
struct MatchScalarMath : llvm::PassInfoMixin<MatchScalarMath> {
  MatchScalarMath(const VectorMath &math, bool everywhere)
      : math(&math), everywhere(everywhere) {}
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);
  const VectorMath *math;
  bool everywhere;
};

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_PASSES_VECTORMATH_H
