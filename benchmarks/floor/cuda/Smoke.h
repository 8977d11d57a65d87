//===- Smoke.h - bodies of the smoke kernels -------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A step advects the velocity, relaxes the pressure, takes the gradient of the
// last but one sweep of the step before off the velocity, and advects the
// density with it. The reverse sweep needs velocity and density of every slot;
// the pressure enters linearly, so only as many sweeps are kept as are read
// again. Its adjoints are gathered, only those of the advections are scattered.
//
// The second half has the same as one piece per step: a tile with as many cells
// around it as the sweeps reach, in shared memory. Within a step nothing then
// passes between tiles.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_BENCHMARKS_FLOOR_CUDA_SMOKE_H
#define TAI_BENCHMARKS_FLOOR_CUDA_SMOKE_H

#include "Common.h"

namespace tai::floor {

constexpr int side = 110, cells = side * side, smokeSlots = 100, sweeps = 6;
/// Sweep k is in plane k % ring. Within a step the sweeps 6 t - 1 to 6 t + 6
/// are alive.
constexpr int ring = 8;

struct Smoke {
  Pair *v;        // [slots][cells]
  float *density; // [slots][cells]
  float *target;  // [cells]
  Pair *star;     // [cells]
  float *divergence;
  float *pressure; // [ring][cells]

  Pair *vBar;        // [slots][cells], zero at the start
  float *densityBar; // [slots][cells], zero at the start
  Pair *starBar;     // [cells]
  float *divergenceBar;
  float *pressureBar; // [ring][cells], zero at the start

  float *loss;

  TAI_BOTH float *sweep(int k) const { return pressure + k % ring * cells; }
  TAI_BOTH float *sweepBar(int k) const {
    return pressureBar + k % ring * cells;
  }
};

/// Index in the periodic grid, of one that is off by less than its side.
TAI_BOTH int wrapped(int a) {
  return a < 0 ? a + side : a >= side ? a - side : a;
}

/// Cell number and its four neighbours.
struct Neighbours {
  int own, up, down, left, right;

  TAI_BOTH explicit Neighbours(int cell) {
    const int i = cell / side, j = cell % side;
    own = cell;
    up = wrapped(i - 1) * side + j;
    down = wrapped(i + 1) * side + j;
    left = i * side + wrapped(j - 1);
    right = i * side + wrapped(j + 1);
  }
};

/// Where a bilinear sample is taken: (i, j) - w.
struct Sample {
  int at[4];
  float fx, fy;

  TAI_BOTH Sample(int cell, Pair w) {
    const float x = float(cell / side) - w.x, y = float(cell % side) - w.y;
    const float left = floorf(x), low = floorf(y);
    fx = x - left;
    fy = y - low;
    const int ax = wrapped(int(left)), ay = wrapped(int(low));
    const int bx = wrapped(ax + 1), by = wrapped(ay + 1);
    at[0] = ax * side + ay;
    at[1] = ax * side + by;
    at[2] = bx * side + ay;
    at[3] = bx * side + by;
  }

  TAI_BOTH float value(float a, float b, float c, float d) const {
    return (1.0f - fx) * ((1.0f - fy) * a + fy * b) +
           fx * ((1.0f - fy) * c + fy * d);
  }

  /// Derivative of that with respect to w, times `bar`.
  TAI_BOTH Pair shift(float a, float b, float c, float d, float bar) const {
    return {bar * ((1.0f - fy) * (a - c) + fy * (b - d)),
            bar * ((1.0f - fx) * (a - b) + fx * (c - d))};
  }

  TAI_BOTH float weight(int corner) const {
    return (corner & 2 ? fx : 1.0f - fx) * (corner & 1 ? fy : 1.0f - fy);
  }
};

TAI_BOTH Pair sampled(const Pair *f, const Sample &s) {
  const Pair a = f[s.at[0]], b = f[s.at[1]], c = f[s.at[2]], d = f[s.at[3]];
  return {s.value(a.x, b.x, c.x, d.x), s.value(a.y, b.y, c.y, d.y)};
}

TAI_BOTH float sampled(const float *f, const Sample &s) {
  return s.value(f[s.at[0]], f[s.at[1]], f[s.at[2]], f[s.at[3]]);
}

constexpr float dx = float(1.0 / side), halfSlope = float(0.5 * side);

//===----------------------------------------------------------------------===//
// One kernel per operation
//===----------------------------------------------------------------------===//

TAI_BOTH void advectVelocity(const Smoke &s, int t, int cell) {
  const Pair *v = s.v + (t - 1) * cells;
  s.star[cell] = sampled(v, Sample(cell, v[cell]));
}

TAI_BOTH void diverge(const Smoke &s, int cell) {
  const Neighbours n(cell);
  s.divergence[cell] = -0.5f * dx *
                       (s.star[n.down].x - s.star[n.up].x + s.star[n.right].y -
                        s.star[n.left].y);
}

TAI_BOTH void relax(const Smoke &s, int k, int cell) {
  const Neighbours n(cell);
  const float *p = s.sweep(k);
  s.sweep(k + 1)[cell] = 0.25f * (s.divergence[cell] + p[n.up] + p[n.down] +
                                  p[n.left] + p[n.right]);
}

TAI_BOTH Pair projected(const float *p, Pair star, int cell) {
  const Neighbours n(cell);
  return {star.x - halfSlope * (p[n.down] - p[n.up]),
          star.y - halfSlope * (p[n.right] - p[n.left])};
}

TAI_BOTH void project(const Smoke &s, int t, int cell) {
  s.v[t * cells + cell] =
      projected(s.sweep(t * sweeps - 1), s.star[cell], cell);
}

TAI_BOTH void advectDensity(const Smoke &s, int t, int cell) {
  s.density[t * cells + cell] =
      sampled(s.density + (t - 1) * cells, Sample(cell, s.v[t * cells + cell]));
}

/// Square of a cell's difference to the target; starts the adjoint.
TAI_BOTH float lossBody(const Smoke &s, int cell) {
  const int at = (smokeSlots - 1) * cells + cell;
  const float off = s.target[cell] - s.density[at];
  s.densityBar[at] = -2.0f / cells * off;
  return off * off / cells;
}

TAI_BOTH void densityBarBody(const Smoke &s, int t, int cell) {
  const int now = t * cells + cell, before = (t - 1) * cells;
  const float bar = s.densityBar[now];
  const float *f = s.density + before;
  const Sample at(cell, s.v[now]);
  const Pair shift =
      at.shift(f[at.at[0]], f[at.at[1]], f[at.at[2]], f[at.at[3]], bar);
  TAI_UNROLL
  for (int corner = 0; corner < 4; ++corner)
    addTo(s.densityBar + before + at.at[corner], at.weight(corner) * bar);
  s.vBar[now] = {s.vBar[now].x + shift.x, s.vBar[now].y + shift.y};
}

/// The adjoint of the last but one sweep of the step before t, from the
/// velocity.
TAI_BOTH void projectBar(const Smoke &s, int t, int cell) {
  const Neighbours n(cell);
  const Pair *v = s.vBar + t * cells;
  s.sweepBar(t * sweeps - 1)[cell] =
      halfSlope * (v[n.down].x - v[n.up].x + v[n.right].y - v[n.left].y);
}

TAI_BOTH void relaxBar(const Smoke &s, int k, int cell) {
  const Neighbours n(cell);
  const float *p = s.sweepBar(k + 1);
  const float around = 0.25f * (p[n.up] + p[n.down] + p[n.left] + p[n.right]);
  const float own = 0.25f * p[cell];
  float *to = s.sweepBar(k) + cell;
  // The last but one sweep of a step has its part of the velocity already; it
  // is the first that the reverse sweep of the step comes to.
  const bool first = k % sweeps == sweeps - 1;
  *to = first ? *to + around : around;
  s.divergenceBar[cell] = first ? own : s.divergenceBar[cell] + own;
}

TAI_BOTH void divergeBar(const Smoke &s, int t, int cell) {
  const Neighbours n(cell);
  const float *d = s.divergenceBar;
  const Pair v = s.vBar[t * cells + cell];
  s.starBar[cell] = {v.x + 0.5f * dx * (d[n.down] - d[n.up]),
                     v.y + 0.5f * dx * (d[n.right] - d[n.left])};
}

/// Adjoint of a cell's advected velocity, to slot t - 1.
TAI_BOTH void scatterVelocity(const Smoke &s, int t, int cell, Pair bar) {
  const Pair *v = s.v + (t - 1) * cells;
  Pair *to = s.vBar + (t - 1) * cells;
  const Sample at(cell, v[cell]);
  const Pair a = v[at.at[0]], b = v[at.at[1]], c = v[at.at[2]], d = v[at.at[3]];
  const Pair x = at.shift(a.x, b.x, c.x, d.x, bar.x),
             y = at.shift(a.y, b.y, c.y, d.y, bar.y);
  TAI_UNROLL
  for (int corner = 0; corner < 4; ++corner) {
    const float weight = at.weight(corner);
    addTo(to + at.at[corner], Pair{weight * bar.x, weight * bar.y});
  }
  addTo(to + cell, Pair{x.x + y.x, x.y + y.y});
}

TAI_BOTH void advectVelocityBar(const Smoke &s, int t, int cell) {
  scatterVelocity(s, t, cell, s.starBar[cell]);
}

//===----------------------------------------------------------------------===//
// One tile per block and step
//===----------------------------------------------------------------------===//

constexpr int tileRows = 11, tileColumns = 10, reach = sweeps;
constexpr int tilesAcross = side / tileColumns;
constexpr int tiles = (side / tileRows) * tilesAcross;
constexpr int frameRows = tileRows + 2 * reach,
              frameColumns = tileColumns + 2 * reach,
              frameCells = frameRows * frameColumns;
static_assert(side % tileRows == 0 && side % tileColumns == 0);

/// Memory that the threads of a block share.
struct TileMemory {
  Pair vectors[frameCells];
  float source[frameCells];
  float planes[2][frameCells];
};

/// A cell of the tile with `radius` cells around it.
struct TileCell {
  int row, column;

  TAI_BOTH TileCell(int k, int radius) {
    const int width = tileColumns + 2 * radius;
    row = k / width - radius;
    column = k % width - radius;
  }
  TAI_BOTH static int count(int radius) {
    return (tileRows + 2 * radius) * (tileColumns + 2 * radius);
  }
  /// Where it is in shared memory.
  TAI_BOTH int local() const {
    return (row + reach) * frameColumns + column + reach;
  }
  TAI_BOTH bool within() const {
    return row >= 0 && row < tileRows && column >= 0 && column < tileColumns;
  }
  TAI_BOTH int cell(int tile) const {
    return wrapped(tile / tilesAcross * tileRows + row) * side +
           wrapped(tile % tilesAcross * tileColumns + column);
  }
};

TAI_BOTH float around(const float *plane, int at) {
  return plane[at - frameColumns] + plane[at + frameColumns] + plane[at - 1] +
         plane[at + 1];
}

/// Planes of the last and the last but one sweep of step t.
TAI_BOTH float *lastSweep(float *planes, int t) {
  return planes + (t % 2) * cells;
}
TAI_BOTH float *lastButOne(float *planes, int t) {
  return planes + (2 + t % 2) * cells;
}

TAI_BOTH void forwardTile(const Smoke &s, int t, int tile, TileMemory &m) {
  const Pair *before = s.v + (t - 1) * cells;
  const float *start = lastSweep(s.pressure, t - 1);
  const float *lagged = lastButOne(s.pressure, t - 1);
  forEach(frameCells, [&](int k) {
    const TileCell c(k, reach);
    const int cell = c.cell(tile);
    const Pair star = sampled(before, Sample(cell, before[cell]));
    m.vectors[k] = star;
    m.planes[0][k] = start[cell];
    if (c.within()) {
      const Pair v = projected(lagged, star, cell);
      s.v[t * cells + cell] = v;
      s.density[t * cells + cell] =
          sampled(s.density + (t - 1) * cells, Sample(cell, v));
    }
  });
  blockSync();
  forEach(TileCell::count(reach - 1), [&](int k) {
    const int at = TileCell(k, reach - 1).local();
    m.source[at] =
        -0.5f * dx *
        (m.vectors[at + frameColumns].x - m.vectors[at - frameColumns].x +
         m.vectors[at + 1].y - m.vectors[at - 1].y);
  });
  // Each thread reads its own elements of `source`: the cells are numbered by
  // the same radius in the first sweep, and by others later.
  blockSync();
  TAI_UNROLL
  for (int sweep = 1; sweep <= sweeps; ++sweep) {
    const float *from = m.planes[(sweep + 1) % 2];
    float *to = m.planes[sweep % 2];
    float *out = sweep == sweeps       ? lastSweep(s.pressure, t)
                 : sweep == sweeps - 1 ? lastButOne(s.pressure, t)
                                       : nullptr;
    forEach(TileCell::count(sweeps - sweep), [&](int k) {
      const TileCell c(k, sweeps - sweep);
      const int at = c.local();
      const float p = 0.25f * (m.source[at] + around(from, at));
      to[at] = p;
      if (out && c.within())
        out[c.cell(tile)] = p;
    });
    blockSync();
  }
}

TAI_BOTH void backwardTile(const Smoke &s, int t, int tile, TileMemory &m) {
  const float *last = lastSweep(s.pressureBar, t);
  const float *lagged = lastButOne(s.pressureBar, t);
  const int now = t * cells, before = (t - 1) * cells;
  forEach(frameCells,
          [&](int k) { m.planes[0][k] = last[TileCell(k, reach).cell(tile)]; });
  // The part from the density completes the velocity's adjoint.
  forEach(TileCell::count(1), [&](int k) {
    const TileCell c(k, 1);
    const int cell = c.cell(tile);
    const float bar = s.densityBar[now + cell];
    const float *f = s.density + before;
    const Sample at(cell, s.v[now + cell]);
    const Pair shift =
        at.shift(f[at.at[0]], f[at.at[1]], f[at.at[2]], f[at.at[3]], bar);
    const Pair v = s.vBar[now + cell];
    m.vectors[c.local()] = {v.x + shift.x, v.y + shift.y};
    if (c.within())
      TAI_UNROLL
    for (int corner = 0; corner < 4; ++corner)
      addTo(s.densityBar + before + at.at[corner], at.weight(corner) * bar);
  });
  blockSync();
  // Plane `sweep % 2` holds the adjoint of sweep number sweeps - sweep.
  TAI_UNROLL
  for (int sweep = 1; sweep <= sweeps; ++sweep) {
    const float *from = m.planes[(sweep + 1) % 2];
    float *to = m.planes[sweep % 2];
    forEach(TileCell::count(sweeps - sweep), [&](int k) {
      const TileCell c(k, sweeps - sweep);
      const int at = c.local();
      float p = 0.25f * around(from, at);
      if (sweep == 1)
        p += lagged[c.cell(tile)];
      to[at] = p;
      if (sweep == sweeps)
        lastSweep(s.pressureBar, t - 1)[c.cell(tile)] = p;
    });
    // The sum of all sweeps is wanted one cell around the tile.
    forEach(TileCell::count(1), [&](int k) {
      const int at = TileCell(k, 1).local();
      const float part = 0.25f * from[at];
      m.source[at] = sweep == 1 ? part : m.source[at] + part;
    });
    blockSync();
  }
  forEach(TileCell::count(0), [&](int k) {
    const TileCell c(k, 0);
    const int at = c.local(), cell = c.cell(tile);
    const Pair *v = m.vectors;
    lastButOne(s.pressureBar, t - 1)[cell] =
        halfSlope * (v[at + frameColumns].x - v[at - frameColumns].x +
                     v[at + 1].y - v[at - 1].y);
    const float *d = m.source;
    scatterVelocity(
        s, t, cell,
        {v[at].x + 0.5f * dx * (d[at + frameColumns] - d[at - frameColumns]),
         v[at].y + 0.5f * dx * (d[at + 1] - d[at - 1])});
  });
  blockSync();
}

//===----------------------------------------------------------------------===//
// The scene
//===----------------------------------------------------------------------===//

/// The yin-yang symbol, 0 or 1.
inline float symbol(int row, int column) {
  const double u = (column + 0.5) / side - 0.5, w = (row + 0.5) / side - 0.5;
  const double rho2 = u * u + w * w;
  const double upper = u * u + (w + 0.235) * (w + 0.235);
  const double lower = u * u + (w - 0.235) * (w - 0.235);
  if (rho2 > 0.25)
    return 1;
  if (rho2 >= 0.47 * 0.47)
    return 0;
  if (upper < 0.07 * 0.07)
    return 0;
  if (lower < 0.07 * 0.07)
    return 1;
  if (upper < 0.235 * 0.235)
    return 1;
  if (lower < 0.235 * 0.235)
    return 0;
  return u > 0 ? 0 : 1;
}

struct SmokeStart {
  std::vector<Pair> v;
  std::vector<float> density, target;

  SmokeStart() {
    const double turn = 2.0 * 3.14159265358979323846 / side;
    for (int row = 0; row < side; ++row)
      for (int column = 0; column < side; ++column) {
        const double i = turn * row, j = turn * column;
        v.push_back({float(0.6 * std::sin(j) + 0.25 * std::cos(i + 2.0 * j)),
                     float(0.5 * std::cos(i) - 0.2 * std::sin(2.0 * i + j))});
        density.push_back(row / 10 % 4 == 1 ? 1.0f : 0.0f);
        target.push_back(symbol(row, column));
      }
  }
};

} // namespace tai::floor

#endif // TAI_BENCHMARKS_FLOOR_CUDA_SMOKE_H
