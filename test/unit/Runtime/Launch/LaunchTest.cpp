//===- LaunchTest.cpp - Launches and their services -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "../../Utils/RuntimeTestUtils.h"
#include "tai/ABI/SumModes.h"
#include "tai/Support/Philox.h"
#include <chrono>
#include <cmath>
#include <map>
#include <set>
#include <thread>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

//===----------------------------------------------------------------------===//
// Random numbers
//===----------------------------------------------------------------------===//

// The known answers that were published with the generator.
TEST(RuntimeRandom, KnownAnswers) {
  using Counter = std::array<uint32_t, 4>;
  EXPECT_EQ(philox4x32({0, 0, 0, 0}, {0, 0}),
            (Counter{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8}));
  uint32_t ones = 0xffffffff;
  EXPECT_EQ(philox4x32({ones, ones, ones, ones}, {ones, ones}),
            (Counter{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd}));
  EXPECT_EQ(philox4x32({0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344},
                       {0xa4093822, 0x299f31d0}),
            (Counter{0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1}));
}

TEST(RuntimeRandom, DependsOnEveryCoordinate) {
  std::set<uint32_t> seen;
  seen.insert(tai_rt_random_u32(1, 2, 3, 4, 5));
  seen.insert(tai_rt_random_u32(2, 2, 3, 4, 5));
  seen.insert(tai_rt_random_u32(1, 3, 3, 4, 5));
  seen.insert(tai_rt_random_u32(1, 2, 4, 4, 5));
  seen.insert(tai_rt_random_u32(1, 2, uint64_t(1) << 40, 4, 5));
  seen.insert(tai_rt_random_u32(1, 2, 3, 5, 5));
  seen.insert(tai_rt_random_u32(1, 2, 3, 4, 6));
  seen.insert(tai_rt_random_u32(1, 2, 3, 4, 9));
  EXPECT_EQ(seen.size(), 8u);
  EXPECT_EQ(tai_rt_random_u32(1, 2, 3, 4, 5), tai_rt_random_u32(1, 2, 3, 4, 5));
}

TEST(RuntimeRandom, IsUniform) {
  double sum = 0, squares = 0;
  int n = 200000;
  for (int i = 0; i < n; ++i) {
    double u = tai_rt_random_u32(7, 0, uint64_t(i), 0, 0) * 0x1p-32;
    sum += u;
    squares += u * u;
  }
  // Allow five standard deviations.
  EXPECT_NEAR(sum / n, 0.5, 5 * 0.2887 / std::sqrt(n));
  EXPECT_NEAR(squares / n, 1.0 / 3, 5 * 0.2982 / std::sqrt(n));
}

//===----------------------------------------------------------------------===//
// Launch
//===----------------------------------------------------------------------===//

TEST(RuntimeLaunch, PassesArgumentsAndResults) {
  Options options;
  options.seed = 42;
  Runtime runtime(options);
  KernelInfo info;
  info.name = "add";
  info.argSlots = 2;
  info.resultSlots = 1;
  info.function = [](TaiFrame *frame) {
    frame->results[0] = frame->args[0] + frame->args[1] + frame->seed;
    return 0;
  };
  KernelPtr kernel = runtime.launcher().kernels().create(info);
  uint64_t args[] = {3, 4}, result = 0;
  ASSERT_OK(runtime.launch(*kernel, args, 2, &result));
  EXPECT_EQ(result, 49u);
  // A result that the caller does not request is dropped.
  ASSERT_OK(runtime.launch(*kernel, args, 2, nullptr));
  EXPECT_EQ(runtime.launch(*kernel, args, 1, &result).message(),
            "kernel 'add' takes 2 argument slots, but got 1");
}

TEST(RuntimeLaunch, CompilesOnFirstUseOnly) {
  Runtime runtime;
  int compiled = 0;
  KernelInfo info;
  info.name = "lazy";
  provide(info).onCompile = [&](Kernel &, TaiKernelFn &function) {
    if (++compiled == 1)
      return Status::failure(StatusCode::Compile, "no such op", "a.py:3:4", 17);
    function = [](TaiFrame *) { return 0; };
    return Status::success();
  };
  KernelPtr kernel = runtime.launcher().kernels().create(info);
  EXPECT_EQ(compiled, 0);
  Status status = runtime.launch(*kernel, nullptr, 0, nullptr);
  EXPECT_EQ(status.code(), StatusCode::Compile);
  EXPECT_EQ(status.where(), "a.py:3:4");
  EXPECT_EQ(status.detail(), 17);
  for (int i = 0; i < 3; ++i)
    EXPECT_OK(runtime.launch(*kernel, nullptr, 0, nullptr));
  EXPECT_EQ(compiled, 2);
}

TEST(RuntimeLaunch, CompilesOnceFromManyThreads) {
  Runtime runtime;
  std::atomic<int> compiled{0};
  KernelInfo info;
  info.name = "lazy";
  provide(info).onCompile = [&](Kernel &, TaiKernelFn &function) {
    ++compiled;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    function = [](TaiFrame *) { return 0; };
    return Status::success();
  };
  KernelPtr kernel = runtime.launcher().kernels().create(info);
  std::vector<std::thread> threads;
  for (int i = 0; i < 8; ++i)
    threads.emplace_back(
        [&] { EXPECT_OK(runtime.launch(*kernel, nullptr, 0, nullptr)); });
  for (std::thread &thread : threads)
    thread.join();
  EXPECT_EQ(compiled, 1);
}

TEST(RuntimeLaunch, KeepsTheFirstFailure) {
  Runtime runtime;
  Status status = launchOnce(runtime, [](TaiFrame *frame) {
    int32_t kinds[] = {TAI_VALUE_I64, TAI_VALUE_F64};
    int32_t shapes[] = {1, 2};
    uint64_t slots[] = {uint64_t(-3), slotOf(0.1), slotOf(2)};
    EXPECT_EQ(tai_rt_failed(frame), 0);
    tai_rt_fail(frame, TAI_FAIL_ASSERT, "i = {}, v = {}", "k.py:7:2", 2, kinds,
                shapes, slots);
    EXPECT_NE(tai_rt_failed(frame), 0);
    tai_rt_fail(frame, TAI_FAIL_INDEX, "later", "", 0, nullptr, nullptr,
                nullptr);
    return 0;
  });
  EXPECT_EQ(status.code(), StatusCode::Assert);
  EXPECT_EQ(status.message(), "i = -3, v = [0.1, 2.0]");
  EXPECT_EQ(status.where(), "k.py:7:2");
  // A failure does not affect the next launch.
  EXPECT_OK(launchOnce(runtime, [](TaiFrame *) { return 0; }));
  EXPECT_EQ(launchOnce(runtime, [](TaiFrame *) { return 5; }).message(),
            "kernel 'k' failed");
}

TEST(RuntimeLaunch, PrintsWholeLines) {
  Runtime runtime;
  std::string text;
  runtime.setPrintSink([&](std::string_view line) { text += line; });
  ASSERT_OK(launchOnce(runtime, [](TaiFrame *frame) {
    int32_t kinds[] = {TAI_VALUE_U64, TAI_VALUE_BOOL, TAI_VALUE_F64,
                       TAI_VALUE_F64};
    int32_t shapes[] = {1, 1, 1, 3};
    uint64_t slots[] = {
        7, 1, slotOf(0.1f), slotOf(1e30), slotOf(-INFINITY), slotOf(1.0 / 3)};
    tai_rt_print(frame, "a {} b {} c {}{}!", 4, kinds, shapes, slots);
    tai_rt_print(frame, "plain {}", 0, nullptr, nullptr, nullptr);
    tai_rt_print(frame, "", 1, kinds, shapes, slots);
    return 0;
  }));
  EXPECT_EQ(text, "a 7 b true c 0.1[1e+30, -inf, 0.3333333333333333]!\n"
                  "plain {}\n"
                  "7\n");
}

TEST(RuntimeLaunch, ProfilesWhenAsked) {
  Runtime runtime;
  EXPECT_OK(launchOnce(runtime, [](TaiFrame *) { return 0; }));
  EXPECT_TRUE(runtime.profile().empty());
  runtime.setProfiler(true);
  for (int i = 0; i < 3; ++i)
    EXPECT_OK(launchOnce(runtime, [](TaiFrame *) {
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
      return 0;
    }));
  std::vector<ProfileRow> rows = runtime.profile();
  ASSERT_EQ(rows.size(), 1u);
  EXPECT_EQ(rows[0].kernel, "k");
  EXPECT_EQ(rows[0].times.launches, 3);
  EXPECT_GE(rows[0].times.minNs, 2000000);
  EXPECT_GE(rows[0].times.maxNs, rows[0].times.minNs);
  EXPECT_GE(rows[0].times.totalNs, 3 * rows[0].times.minNs);
  runtime.clearProfile();
  EXPECT_TRUE(runtime.profile().empty());
}

//===----------------------------------------------------------------------===//
// Parallel loops
//===----------------------------------------------------------------------===//

TEST(RuntimeLoop, VisitsEveryIterationOnce) {
  for (int threads : {1, 2, 3, 8}) {
    Runtime runtime(withThreads(threads));
    for (int64_t parts : {1, 2, 3, 7, 32, 1000})
      for (int64_t n : {0, 1, 5, 1000, 1001}) {
        std::vector<std::atomic<int>> visits(n);
        uint64_t args[] = {uint64_t(n), uint64_t(parts),
                           reinterpret_cast<uint64_t>(visits.data())};
        ASSERT_OK(launchOnce(
            runtime,
            [](TaiFrame *frame) {
              tai_rt_parallel_for(
                  frame,
                  [](TaiFrame *frame, void *closure, int64_t begin, int64_t end,
                     int64_t part) {
                    int64_t n = frame->args[0], parts = frame->args[1];
                    EXPECT_EQ(begin, n * part / parts);
                    EXPECT_EQ(end, n * (part + 1) / parts);
                    for (int64_t i = begin; i < end; ++i)
                      ++static_cast<std::atomic<int> *>(closure)[i];
                  },
                  reinterpret_cast<void *>(frame->args[2]), frame->args[0],
                  frame->args[1]);
              return 0;
            },
            args, 3));
        for (auto &count : visits)
          ASSERT_EQ(count.load(), 1);
      }
  }
}

TEST(RuntimeLoop, ManyForksInARow) {
  Runtime runtime(withThreads(4));
  auto kernel = makeKernel(runtime, "k",
                           [](TaiFrame *frame) {
                             int64_t sums[16] = {};
                             for (int round = 0; round < 20; ++round)
                               tai_rt_parallel_for(
                                   frame,
                                   [](TaiFrame *, void *closure, int64_t begin,
                                      int64_t end, int64_t part) {
                                     static_cast<int64_t *>(closure)[part] +=
                                         end - begin;
                                   },
                                   sums, 1000, 16);
                             int64_t total = 0;
                             for (int64_t sum : sums)
                               total += sum;
                             return total == 20000 ? 0 : 1;
                           },
                           {});
  for (int i = 0; i < 2000; ++i)
    ASSERT_OK(runtime.launch(*kernel, nullptr, 0, nullptr));
}

TEST(RuntimeLoop, NestedLoopsRunInline) {
  Runtime runtime(withThreads(4));
  std::atomic<int64_t> sum{0};
  uint64_t arg = reinterpret_cast<uint64_t>(&sum);
  ASSERT_OK(launchOnce(
      runtime,
      [](TaiFrame *frame) {
        auto outer = [](TaiFrame *frame, void *closure, int64_t begin,
                        int64_t end, int64_t) {
          for (int64_t i = begin; i < end; ++i)
            tai_rt_parallel_for(
                frame,
                [](TaiFrame *, void *closure, int64_t begin, int64_t end,
                   int64_t) {
                  *static_cast<std::atomic<int64_t> *>(closure) += end - begin;
                },
                closure, 100, 8);
        };
        tai_rt_parallel_for(frame, outer,
                            reinterpret_cast<void *>(frame->args[0]), 50, 8);
        return 0;
      },
      &arg, 1));
  EXPECT_EQ(sum, 5000);
}

TEST(RuntimeLoop, LaunchesFromManyThreads) {
  Runtime runtime(withThreads(2));
  auto kernel = makeKernel(
      runtime, "k",
      [](TaiFrame *frame) {
        int64_t parts = tai_rt_parts(frame, 1000, 1000, 1);
        auto *sums = static_cast<double *>(tai_rt_private(frame, 64, parts));
        tai_rt_parallel_for(
            frame,
            [](TaiFrame *, void *closure, int64_t begin, int64_t end,
               int64_t part) {
              for (int64_t i = begin; i < end; ++i)
                static_cast<double *>(closure)[part * 8] += double(i);
            },
            sums, 1000, parts);
        double total = 0;
        for (int64_t part = 0; part < parts; ++part)
          total += sums[part * 8];
        return total == 499500 ? 0 : 1;
      },
      {});
  std::vector<std::thread> threads;
  for (int t = 0; t < 32; ++t)
    threads.emplace_back([&] {
      for (int i = 0; i < 50; ++i)
        EXPECT_OK(runtime.launch(*kernel, nullptr, 0, nullptr));
    });
  for (std::thread &thread : threads)
    thread.join();
}

TEST(RuntimeLoop, SeveralRuntimesAtOnce) {
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t)
    threads.emplace_back([] {
      for (int i = 0; i < 10; ++i) {
        Runtime runtime(withThreads(3));
        std::vector<float> in(100000, 1.0f);
        FieldPtr x = makeField(runtime, "x", ScalarKind::F32, {100000});
        EXPECT_OK(runtime.writes().copyIn(*x, in.data()));
        EXPECT_EQ(get(*x, {99999}), 1);
      }
    });
  for (std::thread &thread : threads)
    thread.join();
}

TEST(RuntimeLoop, StopsAfterAFailure) {
  Runtime runtime(withThreads(2));
  std::atomic<int64_t> ran{0};
  uint64_t arg = reinterpret_cast<uint64_t>(&ran);
  Status status = launchOnce(
      runtime,
      [](TaiFrame *frame) {
        tai_rt_parallel_for(
            frame,
            [](TaiFrame *frame, void *closure, int64_t, int64_t, int64_t) {
              ++*static_cast<std::atomic<int64_t> *>(closure);
              tai_rt_fail(frame, TAI_FAIL_INDEX, "out of range", "f:1:1", 0,
                          nullptr, nullptr, nullptr);
            },
            reinterpret_cast<void *>(frame->args[0]), 10000, 10000);
        return 0;
      },
      &arg, 1);
  EXPECT_EQ(status.code(), StatusCode::Index);
  EXPECT_LE(ran, 2);
}

TEST(RuntimeLoop, CanBeInterrupted) {
  Runtime runtime(withThreads(2));
  std::thread other([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(30));
    runtime.interrupt();
  });
  std::atomic<int64_t> done{0};
  auto arg = reinterpret_cast<uint64_t>(&done);
  auto endless = [](TaiFrame *frame) {
    // The loop would take ten seconds if it were not stopped.
    tai_rt_parallel_for(
        frame,
        [](TaiFrame *, void *closure, int64_t begin, int64_t end, int64_t) {
          std::this_thread::sleep_for(std::chrono::milliseconds(end - begin));
          *static_cast<std::atomic<int64_t> *>(closure) += end - begin;
        },
        reinterpret_cast<void *>(frame->args[0]), 20000,
        tai_rt_parts(frame, 20000, 1000000, 0));
    return 0;
  };
  Status status = launchOnce(runtime, endless, &arg, 1);
  other.join();
  EXPECT_EQ(status.code(), StatusCode::Interrupted);
  EXPECT_LT(done, 20000);
  EXPECT_EQ(launchOnce(runtime, [](TaiFrame *) { return 0; }).code(),
            StatusCode::Interrupted);
  runtime.launcher().clearInterrupt();
  EXPECT_OK(launchOnce(runtime, [](TaiFrame *) { return 0; }));
}

TEST(RuntimeLoop, CutsByCost) {
  Runtime runtime(withThreads(4));
  // These loops are too small to pay for a fork.
  EXPECT_EQ(runtime.workers().partition(1000, 1, false), 1);
  EXPECT_EQ(runtime.workers().partition(1, 1000000000, false), 1);
  EXPECT_EQ(runtime.workers().partition(0, 1, true), 1);
  // These loops are worth a fork.
  EXPECT_EQ(runtime.workers().partition(1000000, 1, true), 4);
  EXPECT_GE(runtime.workers().partition(1000000, 1, false), 4);
  EXPECT_EQ(runtime.workers().partition(3, 1000000, true), 3);
  // The computation does not overflow.
  EXPECT_EQ(runtime.workers().partition(INT64_MAX / 2, 0x1p62, true), 4);
  runtime.setThreads(1);
  EXPECT_EQ(runtime.workers().partition(1000000, 1000, false), 1);
}

TEST(RuntimeLoop, MeasuresWhatEstimatesLeaveOpen) {
  LoopTimes times;
  LoopTimes::Entry *entry = times.find(375);
  ASSERT_TRUE(entry);
  EXPECT_EQ(times.find(375), entry);
  EXPECT_NE(times.find(376), entry);
  // The first runs are measured, later runs only now and then.
  int measured = 0;
  for (int i = 0; i < 1024; ++i) {
    measured += entry->wantsRun();
    entry->noteRun();
  }
  EXPECT_GE(measured, 4);
  EXPECT_LE(measured, 10);
  // A disturbance can only make a run longer.
  for (double nanoseconds : {500.0, 20.0, 30000.0, 21.0})
    entry->add(nanoseconds);
  EXPECT_GE(entry->perIteration(), 20);
  EXPECT_LE(entry->perIteration(), 2000);
  // For a kernel with more loops than this, the estimates are used.
  int known = 0;
  for (int64_t cost = 1; cost <= 100; ++cost)
    known += times.find(cost) != nullptr;
  EXPECT_LT(known, 20);
}

TEST(RuntimeLoop, FixedPartsIgnoreTheThreads) {
  std::set<std::vector<int64_t>> answers;
  static std::vector<int64_t> parts;
  for (int threads : {1, 2, 5, 64}) {
    Runtime runtime(withThreads(threads));
    parts.clear();
    EXPECT_OK(launchOnce(runtime, [](TaiFrame *frame) {
      for (int64_t n : {1, 10, 1000, 100000, 10000000})
        for (int64_t cost : {1, 7, 500})
          parts.push_back(tai_rt_parts(frame, n, cost, kPartsFixed));
      return 0;
    }));
    answers.insert(parts);
  }
  EXPECT_EQ(answers.size(), 1u);
  EXPECT_GT(*std::max_element(answers.begin()->begin(), answers.begin()->end()),
            8);
}

//===----------------------------------------------------------------------===//
// Symbols
//===----------------------------------------------------------------------===//

TEST(RuntimeSymbols, AreTheFunctions) {
  std::map<std::string, void *> symbols;
  for (const RuntimeSymbol &symbol : runtimeSymbols())
    EXPECT_TRUE(symbols.emplace(symbol.name, symbol.address).second);
  EXPECT_EQ(symbols["tai_rt_parallel_for"],
            reinterpret_cast<void *>(&tai_rt_parallel_for));
  EXPECT_EQ(symbols["tai_rt_host_launch"],
            reinterpret_cast<void *>(&tai_rt_host_launch));
  for (const auto &[name, address] : symbols) {
    // The other symbols are conversions and arithmetic of compiler-rt, which
    // LLVM calls by these names.
    bool isLibraryCall = false;
    for (const char *start : {"__trunc", "__extendhfsf2", "__powi", "__div",
                              "__mod", "__udiv", "__umod", "__float", "__fix"})
      isLibraryCall |= name.rfind(start, 0) == 0;
    EXPECT_TRUE(name.rfind("tai_rt_", 0) == 0 ||
                name.rfind("tai_wide_", 0) == 0 ||
                name.rfind("tai_emu_", 0) == 0 || isLibraryCall)
        << name;
    EXPECT_NE(address, nullptr) << name;
  }
}

TEST(RuntimeSymbols, ConvertToHalfWithOneRounding) {
  for (const RuntimeSymbol &symbol : runtimeSymbols()) {
    if (std::string(symbol.name) != "__truncdfhf2")
      continue;
    auto convert = reinterpret_cast<_Float16 (*)(double)>(symbol.address);
    // Rounded to f32 first, this number would be a tie, which is rounded to
    // even.
    EXPECT_EQ(static_cast<float>(convert(1 + 0x1p-11 + 0x1p-40)), 1 + 0x1p-10);
    EXPECT_EQ(static_cast<float>(convert(1 + 0x1p-11)), 1);
    return;
  }
  FAIL() << "no conversion";
}
