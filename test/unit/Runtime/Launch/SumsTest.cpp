//===- SumsTest.cpp - Scratch memory and partial sums ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "../../Utils/RuntimeTestUtils.h"
#include "tai/ABI/SumModes.h"
#include <cmath>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

//===----------------------------------------------------------------------===//
// Scratch memory
//===----------------------------------------------------------------------===//

TEST(RuntimeScratch, IsZeroInEveryLaunch) {
  Runtime runtime;
  auto kernel =
      makeKernel(runtime, "k",
                 [](TaiFrame *frame) {
                   int64_t sizes[] = {1, 64, 100, 5000, 300000, 1, 2000000};
                   char *previousEnd = nullptr;
                   for (int64_t size : sizes) {
                     char *memory =
                         static_cast<char *>(tai_rt_scratch(frame, size));
                     if (reinterpret_cast<uintptr_t>(memory) % 64)
                       return 1;
                     for (int64_t b = 0; b < size; ++b)
                       if (memory[b])
                         return 2;
                     std::memset(memory, 0xff, size);
                     previousEnd = memory + size;
                   }
                   return previousEnd ? 0 : 3;
                 },
                 {});
  for (int i = 0; i < 50; ++i)
    ASSERT_OK(runtime.launch(*kernel, nullptr, 0, nullptr));
}

TEST(RuntimeScratch, IsReused) {
  Runtime runtime;
  void *seen[8] = {};
  uint64_t arg = reinterpret_cast<uint64_t>(seen);
  auto kernel = makeKernel(
      runtime, "k",
      [](TaiFrame *frame) {
        auto **seen = reinterpret_cast<void **>(frame->args[0]);
        seen[frame->launch % 8] = tai_rt_scratch(frame, 100000);
        return 0;
      },
      {}, 1);
  for (int i = 0; i < 8; ++i)
    ASSERT_OK(runtime.launch(*kernel, &arg, 1, nullptr));
  for (void *memory : seen)
    EXPECT_EQ(memory, seen[0]);
}

TEST(RuntimeScratch, ComesInParallel) {
  Runtime runtime(withThreads(4));
  for (int i = 0; i < 20; ++i)
    ASSERT_OK(launchOnce(runtime, [](TaiFrame *frame) {
      tai_rt_parallel_for(
          frame,
          [](TaiFrame *frame, void *, int64_t, int64_t, int64_t part) {
            auto *memory = static_cast<char *>(tai_rt_scratch(frame, 10000));
            for (int b = 0; b < 10000; ++b)
              if (memory[b])
                tai_rt_fail(frame, TAI_FAIL_CHECK, "not zero", "", 0, nullptr,
                            nullptr, nullptr);
            std::memset(memory, int(part) + 1, 10000);
            for (int b = 0; b < 10000; ++b)
              if (memory[b] != char(part + 1))
                tai_rt_fail(frame, TAI_FAIL_CHECK, "shared", "", 0, nullptr,
                            nullptr, nullptr);
          },
          nullptr, 64, 64);
      return 0;
    }));
}

TEST(RuntimeScratch, OutOfMemoryFailsTheLaunchOnly) {
  Options options;
  options.memoryLimit = 1 << 20;
  Runtime runtime(options);
  auto kernel = [](TaiFrame *frame) {
    // The kernel may still write to memory whose allocation exceeded the limit.
    auto *memory = static_cast<char *>(tai_rt_scratch(frame, 40 << 20));
    for (int64_t b = 0; b < (40 << 20); b += 1000)
      memory[b] = 1;
    return 0;
  };
  for (int i = 0; i < 3; ++i) {
    Status status = launchOnce(runtime, kernel);
    EXPECT_EQ(status.code(), StatusCode::Memory);
    EXPECT_EQ(status.message(), "out of memory: a kernel needs 40.0 MiB of "
                                "scratch memory, of 1.0 MiB");
  }
  EXPECT_EQ(launchOnce(runtime,
                       [](TaiFrame *frame) {
                         return tai_rt_private(frame, INT64_MAX / 2, 4) ? 0 : 1;
                       })
                .code(),
            StatusCode::Memory);
  EXPECT_EQ(launchOnce(runtime,
                       [](TaiFrame *frame) {
                         return tai_rt_scratch(frame, -1) ? 0 : 1;
                       })
                .message(),
            "a kernel asked for memory of negative size");
  EXPECT_OK(launchOnce(runtime, [](TaiFrame *frame) {
    return tai_rt_scratch(frame, 1000) ? 0 : 1;
  }));
}

//===----------------------------------------------------------------------===//
// Partial sums
//===----------------------------------------------------------------------===//

/// Adds buffers of `T` to a field of `Target`, rounding once.
template <typename Target, typename T>
static void combine(int threads, int64_t count, int64_t parts, int kind) {
  Runtime runtime(withThreads(threads));
  std::vector<Target> target(count), expected(count);
  for (int64_t e = 0; e < count; ++e)
    target[e] = Target(e);
  for (int64_t e = 0; e < count; ++e) {
    // In the order of the partitions, without another association.
    T sum = T(0) + T(1) / T(e % 13 + 1);
    for (int64_t p = 1; p < parts; ++p)
      sum += T(p + 1) / T(e % 13 + 1);
    expected[e] = Target(target[e] + sum);
  }
  uint64_t args[] = {reinterpret_cast<uint64_t>(target.data()), uint64_t(count),
                     uint64_t(parts), uint64_t(kind)};
  ASSERT_OK(launchOnce(
      runtime,
      [](TaiFrame *frame) {
        int64_t count = frame->args[1], parts = frame->args[2];
        int64_t bytes = count * sizeof(T), block = (bytes + 63) / 64 * 64;
        auto *buffers =
            static_cast<char *>(tai_rt_private(frame, bytes, parts));
        for (int64_t p = 0; p < parts; ++p)
          for (int64_t e = 0; e < count; ++e)
            reinterpret_cast<T *>(buffers + p * block)[e] +=
                T(p + 1) / T(e % 13 + 1);
        tai_rt_combine(frame, reinterpret_cast<void *>(frame->args[0]), buffers,
                       count, parts, int32_t(frame->args[3]));
        return 0;
      },
      args, 4));
  ASSERT_EQ(target, expected);
}

TEST(RuntimeCombine, AddsInPartitionOrder) {
  for (int threads : {1, 4})
    for (int64_t count : {1, 15, 1024, 1025, 300000})
      for (int64_t parts : {1, 2, 9}) {
        combine<float, float>(threads, count, parts, kSumsF32);
        combine<double, double>(threads, count, parts, kSumsF64);
        combine<float, double>(threads, count, parts, kSumsWide);
        combine<uint32_t, uint32_t>(threads, count, parts, kSumsI32);
        combine<uint64_t, uint64_t>(threads, count, parts, kSumsI64);
      }
}

// Cells of three components in a record of five; the other two must not change.
TEST(RuntimeCombine, AddsIntoCells) {
  for (int threads : {1, 4})
    for (int64_t cells : {1, 341, 342, 50000})
      for (int64_t parts : {1, 2, 9}) {
        Runtime runtime(withThreads(threads));
        std::vector<double> target(cells * 5, 0.5), expected(cells * 5, 0.5);
        for (int64_t cell = 0; cell < cells; ++cell)
          for (int64_t c = 0; c < 3; ++c) {
            double sum = 0;
            for (int64_t p = 0; p < parts; ++p)
              sum += double(p + 1) / double(cell * 3 + c + 1);
            expected[cell * 5 + c] += sum;
          }
        uint64_t args[] = {reinterpret_cast<uint64_t>(target.data()),
                           uint64_t(cells), uint64_t(parts)};
        ASSERT_OK(launchOnce(
            runtime,
            [](TaiFrame *frame) {
              int64_t cells = frame->args[1], parts = frame->args[2];
              int64_t bytes = cells * 24, block = (bytes + 63) / 64 * 64;
              auto *buffers =
                  static_cast<char *>(tai_rt_private(frame, bytes, parts));
              for (int64_t p = 0; p < parts; ++p)
                for (int64_t e = 0; e < cells * 3; ++e)
                  reinterpret_cast<double *>(buffers + p * block)[e] =
                      double(p + 1) / double(e + 1);
              tai_rt_combine_strided(frame,
                                     reinterpret_cast<void *>(frame->args[0]),
                                     buffers, cells, 3, 40, parts, 1);
              return 0;
            },
            args, 3));
        ASSERT_EQ(target, expected);
      }
}

/// Adds to every `step`th of `count` elements in the buffers of all `parts`, if
/// these were zero; other memory is dirtied first.
template <typename T> static int32_t addToSome(TaiFrame *frame) {
  int64_t count = frame->args[1], parts = frame->args[2], step = frame->args[3];
  int64_t other = frame->args[4], kind = frame->args[5];
  int64_t numbers = (kind == kSumsPairs ? 2 : 1) * count;
  if (other)
    std::memset(tai_rt_scratch(frame, other), 0xff, other);
  int64_t bytes = numbers * sizeof(T), block = (bytes + 63) / 64 * 64;
  auto *buffers = static_cast<char *>(tai_rt_private(frame, bytes, parts));
  for (int64_t b = 0; b < block * parts; ++b)
    if (buffers[b])
      return 1;
  for (int64_t p = 0; p < parts; ++p)
    for (int64_t e = 0; e < numbers; e += step)
      reinterpret_cast<T *>(buffers + p * block)[e] += 1;
  tai_rt_combine(frame, reinterpret_cast<void *>(frame->args[0]), buffers,
                 count, parts, int32_t(kind));
  return 0;
}

// Memory of a launch is reused: memory that must be zero must be zero again.
TEST(RuntimeCombine, LeavesZeros) {
  for (int threads : {1, 3}) {
    Runtime runtime(withThreads(threads));
    std::vector<double> target(100000);
    int round = 0;
    for (int64_t count : {100000, 100000, 300, 100000, 5000, 100000, 1, 7777})
      for (int64_t parts : {1, 3})
        for (int64_t other : {0, 0, 70, 200000}) {
          int64_t step = (round++ % 3) * 999 + 1;
          uint64_t args[] = {reinterpret_cast<uint64_t>(target.data()),
                             uint64_t(count),
                             uint64_t(parts),
                             uint64_t(step),
                             uint64_t(other),
                             kSumsF64};
          ASSERT_OK(launchOnce(runtime, addToSome<double>, args, 6));
          args[5] = kSumsPairs;
          ASSERT_OK(launchOnce(runtime, addToSome<double>, args, 6));
        }
  }
}

TEST(RuntimeCombine, ForgetsZerosOfFailedLaunches) {
  Runtime runtime;
  std::vector<double> target(5000);
  uint64_t args[] = {
      reinterpret_cast<uint64_t>(target.data()), 5000, 2, 1, 0, kSumsF64};
  for (int i = 0; i < 3; ++i) {
    ASSERT_OK(launchOnce(runtime, addToSome<double>, args, 6));
    EXPECT_EQ(launchOnce(runtime,
                         [](TaiFrame *frame) {
                           std::memset(tai_rt_private(frame, 30000, 2), 1,
                                       60000);
                           tai_rt_fail(frame, TAI_FAIL_CHECK, "no", "", 0,
                                       nullptr, nullptr, nullptr);
                           return 0;
                         })
                  .message(),
              "no");
  }
}

// Zeros to which no term was added keep their sign.
TEST(RuntimeCombine, AddsNothingToTheRest) {
  for (int kind : {int(kSumsF64), int(kSumsPairs)})
    for (int64_t step : {1, 2, 5000}) {
      Runtime runtime;
      std::vector<double> target(10000, -0.0);
      uint64_t args[] = {reinterpret_cast<uint64_t>(target.data()),
                         10000,
                         1,
                         uint64_t(step),
                         0,
                         uint64_t(kind)};
      ASSERT_OK(launchOnce(runtime, addToSome<double>, args, 6));
      for (int64_t e = 0; e < 10000; ++e)
        if (e % step)
          ASSERT_TRUE(target[e] == 0 && std::signbit(target[e])) << e;
        else
          ASSERT_EQ(target[e], kind == kSumsPairs ? 2.0 : 1.0) << e;
    }
}
