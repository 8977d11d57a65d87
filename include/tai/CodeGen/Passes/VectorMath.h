//===- VectorMath.h - Elementary functions of vectors -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The vectoriser keeps loops with calls of elementary functions scalar, unless
// it knows vector forms of these. Here it learns the forms of VectorMath.def:
// those of the runtime and those of SLEEF. Calls that may not be
// contracted (those of strict kernels) stay calls of libm.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_PASSES_VECTORMATH_H
#define TAI_CODEGEN_PASSES_VECTORMATH_H

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

/// The file names under which the libraries of vector functions are loaded.
inline constexpr llvm::StringLiteral kGlibcVectors = "libmvec.so.1";
inline constexpr llvm::StringLiteral kSleef = "libsleef.so.3";

/// A table of the vector math functions that code for one processor may call.
class VectorMath {
public:
  /// The scalar and vector forms of one function, by their symbol names; an
  /// empty name means that there is no such form.
  struct Forms {
    std::string scalar;
    /// The vector forms: pairs of the number of lanes and the symbol name.
    llvm::SmallVector<std::pair<unsigned, std::string>, 3> vectors;
  };

  VectorMath(const llvm::TargetMachine &machine, bool hasSleef);

  /// Finds the forms of the function that `call` calls; null if the call must
  /// stay as it is.
  const Forms *find(const llvm::CallInst &call) const;

  /// Finds the name of the form with twice as many lanes as the form `name`;
  /// empty if there is none.
  llvm::StringRef findTwice(llvm::StringRef name) const {
    auto found = twice.find(name);
    return found == twice.end() ? llvm::StringRef() : found->second;
  }

private:
  void add(llvm::StringRef intrinsic, llvm::StringRef function,
           const Forms &added);

  /// The forms of functions, by the name of LLVM's intrinsic and by the name of
  /// libm's function.
  llvm::StringMap<Forms> forms;
  /// The names of vector forms, by the name of the form with half the lanes.
  llvm::StringMap<std::string> twice;
};

/// Runs before the loop vectoriser: annotates calls with their vector forms, as
/// the vector function ABI specifies. With `besideOthers`, functions for which
/// the target library has shorter forms keep the latter.
struct NameVectorMath : llvm::PassInfoMixin<NameVectorMath> {
  NameVectorMath(const VectorMath &math, bool besideOthers)
      : math(&math), besideOthers(besideOthers) {}
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);
  const VectorMath *math;
  bool besideOthers;
};

/// Runs after the vectorisers: joins two calls of one vector form in a block to
/// a call of the form with twice as many lanes, which yields the same bits. On
/// processors with AVX-512 the vectorisers prefer vectors of 256 bits, since
/// short loops gain nothing by longer ones; functions take half the time.
struct JoinVectorMath : llvm::PassInfoMixin<JoinVectorMath> {
  explicit JoinVectorMath(const VectorMath &math) : math(&math) {}
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);
  const VectorMath *math;
};

/// Runs after the vectorisers: in a function that calls vector forms, the
/// remaining scalar calls take the scalar forms, which yield the same bits, so
/// that a result does not depend on its place in a loop. In other functions,
/// calls of libm, which is faster for one number, stay; with `everywhere`,
/// these take the scalar forms too, so that a result does not depend on the
/// function that computes it either.
struct MatchScalarMath : llvm::PassInfoMixin<MatchScalarMath> {
  MatchScalarMath(const VectorMath &math, bool everywhere)
      : math(&math), everywhere(everywhere) {}
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);
  const VectorMath *math;
  bool everywhere;
};

} // namespace mlir::tai

#endif // TAI_CODEGEN_PASSES_VECTORMATH_H
