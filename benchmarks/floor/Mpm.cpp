//===- Mpm.cpp - hand-written forward pass of 2-D MLS-MPM
//------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// 6400 particles on a 128 x 128 grid, 51 slots (50 steps). Each thread scatters
// into a grid of its own, the grid update adds these up: no atomics. Particle
// slots are all stored, the grid is used again by every step.
//
//===----------------------------------------------------------------------===//

#include "Floor.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

using namespace tai::floor;

namespace {

constexpr int n = 128;
constexpr int nodes = n * n;
constexpr int side = 80;
constexpr int count = side * side;
constexpr int slots = 51;

template <typename Real> struct State {
  /// Components of x, v, C and F, each slots * count long.
  std::vector<Real> x[2], v[2], c[4], f[4];
  /// Per thread: momentum (2) and mass of every node.
  std::vector<std::vector<Real>> scattered;
  std::vector<Real> grid[2];

  explicit State(int threads) : scattered(threads) {
    for (int a = 0; a < 2; ++a) {
      x[a].resize(slots * count);
      v[a].resize(slots * count);
      grid[a].resize(nodes);
    }
    for (int a = 0; a < 4; ++a) {
      c[a].resize(slots * count);
      f[a].resize(slots * count);
    }
    for (std::vector<Real> &own : scattered)
      own.resize(3 * nodes);
  }
};

constexpr double dt = 3e-4, dx = 1.0 / n, mu = 100.0, lambda = 100.0,
                 gravity = 9.8;

/// Base node and quadratic B-spline weights of one particle.
template <typename Real> struct Support {
  int node;
  Real fx[2], weight[2][3];

  Support(Real px, Real py) {
    const Real position[2] = {px * n, py * n};
    int base[2];
    for (int a = 0; a < 2; ++a) {
      base[a] = int(position[a] - Real(0.5));
      fx[a] = position[a] - base[a];
      weight[a][0] = Real(0.5) * (Real(1.5) - fx[a]) * (Real(1.5) - fx[a]);
      weight[a][1] = Real(0.75) - (fx[a] - 1) * (fx[a] - 1);
      weight[a][2] = Real(0.5) * (fx[a] - Real(0.5)) * (fx[a] - Real(0.5));
    }
    node = base[0] * n + base[1];
  }
};

template <typename Real>
void scatter(State<Real> &s, int p, Real *__restrict momentum0,
             Real *__restrict momentum1, Real *__restrict mass) {
  const Real h = dt;
  const Real c00 = s.c[0][p], c01 = s.c[1][p], c10 = s.c[2][p], c11 = s.c[3][p];
  const Real o00 = s.f[0][p], o01 = s.f[1][p], o10 = s.f[2][p], o11 = s.f[3][p];
  const Real f00 = o00 + h * (c00 * o00 + c01 * o10),
             f01 = o01 + h * (c00 * o01 + c01 * o11);
  const Real f10 = o10 + h * (c10 * o00 + c11 * o10),
             f11 = o11 + h * (c10 * o01 + c11 * o11);
  s.f[0][p + count] = f00;
  s.f[1][p + count] = f01;
  s.f[2][p + count] = f10;
  s.f[3][p + count] = f11;

  const Real even = f00 + f11, odd = f10 - f01;
  const Real scale = 1 / std::sqrt(even * even + odd * odd);
  const Real cosine = even * scale, sine = odd * scale;
  const Real m00 = f00 - cosine, m01 = f01 + sine, m10 = f10 - sine,
             m11 = f11 - cosine;
  const Real determinant = f00 * f11 - f01 * f10;
  const Real pressure = Real(lambda) * (determinant - 1) * determinant;
  const Real stiff = Real(-dt * 4.0 / (dx * dx)), twice = Real(2.0 * mu);
  const Real a00 = stiff * (twice * (m00 * f00 + m01 * f01) + pressure) + c00;
  const Real a01 = stiff * twice * (m00 * f10 + m01 * f11) + c01;
  const Real a10 = stiff * twice * (m10 * f00 + m11 * f01) + c10;
  const Real a11 = stiff * (twice * (m10 * f10 + m11 * f11) + pressure) + c11;

  const Support<Real> support(s.x[0][p], s.x[1][p]);
  const Real v0 = s.v[0][p], v1 = s.v[1][p];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      const Real d0 = (i - support.fx[0]) * Real(dx),
                 d1 = (j - support.fx[1]) * Real(dx);
      const Real weight = support.weight[0][i] * support.weight[1][j];
      const int node = support.node + i * n + j;
      momentum0[node] += weight * (v0 + a00 * d0 + a01 * d1);
      momentum1[node] += weight * (v1 + a10 * d0 + a11 * d1);
      mass[node] += weight;
    }
}

template <typename Real> void updateGridRow(State<Real> &s, int i) {
  for (int j = 0; j < n; ++j) {
    const int node = i * n + j;
    Real v0 = 0, v1 = 0, mass = Real(1e-10);
    for (const std::vector<Real> &own : s.scattered) {
      v0 += own[node];
      v1 += own[nodes + node];
      mass += own[2 * nodes + node];
    }
    v0 /= mass;
    v1 = v1 / mass - Real(dt * gravity);
    if ((i < 3 && v0 < 0) || (i > n - 3 && v0 > 0))
      v0 = 0;
    if ((j < 3 && v1 < 0) || (j > n - 3 && v1 > 0))
      v1 = 0;
    s.grid[0][node] = v0;
    s.grid[1][node] = v1;
  }
}

template <typename Real> void gather(State<Real> &s, int p) {
  const Support<Real> support(s.x[0][p], s.x[1][p]);
  Real v[2] = {0, 0}, c[4] = {0, 0, 0, 0};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      const Real d0 = i - support.fx[0], d1 = j - support.fx[1];
      const Real weight = support.weight[0][i] * support.weight[1][j];
      const int node = support.node + i * n + j;
      for (int a = 0; a < 2; ++a) {
        const Real part = weight * s.grid[a][node];
        v[a] += part;
        c[2 * a] += part * d0;
        c[2 * a + 1] += part * d1;
      }
    }
  for (int a = 0; a < 2; ++a) {
    s.v[a][p + count] = v[a];
    s.x[a][p + count] = s.x[a][p] + Real(dt) * v[a];
  }
  for (int a = 0; a < 4; ++a)
    s.c[a][p + count] = Real(4.0 / dx) * c[a];
}

template <typename Real> void step(State<Real> &s, int t) {
  const int threads = int(s.scattered.size()), first = t * count;
  forEachRow(threads, [&, first](int thread) {
    std::vector<Real> &own = s.scattered[thread];
    std::fill(own.begin(), own.end(), Real(0));
    const int begin = count * thread / threads,
              end = count * (thread + 1) / threads;
    for (int p = begin; p < end; ++p)
      scatter(s, first + p, own.data(), own.data() + nodes,
              own.data() + 2 * nodes);
  });
  forEachRow(n, [&](int i) { updateGridRow(s, i); });
  forEachRow(side, [&, first](int row) {
    for (int p = row * side; p < (row + 1) * side; ++p)
      gather(s, first + p);
  });
}

} // namespace

template <typename Real> Scene tai::floor::makeMpm(int threads) {
  auto state = std::make_shared<State<Real>>(threads);
  for (int i = 0; i < side; ++i)
    for (int j = 0; j < side; ++j) {
      const int p = i * side + j;
      const double x = dx * (0.5 * i + 10.0), y = dx * (0.5 * j + 25.0);
      state->x[0][p] = x;
      state->x[1][p] = y;
      state->v[0][p] = 0.5 + 0.8 * std::sin(9.0 * y) * std::cos(5.0 * x);
      state->v[1][p] = 0.3 * std::cos(7.0 * x) - 0.4 * std::sin(4.0 * y);
      state->f[0][p] = state->f[3][p] = 1;
    }
  return [state] {
    for (int t = 0; t < slots - 1; ++t)
      step(*state, t);
    double sum = 0.0;
    const int last = (slots - 1) * count;
    for (int p = last; p < last + count; ++p) {
      const double d0 = state->x[0][p] - 0.3, d1 = state->x[1][p] - 0.6;
      sum += 0.5 * (d0 * d0 + d1 * d1);
    }
    return sum / count;
  };
}

template Scene tai::floor::makeMpm<float>(int);
template Scene tai::floor::makeMpm<double>(int);
