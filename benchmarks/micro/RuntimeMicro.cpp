//===- RuntimeMicro.cpp - The runtime's time per launch -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Times of launches, recording, replay, parallel loops, partial sums, clears
// and the cache store, each as the median of many. Argument: threads.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Cache/CacheStore.h"
#include "tai/Runtime/Launch/Runtime.h"
#include "tai/Runtime/Tape/Tape.h"
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <unistd.h>
#include <vector>

using namespace mlir::tai::runtime;
using Clock = std::chrono::steady_clock;

/// Median nanoseconds of one of `batch` calls.
template <typename Run>
static void report(const char *what, int samples, int batch, const Run &run) {
  std::vector<double> times;
  for (int i = -samples / 10; i < samples; ++i) {
    auto start = Clock::now();
    for (int b = 0; b < batch; ++b)
      run();
    double ns =
        std::chrono::duration<double, std::nano>(Clock::now() - start).count();
    if (i >= 0)
      times.push_back(ns / batch);
  }
  std::sort(times.begin(), times.end());
  std::printf("%-52s %12.1f ns  (p5 %.1f, p95 %.1f)\n", what,
              times[times.size() / 2], times[times.size() / 20],
              times[times.size() * 19 / 20]);
}

static void must(const Status &status) {
  if (status.ok())
    return;
  std::fprintf(stderr, "%s\n", status.message().c_str());
  std::exit(1);
}

static FieldPtr makeField(Runtime &runtime, const std::string &name,
                          int64_t extent, std::string adjoint = "") {
  FieldInfo info;
  info.name = name;
  info.adjoint = std::move(adjoint);
  must(runtime.addTree(name, extent * 4, info.tree));
  info.layout.indices = {{{1, extent, 4}}};
  if (extent == 1)
    info.layout.indices.clear();
  FieldPtr field;
  must(runtime.addField(info, field));
  return field;
}

static int32_t nothing(TaiFrame *) { return 0; }

static KernelPtr makeKernel(Runtime &runtime, TaiKernelFn function,
                            int64_t slots, std::vector<Access> summary = {},
                            KernelPtr adjoint = nullptr) {
  KernelInfo info;
  info.name = "k";
  info.argSlots = slots;
  info.function = function;
  info.summary = std::move(summary);
  // A kernel with an adjoint also zeroes the adjoints of stored elements.
  info.zeroesAdjoints = adjoint != nullptr;
  info.adjoint = std::move(adjoint);
  return runtime.createKernel(info);
}

int main(int argc, char **argv) {
  Options options;
  options.threads = argc > 1 ? std::atoi(argv[1]) : 0;
  Runtime runtime(options);
  std::printf("%d threads\n", runtime.threads());
  uint64_t args[2] = {1, 2};

  auto empty = makeKernel(runtime, nothing, 2);
  report("launch of an empty kernel", 500, 1000,
         [&] { must(runtime.launch(*empty, args, 2, nullptr)); });
  runtime.setProfiler(true);
  report("the same, profiled", 500, 1000,
         [&] { must(runtime.launch(*empty, args, 2, nullptr)); });
  runtime.setProfiler(false);

  auto forking = [](int64_t parts) {
    static int64_t count;
    count = parts;
    return [](TaiFrame *frame) -> int32_t {
      tai_rt_parallel_for(
          frame, [](TaiFrame *, void *, int64_t, int64_t, int64_t) {}, nullptr,
          1 << 20, count);
      return 0;
    };
  };
  auto fork = makeKernel(runtime, forking(runtime.threads()), 2);
  report("launch with an empty parallel loop, forked", 500, 100,
         [&] { must(runtime.launch(*fork, args, 2, nullptr)); });
  auto inlined = makeKernel(
      runtime,
      [](TaiFrame *frame) -> int32_t {
        tai_rt_parallel_for(
            frame, [](TaiFrame *, void *, int64_t, int64_t, int64_t) {},
            nullptr, 100, tai_rt_parts(frame, 100, 1, 0));
        return 0;
      },
      2);
  report("launch with a small parallel loop, inline", 500, 1000,
         [&] { must(runtime.launch(*inlined, args, 2, nullptr)); });

  {
    makeField(runtime, "x_grad", 1000);
    makeField(runtime, "y_grad", 1000);
    makeField(runtime, "loss_grad", 1);
    FieldPtr x = makeField(runtime, "x", 1000, "x_grad");
    FieldPtr y = makeField(runtime, "y", 1000, "y_grad");
    FieldPtr loss = makeField(runtime, "loss", 1, "loss_grad");
    auto adjoint = makeKernel(runtime, nothing, 2);
    auto step = makeKernel(
        runtime, nothing, 2,
        {{x, AccessKind::Read}, {y, AccessKind::Write}, {y, AccessKind::Read}},
        adjoint);
    auto sum = makeKernel(
        runtime, nothing, 2,
        {{y, AccessKind::Read}, {loss, AccessKind::Accumulate}}, adjoint);
    constexpr int steps = 10000;
    std::unique_ptr<Tape> tape;
    auto record = [&] {
      must(runtime.beginTape(loss, true, tape));
      for (int i = 0; i < steps; ++i)
        must(runtime.launch(*step, args, 2, nullptr));
      must(runtime.launch(*sum, args, 2, nullptr));
      tape->end();
    };
    std::printf("\na tape of %d empty launches\n", steps + 1);
    auto perLaunch = [&](const char *what, auto run) {
      std::vector<double> times;
      for (int i = 0; i < 200; ++i) {
        auto start = Clock::now();
        run();
        times.push_back(
            std::chrono::duration<double, std::nano>(Clock::now() - start)
                .count() /
            (steps + 1));
      }
      std::sort(times.begin(), times.end());
      std::printf("%-52s %12.1f ns a launch\n", what, times[times.size() / 2]);
    };
    perLaunch("  recorded, forward", record);
    perLaunch("  recorded, forward and backward", [&] {
      record();
      must(tape->backward());
    });
    perLaunch("  replay, forward", [&] { must(tape->replay(true, false)); });
    perLaunch("  replay, backward", [&] { must(tape->replay(false, true)); });
    // Nothing is saved and nothing stands between them.
    auto recordDirect = [&] {
      must(runtime.beginTape(loss, true, tape));
      for (int i = 0; i < steps + 1; ++i)
        must(runtime.launch(*sum, args, 2, nullptr));
      tape->end();
    };
    recordDirect();
    perLaunch("  direct replay, forward",
              [&] { must(tape->replay(true, false)); });
    perLaunch("  direct replay, backward",
              [&] { must(tape->replay(false, true)); });
    // Something stands between the launches, so that each is looked at.
    auto recordWithWrite = [&] {
      must(runtime.beginTape(loss, true, tape));
      must(runtime.fillF64(*y, 0));
      for (int i = 0; i < steps; ++i)
        must(runtime.launch(*step, args, 2, nullptr));
      must(runtime.launch(*sum, args, 2, nullptr));
      tape->end();
    };
    recordWithWrite();
    perLaunch("  replay after a write, forward",
              [&] { must(tape->replay(true, false)); });
    perLaunch("  replay after a write, backward",
              [&] { must(tape->replay(false, true)); });
    // Nothing reaches the loss: all but the plan is skipped.
    std::unique_ptr<Tape> dead;
    perLaunch("  replay, backward, all skipped", [&] {
      if (!dead) {
        must(runtime.beginTape(loss, true, dead));
        for (int i = 0; i < steps + 1; ++i)
          must(runtime.launch(*step, args, 2, nullptr));
        dead->end();
      }
      must(dead->replay(false, true));
    });
  }

  std::printf("\npartial sums: private copies, zeroed, added to the target\n");
  for (int64_t count : {1, 1000, 16384, 262144}) {
    static std::vector<float> target(262144);
    std::string what = "  " + std::to_string(count) + " f32 in " +
                       std::to_string(runtime.threads()) + " copies";
    auto kernel = makeKernel(
        runtime,
        [](TaiFrame *frame) -> int32_t {
          int64_t count = static_cast<int64_t>(frame->args[0]);
          int64_t parts = static_cast<int64_t>(frame->args[1]);
          void *buffers = tai_rt_private(frame, count * 4, parts);
          tai_rt_combine(frame, target.data(), buffers, count, parts, 0);
          return 0;
        },
        2);
    uint64_t sizes[2] = {static_cast<uint64_t>(count),
                         static_cast<uint64_t>(runtime.threads())};
    report(what.c_str(), 300, count > 10000 ? 1 : 50,
           [&] { must(runtime.launch(*kernel, sizes, 2, nullptr)); });
  }

  std::printf("\nfields\n");
  FieldPtr big = makeField(runtime, "big", 1 << 22);
  std::vector<float> host(1 << 22);
  report("  fill 16 MiB", 50, 1, [&] { must(runtime.fillF64(*big, 0)); });
  report("  copy 16 MiB to the host", 50, 1,
         [&] { must(runtime.copyToHost(*big, host.data())); });
  int64_t index = 5;
  double value = 0;
  report("  read one element", 500, 1000,
         [&] { must(big->readF64(&index, 0, value)); });

  std::printf("\ncache store\n");
  std::string folder =
      (std::filesystem::temp_directory_path() / "tai-micro-XXXXXX").string();
  if (mkdtemp(folder.data())) {
    CacheStore store(folder);
    std::string bytes(20000, 'x'), key(5000, 'k');
    report("  put 20 kB", 50, 1, [&] { store.put(key, bytes); });
    report("  get 20 kB", 200, 1, [&] { (void)store.get(key); });
    store.clean();
    rmdir(folder.c_str());
  }
  return 0;
}
