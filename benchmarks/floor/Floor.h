//===- Floor.h - shared pieces of the hand-written floor -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The floor is code that a person would write by hand with oneTBB for the
// forward pass of a scene: structure of arrays, every slot stored as a
// differentiable run needs it, no tricks that a scene's formulas do not
// suggest. Each scene returns its loss, which is compared with the f64
// references.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_BENCHMARKS_FLOOR_FLOOR_H
#define TAI_BENCHMARKS_FLOOR_FLOOR_H

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/partitioner.h>

#include <functional>

namespace tai::floor {

/// Runs `body(row)` for each of `rows` rows on all threads. The blocks are
/// static: every row costs the same, and a row stays in the cache of one core.
template <typename Body> void forEachRow(int rows, const Body &body) {
  tbb::parallel_for(
      tbb::blocked_range<int>(0, rows),
      [&](const tbb::blocked_range<int> &range) {
        for (int row = range.begin(); row != range.end(); ++row)
          body(row);
      },
      tbb::static_partitioner());
}

/// Yin-yang symbol on an n x n grid, 0 or 1.
double symbol(int row, int column, int n);

/// A scene that can run any number of times; every run returns the loss.
using Scene = std::function<double()>;

template <typename Real> Scene makeSmoke(bool atRest);
template <typename Real> Scene makeWave(bool atRest);
template <typename Real> Scene makeMpm(int threads);

} // namespace tai::floor

#endif // TAI_BENCHMARKS_FLOOR_FLOOR_H
