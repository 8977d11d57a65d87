//===- ForkJoin.cpp - The cost of a fork and join -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Times an empty parallel loop on the workers of the runtime and on oneTBB, for
// launches back to back and with a pause of serial work between them, and the
// time to cut a loop of known work in two. Arguments: threads, samples.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Threads/WorkerPool.h"
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>
#include <vector>

using namespace mlir::tai::runtime;
using Clock = std::chrono::steady_clock;

static double nanoseconds(Clock::duration time) {
  return std::chrono::duration<double, std::nano>(time).count();
}

static void burn(double ns) {
  auto start = Clock::now();
  while (nanoseconds(Clock::now() - start) < ns)
    ;
}

struct Times {
  double median, p95, mean;
};
static Times measure(int samples, double gapNs,
                     const std::function<void()> &run) {
  for (int i = 0; i < 2000; ++i)
    run();
  std::vector<double> times;
  for (int i = 0; i < samples; ++i) {
    if (gapNs > 0)
      burn(gapNs);
    auto start = Clock::now();
    run();
    times.push_back(nanoseconds(Clock::now() - start));
  }
  std::sort(times.begin(), times.end());
  double sum = 0;
  for (double time : times)
    sum += time;
  return {times[times.size() / 2], times[times.size() * 95 / 100],
          sum / times.size()};
}

int main(int argc, char **argv) {
  int threads = argc > 1 ? std::atoi(argv[1]) : availableThreads();
  int samples = argc > 2 ? std::atoi(argv[2]) : 20000;
  std::printf("%d threads\n%-10s %10s %10s %12s %12s %12s\n", threads, "engine",
              "work us", "gap us", "median ns", "p95 ns", "mean ns");
  for (double work : {0.0, 5000.0, 20000.0}) {
    for (double gap : {0.0, 2000.0, 20000.0, 200000.0}) {
      int count = gap > 50000      ? samples / 40
                  : work + gap > 0 ? samples / 5
                                   : samples;
      {
        WorkerPool pool(threads);
        double share = work / threads;
        auto task = [](void *context, int64_t) {
          double ns = *static_cast<double *>(context);
          if (ns > 0)
            burn(ns);
        };
        Times t =
            measure(count, gap, [&] { pool.tryRun(task, &share, threads); });
        std::printf("%-10s %10.0f %10.0f %12.0f %12.0f %12.0f\n", "workers",
                    work / 1e3, gap / 1e3, t.median, t.p95, t.mean);
      }
      {
        tbb::task_arena arena(threads);
        double share = work / threads;
        Times t = measure(count, gap, [&] {
          arena.execute([&] {
            tbb::parallel_for(
                0, threads, 1,
                [&](int) {
                  if (share > 0)
                    burn(share);
                },
                tbb::static_partitioner());
          });
        });
        std::printf("%-10s %10.0f %10.0f %12.0f %12.0f %12.0f\n", "oneTBB",
                    work / 1e3, gap / 1e3, t.median, t.p95, t.mean);
      }
    }
  }
  return 0;
}
