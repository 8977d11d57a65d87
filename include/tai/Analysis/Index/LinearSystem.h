//===- LinearSystem.h - Systems of linear inequalities ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Conjunctions of linear inequalities over integers, and Fourier-Motzkin
// elimination. The real shadow of a system holds all solutions, its dark shadow
// (Pugh, The Omega Test, 1991) solutions only; where all coefficients of a
// variable on one side are one, the two shadows are equal. Small vectors
// instead of a Presburger library: most systems of a kernel have two variables.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_INDEX_LINEARSYSTEM_H
#define TAI_ANALYSIS_INDEX_LINEARSYSTEM_H

#include "mlir/Support/LLVM.h"
#include "llvm/ADT/SmallVector.h"
#include <cstdint>
#include <utility>

namespace mlir::tai {

/// A sum of variables times factors, and a constant. Terms are sorted by
/// variable, and no factor is zero.
struct LinearSum {
  SmallVector<std::pair<unsigned, int64_t>, 4> terms;
  int64_t constant = 0;
  /// Set when computing a coefficient overflowed: the sum is then invalid.
  bool hasOverflow = false;

  static LinearSum of(int64_t constant) { return {{}, constant}; }
  static LinearSum variable(unsigned number) { return {{{number, 1}}, 0}; }

  int64_t getFactor(unsigned variable) const;
  /// Adds `scale` times the sum `other`.
  void add(const LinearSum &other, int64_t scale = 1);
  LinearSum plus(const LinearSum &other, int64_t scale = 1) const;
  LinearSum plus(int64_t number) const { return plus(of(number)); }

  bool operator==(const LinearSum &other) const {
    return constant == other.constant && terms == other.terms;
  }
};

/// A conjunction of `sum >= 0`.
class LinearSystem {
public:
  ArrayRef<LinearSum> getRows() const { return rows; }
  /// True if some inequality of the system can never hold, so that the system
  /// has no solution. A system without a solution is not always contradictory
  /// in this sense.
  bool isContradictory() const { return contradictory; }
  /// True if the system is invalid because it, or a coefficient, became too
  /// large.
  bool isUnknown() const { return unknown; }

  /// Adds the inequality `sum >= 0` to the system, divided by the greatest
  /// common divisor of the sum's factors.
  void require(LinearSum sum);
  void require(ArrayRef<LinearSum> sums) {
    for (const LinearSum &sum : sums)
      require(sum);
  }

  /// The variables of the system, ascending.
  SmallVector<unsigned> getVariables() const;

  enum class Shadow { Real, Dark };
  /// Projects the system along `variable` (Fourier-Motzkin), with the given
  /// shadow. Sets `isExact` to false unless the real and the dark shadow are
  /// equal.
  LinearSystem eliminate(unsigned variable, Shadow shadow, bool &isExact) const;

private:
  SmallVector<LinearSum> rows;
  bool contradictory = false, unknown = false;
};

} // namespace mlir::tai

#endif // TAI_ANALYSIS_INDEX_LINEARSYSTEM_H
