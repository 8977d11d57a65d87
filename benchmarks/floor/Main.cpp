//===- Main.cpp - time the hand-written floor
//------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// floor [--f64] [--at-rest] [--threads=N] [--runs=N] scene...
//
// Prints one JSON line per scene (smoke, wave, diffmpm) in the form that all
// peers of the benchmark print. --at-rest starts smoke and the wave from zero,
// where the loss is known in closed form.
//
//===----------------------------------------------------------------------===//

#include "Floor.h"

#include <tbb/global_control.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <thread>
#include <vector>

using namespace tai::floor;

double tai::floor::symbol(int row, int column, int n) {
  const double u = (column + 0.5) / n - 0.5, w = (row + 0.5) / n - 0.5;
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

namespace {

struct Options {
  bool f64 = false;
  bool atRest = false;
  int threads = int(std::thread::hardware_concurrency());
  int runs = 20;
  std::vector<std::string> scenes;
};

/// Value of `--name=value`, or null if `argument` is something else.
const char *valueOf(const std::string &argument, const std::string &name) {
  const std::string prefix = "--" + name + "=";
  return argument.starts_with(prefix) ? argument.c_str() + prefix.size()
                                      : nullptr;
}

bool parse(int argc, char **argv, Options &options) {
  for (int i = 1; i < argc; ++i) {
    const std::string argument = argv[i];
    if (argument == "--f64")
      options.f64 = true;
    else if (argument == "--at-rest")
      options.atRest = true;
    else if (const char *value = valueOf(argument, "threads"))
      options.threads = std::atoi(value);
    else if (const char *value = valueOf(argument, "runs"))
      options.runs = std::atoi(value);
    else if (argument == "smoke" || argument == "wave" || argument == "diffmpm")
      options.scenes.push_back(argument);
    else {
      std::fprintf(stderr, "floor: unknown argument '%s'\n", argv[i]);
      return false;
    }
  }
  if (options.threads < 1 || options.runs < 1) {
    std::fprintf(stderr, "floor: --threads and --runs must be at least 1\n");
    return false;
  }
  return true;
}

template <typename Real>
Scene makeScene(const std::string &name, const Options &options) {
  if (name == "smoke")
    return makeSmoke<Real>(options.atRest);
  if (name == "wave")
    return makeWave<Real>(options.atRest);
  return makeMpm<Real>(options.threads);
}

void measure(const std::string &name, const Options &options) {
  Scene scene = options.f64 ? makeScene<double>(name, options)
                            : makeScene<float>(name, options);
  double loss = 0.0;
  for (int warmUp = 0; warmUp < 3; ++warmUp)
    loss = scene();
  std::vector<double> times;
  for (int run = 0; run < options.runs; ++run) {
    auto start = std::chrono::steady_clock::now();
    loss = scene();
    std::chrono::duration<double, std::milli> taken =
        std::chrono::steady_clock::now() - start;
    times.push_back(taken.count());
  }
  std::sort(times.begin(), times.end());
  // The step is the unit of diffmpm, in all peers.
  const double units = name == "diffmpm" ? 50.0 : 1.0;
  auto quantile = [&](double q) {
    return times[size_t(q * double(times.size() - 1) + 0.5)] / units;
  };
  std::printf(
      "{\"peer\": \"floor\", \"version\": \"c++ onetbb %s\", \"scene\": "
      "\"%s\", "
      "\"phase\": \"forward\", \"ms\": %.6g, \"p10\": %.6g, \"p90\": %.6g, "
      "\"n\": %d, \"loss\": %.17g, \"threads\": %d}\n",
      options.f64 ? "f64" : "f32", name.c_str(), quantile(0.5), quantile(0.1),
      quantile(0.9), options.runs, loss, options.threads);
}

} // namespace

int main(int argc, char **argv) {
  Options options;
  if (!parse(argc, argv, options))
    return 1;
  tbb::global_control control(tbb::global_control::max_allowed_parallelism,
                              size_t(options.threads));
  if (options.scenes.empty())
    options.scenes = {"smoke", "wave", "diffmpm"};
  for (const std::string &scene : options.scenes)
    measure(scene, options);
  return 0;
}
