//===- Wave.cpp - hand-written forward pass of the wave
//--------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// 128 x 128 cells, 256 slots. A frame of zeros around each slot makes the
// border one loop with the inside.
//
//===----------------------------------------------------------------------===//

#include "Floor.h"

#include <cmath>
#include <memory>
#include <numbers>
#include <vector>

using namespace tai::floor;

namespace {

constexpr int n = 128;
constexpr int stride = n + 2;
constexpr int size = stride * stride;
constexpr int slots = 256;

template <typename Real> struct State {
  std::vector<Real> u = std::vector<Real>(slots * size);
  std::vector<double> target = std::vector<double>(n * n);
};

} // namespace

template <typename Real> Scene tai::floor::makeWave(bool atRest) {
  auto state = std::make_shared<State<Real>>();
  double mean = 0.0;
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j) {
      double x = (i + 0.5) / n, y = (j + 0.5) / n;
      using std::numbers::pi;
      if (!atRest)
        state->u[(i + 1) * stride + j + 1] =
            0.3 * std::sin(pi * x) * std::sin(2.0 * pi * y) +
            0.1 * std::cos(5.0 * x + 3.0 * y);
      state->target[i * n + j] = symbol(i, j, n);
      mean += state->target[i * n + j] / (n * n);
    }
  for (double &value : state->target)
    value -= mean;
  return [state] {
    // c^2 dt^2 = dx^2 / 3, so the Laplacian's factor is a third.
    const Real third = Real(1) / 3;
    for (int t = 2; t < slots; ++t) {
      const Real *before = &state->u[(t - 2) * size], *now = before + size;
      Real *after = &state->u[t * size];
      forEachRow(n, [=](int i) {
        const Real *row = now + (i + 1) * stride, *up = row - stride,
                   *down = row + stride;
        const Real *older = before + (i + 1) * stride;
        Real *__restrict out = after + (i + 1) * stride;
        for (int j = 1; j <= n; ++j) {
          Real laplacian =
              up[j] + down[j] + row[j - 1] + row[j + 1] - 4 * row[j];
          out[j] = 2 * row[j] + third * laplacian - older[j];
        }
      });
    }
    const Real *last = &state->u[(slots - 1) * size];
    double sum = 0.0;
    for (int i = 0; i < n; ++i)
      for (int j = 0; j < n; ++j) {
        double difference =
            state->target[i * n + j] - last[(i + 1) * stride + j + 1];
        sum += difference * difference;
      }
    return sum / (n * n);
  };
}

template Scene tai::floor::makeWave<float>(bool);
template Scene tai::floor::makeWave<double>(bool);
