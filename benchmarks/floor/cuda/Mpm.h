//===- Mpm.h - bodies of the 2-D MLS-MPM kernels ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A step is: scatter particles to the grid, make velocities of it, gather them.
// Every slot of particles and of the scattered grid is kept for the reverse
// sweep; adjoints of particles exist for one slot, for a particle's adjoint is
// its thread's own. Vectors are stored whole, for 8 and 16 byte accesses.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_BENCHMARKS_FLOOR_CUDA_MPM_H
#define TAI_BENCHMARKS_FLOOR_CUDA_MPM_H

#include "Common.h"

namespace tai::floor {

struct Mpm {
  // The scene.
  int n, count, slots;
  float dt, dx, inverseDx, mu, lambda, gravity;
  float goalX, goalY;

  // Particles, [slots][count].
  Pair *x, *v;
  Quad *c, *f;
  /// Momentum and mass, [slots - 1][n * n].
  Quad *grid;
  /// Velocity of the nodes, [slots - 1][n * n].
  Pair *velocity;

  // Adjoints of one slot of particles, [count].
  Pair *xBar, *vBar;
  Quad *cBar, *fBar;
  /// Adjoint of the nodes' velocity, [slots - 1][n * n], zero at the start.
  Pair *velocityBar;
  /// Adjoint of momentum and mass of one step, [n * n].
  Quad *gridBar;

  float *loss;

  TAI_BOTH int nodes() const { return n * n; }
  TAI_BOTH float stiff() const { return dt * 4.0f * inverseDx * inverseDx; }
};

struct Particle {
  Pair x, v;
  Quad c, f;
};

/// Base node and quadratic weights of a particle.
struct Support {
  int node, base[2];
  float fx[2], weight[2][3];

  TAI_BOTH Support(const Mpm &s, Pair position) {
    const float scaled[2] = {position.x * s.inverseDx,
                             position.y * s.inverseDx};
    for (int a = 0; a < 2; ++a) {
      base[a] = int(scaled[a] - 0.5f);
      fx[a] = scaled[a] - float(base[a]);
      weight[a][0] = 0.5f * (1.5f - fx[a]) * (1.5f - fx[a]);
      weight[a][1] = 0.75f - (fx[a] - 1.0f) * (fx[a] - 1.0f);
      weight[a][2] = 0.5f * (fx[a] - 0.5f) * (fx[a] - 0.5f);
    }
    node = base[0] * s.n + base[1];
  }

  /// Adjoint of the position within its cell from that of the weights.
  TAI_BOTH Pair positionBar(const float (&weightBar)[2][3]) const {
    float bar[2];
    for (int a = 0; a < 2; ++a)
      bar[a] = -(1.5f - fx[a]) * weightBar[a][0] -
               2.0f * (fx[a] - 1.0f) * weightBar[a][1] +
               (fx[a] - 0.5f) * weightBar[a][2];
    return {bar[0], bar[1]};
  }
};

/// (1 + dt C) F.
TAI_BOTH Quad deform(const Mpm &s, Quad c, Quad f) {
  return {f.x + s.dt * (c.x * f.x + c.y * f.z),
          f.y + s.dt * (c.x * f.y + c.y * f.w),
          f.z + s.dt * (c.z * f.x + c.w * f.z),
          f.w + s.dt * (c.z * f.y + c.w * f.w)};
}

/// Stress times its factor, plus C: the factor of a particle's momentum.
TAI_BOTH Quad affineOf(const Mpm &s, Quad c, Quad f) {
  const float even = f.x + f.w, odd = f.z - f.y;
  const float scale = 1.0f / sqrtf(even * even + odd * odd);
  const float cosine = even * scale, sine = odd * scale;
  const Quad m = {f.x - cosine, f.y + sine, f.z - sine, f.w - cosine};
  const float determinant = f.x * f.w - f.y * f.z;
  const float pressure = s.lambda * (determinant - 1.0f) * determinant;
  const float stiff = -s.stiff(), twice = 2.0f * s.mu;
  return {stiff * (twice * (m.x * f.x + m.y * f.y) + pressure) + c.x,
          stiff * twice * (m.x * f.z + m.y * f.w) + c.y,
          stiff * twice * (m.z * f.x + m.w * f.y) + c.z,
          stiff * (twice * (m.z * f.z + m.w * f.w) + pressure) + c.w};
}

/// Scatters a particle of slot t by `add(support, i, j, value)`; returns its
/// new F.
template <typename Add>
TAI_BOTH Quad scatter(const Mpm &s, const Particle &p, const Add &add) {
  const Quad f = deform(s, p.c, p.f);
  const Quad a = affineOf(s, p.c, f);
  const Support support(s, p.x);
  TAI_UNROLL
  for (int i = 0; i < 3; ++i)
    TAI_UNROLL
  for (int j = 0; j < 3; ++j) {
    const float dx = (float(i) - support.fx[0]) * s.dx,
                dy = (float(j) - support.fx[1]) * s.dx;
    const float weight = support.weight[0][i] * support.weight[1][j];
    add(support, i, j,
        Quad{weight * (p.v.x + a.x * dx + a.y * dy),
             weight * (p.v.y + a.z * dx + a.w * dy), weight, 0.0f});
  }
  return f;
}

/// The same to a grid in memory, whole nodes at a time or by components.
template <bool Whole>
TAI_BOTH Quad scatterTo(const Mpm &s, const Particle &p, Quad *grid) {
  return scatter(s, p, [&](const Support &support, int i, int j, Quad value) {
    Quad *node = grid + (support.node + i * s.n + j);
    if (Whole) {
      addTo(node, value);
    } else {
      addTo(&node->x, value.x);
      addTo(&node->y, value.y);
      addTo(&node->z, value.z);
    }
  });
}

/// Velocity of node (i, j); `open` tells which components are not held.
TAI_BOTH Pair nodeVelocity(const Mpm &s, Quad node, int i, int j, bool &openX,
                           bool &openY) {
  const float inverse = 1.0f / (node.z + 1e-10f);
  Pair v = {node.x * inverse, node.y * inverse - s.dt * s.gravity};
  openX = !((i < 3 && v.x < 0.0f) || (i > s.n - 3 && v.x > 0.0f));
  openY = !((j < 3 && v.y < 0.0f) || (j > s.n - 3 && v.y > 0.0f));
  return {openX ? v.x : 0.0f, openY ? v.y : 0.0f};
}

TAI_BOTH Pair nodeVelocity(const Mpm &s, Quad node, int i, int j) {
  bool openX, openY;
  return nodeVelocity(s, node, i, j, openX, openY);
}

/// Adjoint of momentum and mass of a node from that of its velocity.
TAI_BOTH Quad nodeBar(const Mpm &s, Quad node, Pair bar, int i, int j) {
  bool openX, openY;
  nodeVelocity(s, node, i, j, openX, openY);
  const float inverse = 1.0f / (node.z + 1e-10f);
  const float x = openX ? bar.x * inverse : 0.0f,
              y = openY ? bar.y * inverse : 0.0f;
  return {x, y, -(x * node.x + y * node.y) * inverse, 0.0f};
}

/// Gathers velocities by `at(node, i, j)` for a particle of slot t; x, v and c
/// become those of slot t + 1.
template <typename At>
TAI_BOTH void gather(const Mpm &s, Particle &p, const At &at) {
  const Support support(s, p.x);
  Pair v = {0.0f, 0.0f};
  Quad c = {0.0f, 0.0f, 0.0f, 0.0f};
  TAI_UNROLL
  for (int i = 0; i < 3; ++i)
    TAI_UNROLL
  for (int j = 0; j < 3; ++j) {
    const float dx = float(i) - support.fx[0], dy = float(j) - support.fx[1];
    const float weight = support.weight[0][i] * support.weight[1][j];
    const Pair node = at(support.node + i * s.n + j);
    const float px = weight * node.x, py = weight * node.y;
    v.x += px;
    v.y += py;
    c.x += px * dx;
    c.y += px * dy;
    c.z += py * dx;
    c.w += py * dy;
  }
  const float factor = 4.0f * s.inverseDx;
  p.v = v;
  p.x = {p.x.x + s.dt * v.x, p.x.y + s.dt * v.y};
  p.c = {factor * c.x, factor * c.y, factor * c.z, factor * c.w};
}

/// Adjoint of `gather`: from the adjoint of slot t + 1 to the nodes' velocities
/// by `add(support, i, j, value)` and to what x of slot t gets from here. v and
/// c of `bar` are used up.
template <typename At, typename Add>
TAI_BOTH void gatherBar(const Mpm &s, Pair x, Particle &bar, const At &at,
                        const Add &add) {
  const Support support(s, x);
  const Pair v = {bar.v.x + s.dt * bar.x.x, bar.v.y + s.dt * bar.x.y};
  const float factor = 4.0f * s.inverseDx;
  const Quad c = {factor * bar.c.x, factor * bar.c.y, factor * bar.c.z,
                  factor * bar.c.w};
  float weightBar[2][3] = {};
  Pair fx = {0.0f, 0.0f};
  TAI_UNROLL
  for (int i = 0; i < 3; ++i)
    TAI_UNROLL
  for (int j = 0; j < 3; ++j) {
    const float dx = float(i) - support.fx[0], dy = float(j) - support.fx[1];
    const float weight = support.weight[0][i] * support.weight[1][j];
    const int index = support.node + i * s.n + j;
    const Pair node = at(index);
    const Pair part = {v.x + c.x * dx + c.y * dy, v.y + c.z * dx + c.w * dy};
    add(support, i, j, Pair{weight * part.x, weight * part.y});
    const float whole = part.x * node.x + part.y * node.y;
    weightBar[0][i] += whole * support.weight[1][j];
    weightBar[1][j] += whole * support.weight[0][i];
    fx.x -= weight * (node.x * c.x + node.y * c.z);
    fx.y -= weight * (node.x * c.y + node.y * c.w);
  }
  const Pair more = support.positionBar(weightBar);
  bar.x.x += (fx.x + more.x) * s.inverseDx;
  bar.x.y += (fx.y + more.y) * s.inverseDx;
}

/// Adds to a grid of pairs in memory.
struct AddPair {
  Pair *grid;
  int n;
  TAI_BOTH void operator()(const Support &support, int i, int j,
                           Pair value) const {
    addTo(grid + (support.node + i * n + j), value);
  }
};

/// Adjoint of `affineOf`: adds to `fBar`, returns the adjoint of C.
TAI_BOTH Quad affineBar(const Mpm &s, Quad f, Quad bar, Quad &fBar) {
  const float even = f.x + f.w, odd = f.z - f.y;
  const float scale = 1.0f / sqrtf(even * even + odd * odd);
  const float cosine = even * scale, sine = odd * scale;
  const Quad m = {f.x - cosine, f.y + sine, f.z - sine, f.w - cosine};
  const float determinant = f.x * f.w - f.y * f.z;
  const float stiff = -s.stiff(), twice = 2.0f * s.mu;
  // sigma = 2 mu (F - R) F^T + pressure.
  const Quad g = {stiff * bar.x, stiff * bar.y, stiff * bar.z, stiff * bar.w};
  const Quad h = {twice * g.x, twice * g.y, twice * g.z, twice * g.w};
  // Adjoint of F - R, and the other factor's share.
  const Quad mBar = {h.x * f.x + h.y * f.z, h.x * f.y + h.y * f.w,
                     h.z * f.x + h.w * f.z, h.z * f.y + h.w * f.w};
  fBar.x += mBar.x + h.x * m.x + h.z * m.z;
  fBar.y += mBar.y + h.x * m.y + h.z * m.w;
  fBar.z += mBar.z + h.y * m.x + h.w * m.z;
  fBar.w += mBar.w + h.y * m.y + h.w * m.w;
  const float jBar = s.lambda * (2.0f * determinant - 1.0f) * (g.x + g.w);
  fBar.x += jBar * f.w;
  fBar.y -= jBar * f.z;
  fBar.z -= jBar * f.y;
  fBar.w += jBar * f.x;
  // R = [[cosine, -sine], [sine, cosine]] enters with a minus.
  const float cosineBar = -(mBar.x + mBar.w), sineBar = mBar.y - mBar.z;
  const float along = cosine * cosineBar + sine * sineBar;
  const float evenBar = (cosineBar - cosine * along) * scale,
              oddBar = (sineBar - sine * along) * scale;
  fBar.x += evenBar;
  fBar.w += evenBar;
  fBar.z += oddBar;
  fBar.y -= oddBar;
  return bar;
}

/// Adjoint of `scatter`: from the adjoint of F of slot t + 1 (in `bar`) and of
/// the nodes, by `at(node)`, to the particle of slot t.
template <typename At>
TAI_BOTH void scatterBar(const Mpm &s, const Particle &p, Particle &bar,
                         const At &at) {
  const Quad f = deform(s, p.c, p.f);
  const Quad a = affineOf(s, p.c, f);
  const Support support(s, p.x);
  Pair v = {0.0f, 0.0f}, fx = {0.0f, 0.0f};
  Quad aBar = {0.0f, 0.0f, 0.0f, 0.0f};
  float weightBar[2][3] = {};
  TAI_UNROLL
  for (int i = 0; i < 3; ++i)
    TAI_UNROLL
  for (int j = 0; j < 3; ++j) {
    const float dx = (float(i) - support.fx[0]) * s.dx,
                dy = (float(j) - support.fx[1]) * s.dx;
    const float weight = support.weight[0][i] * support.weight[1][j];
    const Quad node = at(support.node + i * s.n + j);
    const float px = weight * node.x, py = weight * node.y;
    v.x += px;
    v.y += py;
    aBar.x += px * dx;
    aBar.y += px * dy;
    aBar.z += py * dx;
    aBar.w += py * dy;
    const float whole = node.x * (p.v.x + a.x * dx + a.y * dy) +
                        node.y * (p.v.y + a.z * dx + a.w * dy) + node.z;
    weightBar[0][i] += whole * support.weight[1][j];
    weightBar[1][j] += whole * support.weight[0][i];
    fx.x -= (px * a.x + py * a.z) * s.dx;
    fx.y -= (px * a.y + py * a.w) * s.dx;
  }
  const Pair more = support.positionBar(weightBar);
  bar.x.x += (fx.x + more.x) * s.inverseDx;
  bar.x.y += (fx.y + more.y) * s.inverseDx;
  bar.v = v;
  Quad g = bar.f;
  Quad c = affineBar(s, f, aBar, g);
  // f = (1 + dt C) F.
  c.x += s.dt * (g.x * p.f.x + g.y * p.f.y);
  c.y += s.dt * (g.x * p.f.z + g.y * p.f.w);
  c.z += s.dt * (g.z * p.f.x + g.w * p.f.y);
  c.w += s.dt * (g.z * p.f.z + g.w * p.f.w);
  bar.c = c;
  bar.f = {g.x + s.dt * (p.c.x * g.x + p.c.z * g.z),
           g.y + s.dt * (p.c.x * g.y + p.c.z * g.w),
           g.z + s.dt * (p.c.y * g.x + p.c.w * g.z),
           g.w + s.dt * (p.c.y * g.y + p.c.w * g.w)};
}

//===----------------------------------------------------------------------===//
// Bodies of kernels, one particle or node each
//===----------------------------------------------------------------------===//

TAI_BOTH Particle load(const Mpm &s, int t, int p) {
  const int at = t * s.count + p;
  return {s.x[at], s.v[at], s.c[at], s.f[at]};
}

template <bool Whole> TAI_BOTH void scatterBody(const Mpm &s, int t, int p) {
  const Particle particle = load(s, t, p);
  s.f[(t + 1) * s.count + p] =
      scatterTo<Whole>(s, particle, s.grid + size_t(t) * size_t(s.nodes()));
}

TAI_BOTH void gridBody(const Mpm &s, int t, int node) {
  const size_t at = size_t(t) * size_t(s.nodes()) + size_t(node);
  s.velocity[at] = nodeVelocity(s, s.grid[at], node / s.n, node % s.n);
}

TAI_BOTH void storeGathered(const Mpm &s, int t, int p, const Particle &own) {
  const int at = t * s.count + p;
  s.x[at] = own.x;
  s.v[at] = own.v;
  s.c[at] = own.c;
}

TAI_BOTH void gatherBody(const Mpm &s, int t, int p) {
  Particle particle = {s.x[t * s.count + p], {}, {}, {}};
  const Pair *velocity = s.velocity + size_t(t) * size_t(s.nodes());
  gather(s, particle, [&](int node) { return velocity[node]; });
  storeGathered(s, t + 1, p, particle);
}

/// Distance of a particle at the end to the goal, and its adjoint.
TAI_BOTH float lossBody(const Mpm &s, int p) {
  const Pair x = s.x[(s.slots - 1) * s.count + p];
  const float dx = x.x - s.goalX, dy = x.y - s.goalY;
  const float share = 1.0f / float(s.count);
  s.xBar[p] = {share * dx, share * dy};
  s.vBar[p] = {0.0f, 0.0f};
  s.cBar[p] = s.fBar[p] = {0.0f, 0.0f, 0.0f, 0.0f};
  return 0.5f * share * (dx * dx + dy * dy);
}

TAI_BOTH void gatherBarBody(const Mpm &s, int t, int p) {
  Particle bar = {s.xBar[p], s.vBar[p], s.cBar[p], {}};
  const size_t first = size_t(t) * size_t(s.nodes());
  const Pair *velocity = s.velocity + first;
  gatherBar(
      s, s.x[t * s.count + p], bar, [&](int node) { return velocity[node]; },
      AddPair{s.velocityBar + first, s.n});
  s.xBar[p] = bar.x;
}

TAI_BOTH void gridBarBody(const Mpm &s, int t, int node) {
  const size_t at = size_t(t) * size_t(s.nodes()) + size_t(node);
  s.gridBar[node] =
      nodeBar(s, s.grid[at], s.velocityBar[at], node / s.n, node % s.n);
}

TAI_BOTH void storeBar(const Mpm &s, int p, const Particle &bar) {
  s.xBar[p] = bar.x;
  s.vBar[p] = bar.v;
  s.cBar[p] = bar.c;
  s.fBar[p] = bar.f;
}

TAI_BOTH void scatterBarBody(const Mpm &s, int t, int p) {
  Particle bar = {s.xBar[p], s.vBar[p], s.cBar[p], s.fBar[p]};
  scatterBar(s, load(s, t, p), bar, [&](int node) { return s.gridBar[node]; });
  storeBar(s, p, bar);
}

//===----------------------------------------------------------------------===//
// The same with the grid's part done where its values are used: one dependence
// over particles per step in each direction
//===----------------------------------------------------------------------===//

/// Gathers slot t from the grid of step t - 1, then scatters it to that of t.
TAI_BOTH void fusedForward(const Mpm &s, int t, int p, Particle &own) {
  if (t > 0) {
    const Quad *grid = s.grid + size_t(t - 1) * size_t(s.nodes());
    gather(s, own, [&](int node) {
      return nodeVelocity(s, grid[node], node / s.n, node % s.n);
    });
    storeGathered(s, t, p, own);
  }
  if (t < s.slots - 1) {
    own.f = scatterTo<true>(s, own, s.grid + size_t(t) * size_t(s.nodes()));
    s.f[(t + 1) * s.count + p] = own.f;
  }
}

/// The reverse of that: from the nodes of step t, then to those of t - 1.
TAI_BOTH void fusedBackward(const Mpm &s, int t, int p, Particle &bar) {
  const Particle own = load(s, t, p);
  if (t < s.slots - 1) {
    const size_t first = size_t(t) * size_t(s.nodes());
    scatterBar(s, own, bar, [&](int node) {
      return nodeBar(s, s.grid[first + size_t(node)],
                     s.velocityBar[first + size_t(node)], node / s.n,
                     node % s.n);
    });
  }
  if (t > 0) {
    const size_t first = size_t(t - 1) * size_t(s.nodes());
    gatherBar(
        s, s.x[(t - 1) * s.count + p], bar,
        [&](int node) {
          return nodeVelocity(s, s.grid[first + size_t(node)], node / s.n,
                              node % s.n);
        },
        AddPair{s.velocityBar + first, s.n});
  }
}

//===----------------------------------------------------------------------===//
// Scatters of a block of particles, added up in shared memory first: particles
// that follow one another are near one another, and meet on the same nodes
//===----------------------------------------------------------------------===//

constexpr int windowNodes = 3072;

/// Memory that the threads of a block share: the nodes around its particles,
/// where they are few enough.
template <int components> struct Window {
  int low[2], high[2];
  float values[components][windowNodes];

  TAI_BOTH int columns() const { return high[1] - low[1] + 3; }
  TAI_BOTH int count() const { return (high[0] - low[0] + 3) * columns(); }
  TAI_BOTH bool fits() const { return count() <= windowNodes; }
  TAI_BOTH int at(const Support &support, int i, int j) const {
    return (support.base[0] - low[0] + i) * columns() + support.base[1] -
           low[1] + j;
  }
  /// Number in the grid of a node of the window.
  TAI_BOTH int node(int k, int n) const {
    return (low[0] + k / columns()) * n + low[1] + k % columns();
  }
};

/// Lowers `p` to the least value of the threads; one of a warp's threads writes
/// for all.
TAI_BOTH void lower(int *p, int v) {
#ifdef __CUDA_ARCH__
  const unsigned active = __activemask();
  const int least = __reduce_min_sync(active, v);
  if (int(threadIdx.x % 32) == __ffs(int(active)) - 1)
    atomicMin(p, least);
#else
  *p = v < *p ? v : *p;
#endif
}

TAI_BOTH void raise(int *p, int v) {
#ifdef __CUDA_ARCH__
  const unsigned active = __activemask();
  const int most = __reduce_max_sync(active, v);
  if (int(threadIdx.x % 32) == __ffs(int(active)) - 1)
    atomicMax(p, most);
#else
  *p = v > *p ? v : *p;
#endif
}

/// Finds the window of particles `first` to `first + count` and clears it.
template <int components>
TAI_BOTH void openWindow(const Mpm &s, int t, int first, int count,
                         Window<components> &window) {
  forEach(2, [&](int axis) {
    window.low[axis] = s.n;
    window.high[axis] = 0;
  });
  blockSync();
  forEach(count, [&](int k) {
    const Support support(s, s.x[t * s.count + first + k]);
    for (int axis = 0; axis < 2; ++axis) {
      lower(&window.low[axis], support.base[axis]);
      raise(&window.high[axis], support.base[axis]);
    }
  });
  blockSync();
  if (window.fits())
    forEach(window.count(), [&](int k) {
      for (int c = 0; c < components; ++c)
        window.values[c][k] = 0.0f;
    });
  blockSync();
}

TAI_BOTH void scatterBlock(const Mpm &s, int t, int first, int count,
                           Window<3> &window) {
  openWindow(s, t, first, count, window);
  Quad *grid = s.grid + size_t(t) * size_t(s.nodes());
  if (!window.fits()) {
    forEach(count, [&](int k) { scatterBody<true>(s, t, first + k); });
    return;
  }
  forEach(count, [&](int k) {
    s.f[(t + 1) * s.count + first + k] =
        scatter(s, load(s, t, first + k),
                [&](const Support &support, int i, int j, Quad value) {
                  const int at = window.at(support, i, j);
                  addTo(&window.values[0][at], value.x);
                  addTo(&window.values[1][at], value.y);
                  addTo(&window.values[2][at], value.z);
                });
  });
  blockSync();
  forEach(window.count(), [&](int k) {
    if (window.values[2][k] != 0.0f)
      addTo(grid + window.node(k, s.n),
            Quad{window.values[0][k], window.values[1][k], window.values[2][k],
                 0.0f});
  });
}

TAI_BOTH void gatherBarBlock(const Mpm &s, int t, int first, int count,
                             Window<2> &window) {
  openWindow(s, t, first, count, window);
  if (!window.fits()) {
    forEach(count, [&](int k) { gatherBarBody(s, t, first + k); });
    return;
  }
  const size_t nodes = size_t(t) * size_t(s.nodes());
  const Pair *velocity = s.velocity + nodes;
  forEach(count, [&](int k) {
    const int p = first + k;
    Particle bar = {s.xBar[p], s.vBar[p], s.cBar[p], {}};
    gatherBar(
        s, s.x[t * s.count + p], bar, [&](int node) { return velocity[node]; },
        [&](const Support &support, int i, int j, Pair value) {
          const int at = window.at(support, i, j);
          addTo(&window.values[0][at], value.x);
          addTo(&window.values[1][at], value.y);
        });
    s.xBar[p] = bar.x;
  });
  blockSync();
  forEach(window.count(), [&](int k) {
    const Pair value = {window.values[0][k], window.values[1][k]};
    if (value.x != 0.0f || value.y != 0.0f)
      addTo(s.velocityBar + nodes + window.node(k, s.n), value);
  });
}

//===----------------------------------------------------------------------===//
// The scene
//===----------------------------------------------------------------------===//

/// A block of side * side particles on a grid of n * n nodes. The time step
/// shrinks with the cells, so that a larger scene is no less stable.
inline Mpm makeMpm(int n, int side, int slots) {
  Mpm s = {};
  s.n = n;
  s.count = side * side;
  s.slots = slots;
  s.dt = float(3e-4 * 128.0 / n);
  s.dx = float(1.0 / n);
  s.inverseDx = float(n);
  s.mu = s.lambda = 100.0f;
  s.gravity = 9.8f;
  s.goalX = 0.3f;
  s.goalY = 0.6f;
  return s;
}

inline std::vector<Particle> initialParticles(const Mpm &s, int side) {
  std::vector<Particle> result;
  const double dx = 1.0 / s.n;
  for (int i = 0; i < side; ++i)
    for (int j = 0; j < side; ++j) {
      const double x = dx * (0.5 * i + 10.0), y = dx * (0.5 * j + 25.0);
      const double vx = 0.5 + 0.8 * std::sin(9.0 * y) * std::cos(5.0 * x),
                   vy = 0.3 * std::cos(7.0 * x) - 0.4 * std::sin(4.0 * y);
      result.push_back({{float(x), float(y)},
                        {float(vx), float(vy)},
                        {0.0f, 0.0f, 0.0f, 0.0f},
                        {1.0f, 0.0f, 0.0f, 1.0f}});
    }
  return result;
}

} // namespace tai::floor

#endif // TAI_BENCHMARKS_FLOOR_CUDA_MPM_H
