//===- Smoke.cpp - hand-written forward pass of smoke
//----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// 110 x 110 cells, 100 slots, 6 Jacobi sweeps a step, periodic. The projection
// of a step uses the last but one sweep of the step before it, as the published
// program does.
//
//===----------------------------------------------------------------------===//

#include "Floor.h"

#include <cmath>
#include <memory>
#include <numbers>
#include <vector>

using namespace tai::floor;

namespace {

constexpr int n = 110;
constexpr int cells = n * n;
constexpr int slots = 100;
constexpr int sweeps = 6;

/// All time slots; every component is an array of its own.
template <typename Real> struct State {
  std::vector<Real> v[2], star[2], density, divergence, pressure, target;

  State() {
    for (int c = 0; c < 2; ++c) {
      v[c].resize(slots * cells);
      star[c].resize(slots * cells);
    }
    density.resize(slots * cells);
    divergence.resize(slots * cells);
    // Step t writes the sweeps t * sweeps + 1 to (t + 1) * sweeps.
    pressure.resize((slots * sweeps + 1) * cells);
    target.resize(cells);
  }
};

int wrap(int index) {
  return index < 0 ? index + n : index >= n ? index - n : index;
}

/// Where a bilinear gather of one row's cells reads, and with which weights.
template <typename Real> struct Gather {
  int at00[n], at01[n], at10[n], at11[n];
  Real fx[n], fy[n];

  Gather(int i, const Real *__restrict wx, const Real *__restrict wy) {
    for (int j = 0; j < n; ++j) {
      Real cx = i - wx[j], cy = j - wy[j];
      Real lx = std::floor(cx), ly = std::floor(cy);
      fx[j] = cx - lx;
      fy[j] = cy - ly;
      // A velocity may carry any number of periods.
      int ax = int(lx - Real(n) * std::floor(lx / Real(n)));
      int ay = int(ly - Real(n) * std::floor(ly / Real(n)));
      int bx = ax + 1 == n ? 0 : ax + 1;
      int by = ay + 1 == n ? 0 : ay + 1;
      at00[j] = ax * n + ay;
      at01[j] = ax * n + by;
      at10[j] = bx * n + ay;
      at11[j] = bx * n + by;
    }
  }

  void operator()(const Real *__restrict from, Real *__restrict to) const {
    for (int j = 0; j < n; ++j) {
      Real nearer = (1 - fy[j]) * from[at00[j]] + fy[j] * from[at01[j]];
      Real farther = (1 - fy[j]) * from[at10[j]] + fy[j] * from[at11[j]];
      to[j] = (1 - fx[j]) * nearer + fx[j] * farther;
    }
  }
};

template <typename Real> void step(State<Real> &s, int t) {
  Real *v0 = &s.v[0][t * cells], *v1 = &s.v[1][t * cells];
  const Real *u0 = v0 - cells, *u1 = v1 - cells;
  Real *star0 = &s.star[0][t * cells], *star1 = &s.star[1][t * cells];
  forEachRow(n, [=](int i) {
    Gather<Real> gather(i, u0 + i * n, u1 + i * n);
    gather(u0, star0 + i * n);
    gather(u1, star1 + i * n);
  });

  Real *divergence = &s.divergence[t * cells];
  const Real dx = Real(1) / n;
  forEachRow(n, [=](int i) {
    const Real *up = star0 + wrap(i - 1) * n, *down = star0 + wrap(i + 1) * n;
    const Real *row = star1 + i * n;
    Real *__restrict out = divergence + i * n;
    auto at = [&](int j, int left, int right) {
      out[j] = Real(-0.5) * dx * (down[j] - up[j] + row[right] - row[left]);
    };
    at(0, n - 1, 1);
    for (int j = 1; j < n - 1; ++j)
      at(j, j - 1, j + 1);
    at(n - 1, n - 2, 0);
  });

  for (int sweep = 0; sweep < sweeps; ++sweep) {
    const Real *from = &s.pressure[(t * sweeps + sweep) * cells];
    Real *to = &s.pressure[(t * sweeps + sweep + 1) * cells];
    forEachRow(n, [=](int i) {
      const Real *up = from + wrap(i - 1) * n, *down = from + wrap(i + 1) * n;
      const Real *row = from + i * n, *source = divergence + i * n;
      Real *__restrict out = to + i * n;
      auto at = [&](int j, int left, int right) {
        out[j] =
            (source[j] + up[j] + down[j] + row[left] + row[right]) * Real(0.25);
      };
      at(0, n - 1, 1);
      for (int j = 1; j < n - 1; ++j)
        at(j, j - 1, j + 1);
      at(n - 1, n - 2, 0);
    });
  }

  const Real *pressure = &s.pressure[(t * sweeps - 1) * cells];
  const Real factor = Real(0.5) / dx;
  const Real *before = &s.density[(t - 1) * cells];
  Real *density = &s.density[t * cells];
  // The density follows in the velocity of its own cell, so it shares the loop.
  forEachRow(n, [=](int i) {
    const Real *up = pressure + wrap(i - 1) * n,
               *down = pressure + wrap(i + 1) * n;
    const Real *row = pressure + i * n;
    const Real *in0 = star0 + i * n, *in1 = star1 + i * n;
    Real *__restrict out0 = v0 + i * n;
    Real *__restrict out1 = v1 + i * n;
    auto at = [&](int j, int left, int right) {
      out0[j] = in0[j] - factor * (down[j] - up[j]);
      out1[j] = in1[j] - factor * (row[right] - row[left]);
    };
    at(0, n - 1, 1);
    for (int j = 1; j < n - 1; ++j)
      at(j, j - 1, j + 1);
    at(n - 1, n - 2, 0);
    Gather<Real> gather(i, v0 + i * n, v1 + i * n);
    gather(before, density + i * n);
  });
}

} // namespace

template <typename Real> Scene tai::floor::makeSmoke(bool atRest) {
  auto state = std::make_shared<State<Real>>();
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j) {
      double pi = 2.0 * std::numbers::pi * i / n,
             pj = 2.0 * std::numbers::pi * j / n;
      if (!atRest) {
        state->v[0][i * n + j] =
            0.6 * std::sin(pj) + 0.25 * std::cos(pi + 2.0 * pj);
        state->v[1][i * n + j] =
            0.5 * std::cos(pi) - 0.2 * std::sin(2.0 * pi + pj);
      }
      state->density[i * n + j] = i / 10 % 4 == 1;
      state->target[i * n + j] = symbol(i, j, n);
    }
  return [state] {
    for (int t = 1; t < slots; ++t)
      step(*state, t);
    const Real *last = &state->density[(slots - 1) * cells];
    double sum = 0.0;
    for (int k = 0; k < cells; ++k) {
      double difference = state->target[k] - last[k];
      sum += difference * difference;
    }
    return sum / cells;
  };
}

template Scene tai::floor::makeSmoke<float>(bool);
template Scene tai::floor::makeSmoke<double>(bool);
