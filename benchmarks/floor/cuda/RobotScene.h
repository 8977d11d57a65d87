//===- RobotScene.h - the robot's body and its weights ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The same body and the same first weights as in test/python/reference.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_BENCHMARKS_FLOOR_CUDA_ROBOTSCENE_H
#define TAI_BENCHMARKS_FLOOR_CUDA_ROBOTSCENE_H

#include "Robot.h"
#include <random>
#include <sstream>

namespace tai::floor {

/// Normal numbers as NumPy's legacy generator draws them.
class LegacyNormal {
public:
  explicit LegacyNormal(unsigned seed) : generator_(seed) {}

  double operator()() {
    if (hasSpare_) {
      hasSpare_ = false;
      return spare_;
    }
    double a, b, radius;
    do {
      a = 2.0 * uniform() - 1.0;
      b = 2.0 * uniform() - 1.0;
      radius = a * a + b * b;
    } while (radius >= 1.0 || radius == 0.0);
    const double factor = std::sqrt(-2.0 * std::log(radius) / radius);
    spare_ = factor * a;
    hasSpare_ = true;
    return factor * b;
  }

private:
  double uniform() {
    const unsigned long high = generator_() >> 5, low = generator_() >> 6;
    return (double(high) * 67108864.0 + double(low)) / 9007199254740992.0;
  }

  std::mt19937 generator_;
  bool hasSpare_ = false;
  double spare_ = 0;
};

struct RobotScene {
  std::vector<Pair> start;
  std::vector<int> first, second, incidentStart, incident;
  std::vector<float> rest, stiffness, amount, w1, b1, w2, b2, sines;

  RobotScene() {
    std::vector<double> x, y;
    std::istringstream pointText(
        ".2,.1 .2,.15 .25,.1 .25,.15 .1,.1 .1,.15 .15,.1 .15,.15 .1,.2 .15,.2 "
        ".1,.25 .15,.25 .2,.2 .2,.25 .25,.2 .25,.25 .2,.3 .25,.3 .2,.35 "
        ".25,.35 .3,.15 .3,.2 .3,.1 .35,.1 .35,.15 .35,.2");
    std::string word;
    while (pointText >> word) {
      const size_t comma = word.find(',');
      x.push_back(std::stod(word.substr(0, comma)));
      y.push_back(std::stod(word.substr(comma + 1)));
      start.push_back({float(x.back()), float(y.back())});
    }
    std::istringstream springText(
        "0-1* 2-3* 0-2 0-3 1-2 1-3 4-5* 6-7* 4-6 4-7 5-6 5-7 5-8* 7-9* 5-9 8-7 "
        "8-9 8-10 9-11 8-11 10-9 10-11 12-13 9-12 9-13 11-12 11-13 1-12* 3-14* "
        "1-14 12-3 12-14 14-15 12-15 13-14 13-15 13-16 15-17 13-17 16-15 16-17 "
        "16-18 17-19 16-19 18-17 18-19 20-21 3-20 3-21 14-20 14-21 22-20* "
        "23-24* 22-23 22-24 20-23 20-24 24-25* 20-25 21-24 21-25");
    while (springText >> word) {
      const size_t dash = word.find('-');
      const int a = std::stoi(word), b = std::stoi(word.substr(dash + 1));
      first.push_back(a);
      second.push_back(b);
      rest.push_back(float(std::hypot(x[size_t(a)] - x[size_t(b)],
                                      y[size_t(a)] - y[size_t(b)])));
      stiffness.push_back(30000.0f);
      amount.push_back(word.back() == '*' ? 0.15f : 0.0f);
    }
    for (int point = 0; point < points; ++point) {
      incidentStart.push_back(int(incident.size()));
      for (int spring = 0; spring < springs; ++spring) {
        if (first[size_t(spring)] == point)
          incident.push_back(2 * spring);
        if (second[size_t(spring)] == point)
          incident.push_back(2 * spring + 1);
      }
    }
    incidentStart.push_back(int(incident.size()));

    LegacyNormal draw(0);
    for (int k = 0; k < hiddenCount * inputs; ++k)
      w1.push_back(
          float(draw() * 2.0 * std::sqrt(2.0 / (hiddenCount + inputs))));
    for (int k = 0; k < springs * hiddenCount; ++k)
      w2.push_back(
          float(draw() * 3.0 * std::sqrt(2.0 / (hiddenCount + springs))));
    b1.assign(hiddenCount, 0.0f);
    b2.assign(springs, 0.0f);
    sines.assign(size_t(robotSlots) * waves, 0.0f);
  }

  /// The scene's numbers; addresses are the caller's.
  static Robot settings() {
    Robot r = {};
    const double dt = 0.004;
    r.dt = float(dt);
    r.gravity = -4.8f;
    r.ground = 0.1f;
    r.damp = float(std::exp(-15.0 * dt));
    r.goalX = 0.9f;
    r.goalY = 0.2f;
    return r;
  }
};

} // namespace tai::floor

#endif // TAI_BENCHMARKS_FLOOR_CUDA_ROBOTSCENE_H
