//===- Robot.h - phases of the mass-spring robot ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A robot of 26 points and 61 springs whose controller reads the points and
// drives the springs, for 2048 slots. It is far too small for more than one
// block: everything that a step hands to the next is in shared memory, weights
// and their adjoints are in registers, spread over the threads. Springs add to
// points in the order of the points' lists, so the sums are the same each time.
//
// A phase is the work of threads between two barriers. If a phase ends in a sum
// over neighbouring threads it has two parts: the contribution of a thread, and
// the use of the sum. On the CPU a loop over threads runs each part.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_BENCHMARKS_FLOOR_CUDA_ROBOT_H
#define TAI_BENCHMARKS_FLOOR_CUDA_ROBOT_H

#include "Common.h"

namespace tai::floor {

constexpr int points = 26, springs = 61, hiddenCount = 32, waves = 10;
constexpr int inputs = waves + 4 * points + 2;
constexpr int robotSlots = 2048;
constexpr int robotThreads = 256;

// Layer 1: 8 threads for each of 32 rows, 15 inputs at most for each. Layer 2:
// 4 for each of 61 rows, 8 inputs for each. Backwards: 8 threads for each
// hidden value, 8 springs for each; 2 for each input, 16 hidden values for
// each.
constexpr int lanes1 = 8, own1 = (inputs + lanes1 - 1) / lanes1;
constexpr int lanes2 = 4, own2 = hiddenCount / lanes2;
constexpr int lanes3 = 8, own3 = (springs + lanes3 - 1) / lanes3;
constexpr int lanes4 = 2, own4 = hiddenCount / lanes4;
static_assert(hiddenCount * lanes1 <= robotThreads);
static_assert(springs * lanes2 <= robotThreads);
static_assert(inputs * lanes4 <= robotThreads);

struct Robot {
  float dt, gravity, ground, damp, goalX, goalY;
  const Pair *start;         // [points]
  const int *first, *second; // [springs]
  const float *rest, *stiffness, *amount;
  // The springs at each point: 2 * spring + 1 where it is the second end.
  const int *incidentStart, *incident;
  const float *w1, *b1, *w2, *b2; // [hidden][inputs], [springs][hidden]
  /// sin(10 t dt + 2 pi k / waves), [slots][waves].
  float *sines;
  // Stored by the forward pass, [slots].
  Pair *x, *v, *free;     // [points]
  float *hidden, *output; // [hidden], [springs]
  // Adjoints of the weights, in one piece: w1, b1, w2, b2.
  float *bars;
  float *loss;
};

/// Memory that the threads share.
struct RobotMemory {
  Pair x[points], v[points], free[points];
  Pair centre;
  float hidden[hiddenCount], output[springs];
  Pair impulse[springs];
  // The reverse sweep's.
  Pair xBar[points], vBar[points], freeBar[points];
  Pair dBar[springs];
  float zBar2[springs], zBar1[hiddenCount], inputBar[inputs];
  float seen[inputs];
  // The constants of the robot.
  int first[springs], second[springs];
  float rest[springs], stiffness[springs], amount[springs];
  int incidentStart[points + 1], incident[2 * springs];
};

/// The registers of one thread.
struct RobotThread {
  float w1[own1], w2[own2], w2Transposed[own3], w1Transposed[own4];
  float w1Bar[own1], w2Bar[own2], b1Bar, b2Bar;
  float b1, b2;
};

TAI_BOTH void loadWeights(const Robot &r, RobotThread &own, int thread) {
  const int row1 = thread / lanes1, lane1 = thread % lanes1;
  const int row2 = thread / lanes2, lane2 = thread % lanes2;
  const int row3 = thread / lanes3, lane3 = thread % lanes3;
  const int row4 = thread / lanes4, lane4 = thread % lanes4;
  TAI_UNROLL
  for (int k = 0; k < own1; ++k) {
    const int input = lane1 + k * lanes1;
    own.w1[k] = input < inputs ? r.w1[row1 * inputs + input] : 0.0f;
    own.w1Bar[k] = 0.0f;
  }
  TAI_UNROLL
  for (int k = 0; k < own2; ++k) {
    own.w2[k] =
        row2 < springs ? r.w2[row2 * hiddenCount + lane2 + k * lanes2] : 0.0f;
    own.w2Bar[k] = 0.0f;
  }
  TAI_UNROLL
  for (int k = 0; k < own3; ++k) {
    const int spring = lane3 + k * lanes3;
    own.w2Transposed[k] =
        spring < springs ? r.w2[spring * hiddenCount + row3] : 0.0f;
  }
  TAI_UNROLL
  for (int k = 0; k < own4; ++k)
    own.w1Transposed[k] =
        row4 < inputs ? r.w1[(lane4 + k * lanes4) * inputs + row4] : 0.0f;
  own.b1 = r.b1[row1];
  own.b2 = row2 < springs ? r.b2[row2] : 0.0f;
  own.b1Bar = own.b2Bar = 0.0f;
}

TAI_BOTH void loadBody(const Robot &r, RobotMemory &m, int thread) {
  if (thread < springs) {
    m.first[thread] = r.first[thread];
    m.second[thread] = r.second[thread];
    m.rest[thread] = r.rest[thread];
    m.stiffness[thread] = r.stiffness[thread];
    m.amount[thread] = r.amount[thread];
  }
  if (thread <= points)
    m.incidentStart[thread] = r.incidentStart[thread];
  if (thread < 2 * springs)
    m.incident[thread] = r.incident[thread];
  if (thread < points) {
    r.x[thread] = m.x[thread] = r.start[thread];
    r.v[thread] = m.v[thread] = {0.0f, 0.0f};
  }
}

/// An input of the controller at slot t.
TAI_BOTH float inputOf(const Robot &r, const RobotMemory &m, int t, int input) {
  if (input < waves)
    return r.sines[t * waves + input];
  const int k = input - waves;
  if (k >= 4 * points)
    return k == 4 * points ? r.goalX - m.centre.x : r.goalY - m.centre.y;
  const int point = k / 4;
  switch (k % 4) {
  case 0:
    return (m.x[point].x - m.centre.x) * 0.05f;
  case 1:
    return (m.x[point].y - m.centre.y) * 0.05f;
  case 2:
    return m.v[point].x * 0.05f;
  default:
    return m.v[point].y * 0.05f;
  }
}

/// Phase 1: the controller's inputs, one per thread.
TAI_BOTH void seePhase(const Robot &r, RobotMemory &m, int t, int thread) {
  if (thread < inputs)
    m.seen[thread] = inputOf(r, m, t, thread);
}

/// Phase 2: the hidden layer.
TAI_BOTH float layer1Part(const RobotMemory &m, const RobotThread &own,
                          int thread) {
  const int lane = thread % lanes1;
  float total = 0.0f;
  TAI_UNROLL
  for (int k = 0; k < own1; ++k) {
    const int input = lane + k * lanes1;
    if (input < inputs)
      total += own.w1[k] * m.seen[input];
  }
  return total;
}

TAI_BOTH void layer1Phase(const Robot &r, RobotMemory &m,
                          const RobotThread &own, int t, int thread,
                          float total) {
  if (thread % lanes1 != 0)
    return;
  const int row = thread / lanes1;
  const float value = tanhf(own.b1 + total);
  m.hidden[row] = value;
  r.hidden[t * hiddenCount + row] = value;
}

/// A spring at some slot: its ends' difference and what follows from it.
struct Spring {
  Pair d;
  float norm, length, wanted, factor;

  TAI_BOTH Spring(const Robot &r, const RobotMemory &m, int spring,
                  float output) {
    const Pair a = m.x[m.first[spring]], b = m.x[m.second[spring]];
    d = {a.x - b.x, a.y - b.y};
    norm = sqrtf(d.x * d.x + d.y * d.y);
    length = norm + 1e-4f;
    wanted = m.rest[spring] * (1.0f + m.amount[spring] * output);
    factor = r.dt * (length - wanted) * m.stiffness[spring] / length;
  }
};

/// Phase 3: the output layer, and the springs that it drives.
TAI_BOTH float layer2Part(const RobotMemory &m, const RobotThread &own,
                          int thread) {
  const int lane = thread % lanes2;
  float total = 0.0f;
  TAI_UNROLL
  for (int k = 0; k < own2; ++k)
    total += own.w2[k] * m.hidden[lane + k * lanes2];
  return total;
}

TAI_BOTH void layer2Phase(const Robot &r, RobotMemory &m,
                          const RobotThread &own, int t, int thread,
                          float total) {
  const int spring = thread / lanes2;
  if (thread % lanes2 != 0 || spring >= springs)
    return;
  const float value = tanhf(own.b2 + total);
  r.output[t * springs + spring] = value;
  const Spring s(r, m, spring, value);
  m.impulse[spring] = {s.factor * s.d.x, s.factor * s.d.y};
}

/// Phase 4: the points, from slot t to t + 1.
TAI_BOTH void advancePhase(const Robot &r, RobotMemory &m, int t, int thread) {
  if (thread >= points)
    return;
  const Pair x = m.x[thread], v = m.v[thread];
  Pair increment = {0.0f, 0.0f};
  for (int k = m.incidentStart[thread]; k < m.incidentStart[thread + 1]; ++k) {
    const Pair impulse = m.impulse[m.incident[k] / 2];
    const float sign = m.incident[k] % 2 ? 1.0f : -1.0f;
    increment.x += sign * impulse.x;
    increment.y += sign * impulse.y;
  }
  const Pair free = {r.damp * v.x + increment.x,
                     r.damp * v.y + r.dt * r.gravity + increment.y};
  Pair after = free;
  float toi = 0.0f;
  if (x.y + r.dt * free.y < r.ground && free.y < -1e-4f) {
    toi = -(x.y - r.ground) / free.y;
    after = {0.0f, 0.0f};
  }
  const Pair moved = {x.x + toi * free.x + (r.dt - toi) * after.x,
                      x.y + toi * free.y + (r.dt - toi) * after.y};
  m.x[thread] = moved;
  m.v[thread] = after;
  const int next = (t + 1) * points + thread;
  r.x[next] = moved;
  r.v[next] = after;
  r.free[next] = free;
}

//===----------------------------------------------------------------------===//
// The reverse of a step, from slot t + 1 to slot t
//===----------------------------------------------------------------------===//

TAI_BOTH void seedPhase(RobotMemory &m, int thread) {
  if (thread >= points)
    return;
  m.xBar[thread] = {thread == 0 ? -1.0f : 0.0f, 0.0f};
  m.vBar[thread] = {0.0f, 0.0f};
}

/// A thread's share of the stored values of slot t.
struct Stored {
  Pair x, v, free;
  float hidden, output;

  TAI_BOTH Stored(const Robot &r, int t, int thread) {
    if (thread < points) {
      x = r.x[t * points + thread];
      v = r.v[t * points + thread];
      free = r.free[(t + 1) * points + thread];
    }
    if (thread < hiddenCount)
      hidden = r.hidden[t * hiddenCount + thread];
    if (thread < springs)
      output = r.output[t * springs + thread];
  }
};

/// Phase 1: the stored values go to shared memory; the points' adjoints pass
/// the contact.
TAI_BOTH void contactPhase(const Robot &r, RobotMemory &m, const Stored &s,
                           int thread) {
  if (thread < hiddenCount)
    m.hidden[thread] = s.hidden;
  if (thread < springs)
    m.output[thread] = s.output;
  if (thread >= points)
    return;
  m.x[thread] = s.x;
  m.v[thread] = s.v;
  Pair xBar = m.xBar[thread];
  const Pair vBar = m.vBar[thread], free = s.free;
  Pair freeBar = {vBar.x + r.dt * xBar.x, vBar.y + r.dt * xBar.y};
  if (s.x.y + r.dt * free.y < r.ground && free.y < -1e-4f) {
    const float height = s.x.y - r.ground, toi = -height / free.y;
    const float toiBar = xBar.x * free.x + xBar.y * free.y;
    freeBar = {toi * xBar.x,
               toi * xBar.y + toiBar * height / (free.y * free.y)};
    xBar.y -= toiBar / free.y;
  }
  m.xBar[thread] = xBar;
  m.freeBar[thread] = freeBar;
}

/// Phase 2: springs; and the inputs again, which the weights' adjoints need.
TAI_BOTH void springBarPhase(const Robot &r, RobotMemory &m, int t,
                             int thread) {
  if (thread >= 64 && thread - 64 < inputs)
    m.seen[thread - 64] = inputOf(r, m, t, thread - 64);
  if (thread >= springs)
    return;
  const float output = m.output[thread];
  const Spring s(r, m, thread, output);
  const Pair a = m.freeBar[m.first[thread]], b = m.freeBar[m.second[thread]];
  const Pair bar = {b.x - a.x, b.y - a.y};
  const float along = bar.x * s.d.x + bar.y * s.d.y;
  const float scale = r.dt * m.stiffness[thread] / s.length;
  const float stretch =
      s.norm > 0.0f ? scale * s.wanted / s.length * along / s.norm : 0.0f;
  m.dBar[thread] = {s.factor * bar.x + stretch * s.d.x,
                    s.factor * bar.y + stretch * s.d.y};
  m.zBar2[thread] = -scale * along * m.rest[thread] * m.amount[thread] *
                    (1.0f - output * output);
}

/// Phase 3: the output layer.
TAI_BOTH float layer2BarPart(const RobotMemory &m, RobotThread &own,
                             int thread) {
  const int spring = thread / lanes2, lane2 = thread % lanes2;
  if (spring < springs) {
    const float bar = m.zBar2[spring];
    TAI_UNROLL
    for (int k = 0; k < own2; ++k)
      own.w2Bar[k] += bar * m.hidden[lane2 + k * lanes2];
    own.b2Bar += bar;
  }
  const int lane3 = thread % lanes3;
  float total = 0.0f;
  TAI_UNROLL
  for (int k = 0; k < own3; ++k) {
    const int other = lane3 + k * lanes3;
    if (other < springs)
      total += own.w2Transposed[k] * m.zBar2[other];
  }
  return total;
}

TAI_BOTH void layer2BarPhase(RobotMemory &m, int thread, float total) {
  if (thread % lanes3 != 0)
    return;
  const int row = thread / lanes3;
  m.zBar1[row] = total * (1.0f - m.hidden[row] * m.hidden[row]);
}

/// Phase 4: the hidden layer.
TAI_BOTH float layer1BarPart(const RobotMemory &m, RobotThread &own,
                             int thread) {
  const int lane1 = thread % lanes1;
  const float bar = m.zBar1[thread / lanes1];
  TAI_UNROLL
  for (int k = 0; k < own1; ++k) {
    const int input = lane1 + k * lanes1;
    if (input < inputs)
      own.w1Bar[k] += bar * m.seen[input];
  }
  own.b1Bar += bar;
  const int lane4 = thread % lanes4;
  float total = 0.0f;
  TAI_UNROLL
  for (int k = 0; k < own4; ++k)
    total += own.w1Transposed[k] * m.zBar1[lane4 + k * lanes4];
  return total;
}

TAI_BOTH void layer1BarPhase(RobotMemory &m, int thread, float total) {
  const int row = thread / lanes4;
  if (thread % lanes4 == 0 && row < inputs)
    m.inputBar[row] = total;
}

/// Phase 5: the contributions of the inputs and the springs to the points.
/// First the part of each point that the centre loses, then, with its sum, the
/// rest.
TAI_BOTH Pair centrePart(const RobotMemory &m, int thread) {
  if (thread >= points)
    return {0.0f, 0.0f};
  const float *bar = m.inputBar + waves + 4 * thread;
  return {-0.05f * bar[0], -0.05f * bar[1]};
}

TAI_BOTH void pointBarPhase(const Robot &r, RobotMemory &m, int thread,
                            Pair centre) {
  if (thread >= points)
    return;
  centre.x -= m.inputBar[inputs - 2];
  centre.y -= m.inputBar[inputs - 1];
  const float *bar = m.inputBar + waves + 4 * thread;
  Pair xBar = m.xBar[thread];
  xBar.x += 0.05f * bar[0] + centre.x / points;
  xBar.y += 0.05f * bar[1] + centre.y / points;
  for (int k = m.incidentStart[thread]; k < m.incidentStart[thread + 1]; ++k) {
    const Pair d = m.dBar[m.incident[k] / 2];
    const float sign = m.incident[k] % 2 ? -1.0f : 1.0f;
    xBar.x += sign * d.x;
    xBar.y += sign * d.y;
  }
  m.xBar[thread] = xBar;
  m.vBar[thread] = {r.damp * m.freeBar[thread].x + 0.05f * bar[2],
                    r.damp * m.freeBar[thread].y + 0.05f * bar[3]};
}

TAI_BOTH void storeBars(const Robot &r, const RobotThread &own, int thread) {
  float *w1 = r.bars, *b1 = w1 + hiddenCount * inputs, *w2 = b1 + hiddenCount,
        *b2 = w2 + springs * hiddenCount;
  const int row1 = thread / lanes1, lane1 = thread % lanes1;
  const int row2 = thread / lanes2, lane2 = thread % lanes2;
  TAI_UNROLL
  for (int k = 0; k < own1; ++k)
    if (lane1 + k * lanes1 < inputs)
      w1[row1 * inputs + lane1 + k * lanes1] = own.w1Bar[k];
  if (lane1 == 0)
    b1[row1] = own.b1Bar;
  if (row2 >= springs)
    return;
  TAI_UNROLL
  for (int k = 0; k < own2; ++k)
    w2[row2 * hiddenCount + lane2 + k * lanes2] = own.w2Bar[k];
  if (lane2 == 0)
    b2[row2] = own.b2Bar;
}

constexpr int barCount =
    hiddenCount * inputs + hiddenCount + springs * hiddenCount + springs;

} // namespace tai::floor

#endif // TAI_BENCHMARKS_FLOOR_CUDA_ROBOT_H
