//===- Races.h - Certain races between iterations ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_RACES_H
#define TAI_ANALYSIS_RACES_H

#include "tai/Interfaces/Differentiable.h"
#include <optional>

namespace mlir::tai {

/// Finds a race of two accesses: returns the parallel loop around both if two
/// different iterations of it certainly reach the same element, one by each
/// access; else null. `lhs` and `rhs` can be the same access. With
/// `ofLongLoops`, a loop with unknown bounds is assumed to have many
/// iterations.
Operation *findRace(DifferentiableAccessInterface lhs,
                    DifferentiableAccessInterface rhs,
                    bool ofLongLoops = false);

/// Two iterations of one parallel loop, by their indices.
struct IterationPair {
  SmallVector<int64_t> lhs, rhs;
};

/// An example of a race: different iterations of the parallel loop around both
/// accesses that certainly reach the same element, one by each access. Tries
/// iterations near the bounds, which must be constants. Conditions are
/// evaluated, where indices decide them.
std::optional<IterationPair> findExample(DifferentiableAccessInterface lhs,
                                         DifferentiableAccessInterface rhs);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_RACES_H
