//===- BlockSizesTest.cpp - Sizes of blocks that are said or kept ---------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The driver of these tests needs no GPU: its function "where" stores the
// number of blocks and threads that it was launched with.
//
//===----------------------------------------------------------------------===//

#include "../../Utils/RuntimeTestUtils.h"
#include "tai/Runtime/Cache/CacheStore.h"
#include "tai/Runtime/Device/Device.h"
#include <cstdlib>
#include <fstream>
#include <map>
#include <sys/stat.h>
#include <unistd.h>

#ifdef TAI_FAKE_CUDA_LIBRARY
using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

namespace {
using Shape = std::pair<double, double>;

/// A process with one kernel, which has a function "where" for each size.
class Program {
public:
  explicit Program(std::vector<int64_t> blockSizes, std::string key = "") {
    std::unique_ptr<Device> device;
    EXPECT_OK(openCudaDevice(0, device));
    EXPECT_OK(runtime.useDevice(std::move(device)));
    x = makeField(runtime, "x", ScalarKind::I32, {2});
    DeviceImage image;
    image.kind = DeviceKind::Cuda;
    image.bytes = "// PTX";
    image.functions.assign(std::max<size_t>(blockSizes.size(), 1), "where");
    image.blockSizes = std::move(blockSizes);
    image.key = std::move(key);
    auto host = [](TaiFrame *frame) -> int32_t {
      uint64_t slots[] = {reinterpret_cast<uint64_t>(frame->trees[0])};
      tai_rt_device_launch(frame, int32_t(frame->args[1]),
                           int64_t(frame->args[0]), slots, 1);
      return tai_rt_failed(frame);
    };
    kernel = makeKernel(runtime, "where", host, {{x, AccessKind::Write}}, 2);
    kernel->setDeviceImage(
        std::make_shared<const DeviceImage>(std::move(image)));
  }

  /// The numbers of blocks and threads of a launch over n iterations.
  Shape launch(int64_t n, uint64_t function = 0) {
    uint64_t args[] = {uint64_t(n), function};
    EXPECT_OK(runtime.launch(*kernel, args, 2, nullptr));
    return {get(*x, {0}), get(*x, {1})};
  }
  /// The numbers of threads of consecutive launches.
  std::vector<double> threads(int64_t n, int count) {
    std::vector<double> all;
    for (int i = 0; i < count; ++i)
      all.push_back(launch(n).second);
    return all;
  }

  Runtime runtime;

private:
  FieldPtr x;
  KernelPtr kernel;
};

class BlockSizes : public ::testing::Test {
protected:
  void SetUp() override {
    setenv("TAI_CUDA_DRIVER", TAI_FAKE_CUDA_LIBRARY, 1);
    setenv("TAI_FAKE_CUDA", "likes-512", 1);
  }
  void TearDown() override {
    unsetenv("TAI_CUDA_DRIVER");
    unsetenv("TAI_FAKE_CUDA");
  }
  /// Keeps the choices in memory; a session keeps them in a folder.
  KeptChoices keep() {
    return {[this](const std::string &key) -> std::optional<std::string> {
              auto found = kept.find(key);
              return found == kept.end() ? std::nullopt
                                         : std::optional(found->second);
            },
            [this](std::string key, std::string bytes) {
              kept[std::move(key)] = std::move(bytes);
            }};
  }
  std::map<std::string, std::string> kept;
};

constexpr int64_t kLarge = int64_t(1) << 21;
/// After this many launches, all sizes have been tried and one has been chosen.
constexpr int kEnough = 40;
} // namespace

//===----------------------------------------------------------------------===//
// Loops that specify their block size
//===----------------------------------------------------------------------===//

TEST_F(BlockSizes, AreThoseThatLoopsSay) {
  Program program({32, 0, 8, 96, 512, 1024});
  auto check = [&](uint64_t function, int threads) {
    // On each of 10 multiprocessors, 2048 threads run at a time.
    double most = 10 * (2048 / threads);
    EXPECT_EQ(program.launch(1, function), Shape(1, threads));
    EXPECT_EQ(program.launch(20, function),
              Shape((20 + threads - 1) / threads, threads));
    EXPECT_EQ(program.launch(640, function),
              Shape((640 + threads - 1) / threads, threads));
    EXPECT_EQ(program.launch(-1, function), Shape(most, threads));
    for (int i = 0; i < kEnough; ++i)
      ASSERT_EQ(program.launch(kLarge, function), Shape(most, threads));
  };
  check(0, 32);
  check(2, 8);
  check(3, 96);
  check(4, 512);
  // This device has registers for 512 threads of such a function.
  check(5, 512);
  // A loop that specifies no size is not affected.
  EXPECT_EQ(program.launch(640, 1), Shape(10, 64));
}

TEST_F(BlockSizes, OfLoopsComeBeforeTheUsualOne) {
  Program program({64, 0});
  program.runtime.setBlockThreads(128);
  EXPECT_EQ(program.launch(12800, 0), Shape(200, 64));
  EXPECT_EQ(program.launch(12800, 1), Shape(100, 128));
}

TEST_F(BlockSizes, AreThereInDeterministicMode) {
  Program program({64, 0});
  program.runtime.setTriesBlocks(false);
  EXPECT_EQ(program.launch(kLarge, 0).second, 64);
  EXPECT_EQ(program.launch(kLarge, 1).second, 256);
}

TEST_F(BlockSizes, StayBelowTheLimit) {
  Program program({32, 512, 0});
  program.runtime.setMostBlockThreads(128);
  EXPECT_EQ(program.launch(12800, 0).second, 32);
  EXPECT_EQ(program.launch(12800, 1).second, 128);
  // Trials do not exceed the maximum.
  for (int i = 0; i < kEnough; ++i)
    EXPECT_LE(program.launch(kLarge, 2).second, 128);
}

//===----------------------------------------------------------------------===//
// From one process to the next
//===----------------------------------------------------------------------===//

TEST_F(BlockSizes, StayForTheNextProcess) {
  {
    Program program({}, "key");
    program.runtime.launcher().onDevice().keepBlockSizes(keep());
    std::vector<double> threads = program.threads(kLarge, kEnough);
    EXPECT_EQ(threads.front(), 256);
    EXPECT_EQ(threads.back(), 512);
    EXPECT_EQ(kept.size(), 1u);
  }
  Program next({}, "key");
  next.runtime.launcher().onDevice().keepBlockSizes(keep());
  // Launches up to the next power of two of iterations share a choice.
  EXPECT_EQ(next.threads(kLarge, kEnough), std::vector<double>(kEnough, 512));
  EXPECT_EQ(next.launch(kLarge / 2 + 1000).second, 512);
  EXPECT_EQ(kept.size(), 1u);
  // Launches with other numbers of iterations have trials of their own.
  EXPECT_EQ(next.threads(2 * kLarge, 3), (std::vector<double>{256, 256, 64}));
  EXPECT_EQ(next.threads(2 * kLarge, kEnough).back(), 512);
  EXPECT_EQ(kept.size(), 2u);
  // Other kernels have trials of their own.
  Program other({}, "other");
  other.runtime.launcher().onDevice().keepBlockSizes(keep());
  EXPECT_EQ(other.threads(kLarge, 3), (std::vector<double>{256, 256, 64}));
  // So have kernels for which not all of the sizes are allowed.
  Program narrow({}, "key");
  narrow.runtime.launcher().onDevice().keepBlockSizes(keep());
  narrow.runtime.setMostBlockThreads(128);
  EXPECT_EQ(narrow.threads(kLarge, 3), (std::vector<double>{128, 128, 64}));
}

// The choice is kept even if the usual size is best.
TEST_F(BlockSizes, StayWhereNothingIsGained) {
  setenv("TAI_FAKE_CUDA", "", 1);
  for (bool first : {true, false}) {
    Program program({}, "key");
    program.runtime.launcher().onDevice().keepBlockSizes(keep());
    std::vector<double> usual(kEnough, 256);
    EXPECT_EQ(program.threads(kLarge, kEnough) == usual, !first);
    EXPECT_EQ(kept.size(), 1u);
  }
}

TEST_F(BlockSizes, AreFoundAgainWhereAnEntryIsNone) {
  for (std::string bytes : {"", "512 ", "513", "all of them", "512 any"}) {
    if (!kept.empty())
      kept.begin()->second = bytes;
    Program program({}, "key");
    program.runtime.launcher().onDevice().keepBlockSizes(keep());
    std::vector<double> threads = program.threads(kLarge, kEnough);
    EXPECT_EQ(threads[2], 64) << bytes;
    EXPECT_EQ(threads.back(), 512);
    ASSERT_EQ(kept.size(), 1u);
    EXPECT_EQ(kept.begin()->second, "512");
  }
}

TEST_F(BlockSizes, AreNotKeptWithoutTrials) {
  auto run = [&](auto prepare, std::string key = "key",
                 std::vector<int64_t> sizes = {}) {
    Program program(std::move(sizes), std::move(key));
    program.runtime.launcher().onDevice().keepBlockSizes(keep());
    prepare(program.runtime);
    double last = program.threads(kLarge, kEnough).back();
    EXPECT_TRUE(kept.empty());
    return last;
  };
  auto nothing = [](Runtime &) {};
  EXPECT_EQ(run([](Runtime &r) { r.setTriesBlocks(false); }), 256);
  EXPECT_EQ(run([](Runtime &r) { r.setBlockThreads(128); }), 128);
  EXPECT_EQ(run(nothing, "key", {64}), 64);
  // Without a cache, the compiler computes no key, and only this process uses
  // the choices.
  EXPECT_EQ(run(nothing, ""), 512);
  EXPECT_EQ(run([](Runtime &r) { r.launcher().onDevice().keepBlockSizes({}); }),
            512);
}

// The choices in a folder of the cache, with possible defects of an entry.
TEST_F(BlockSizes, LieInTheCache) {
  std::string folder = ::testing::TempDir() + "tai-block-sizes-XXXXXX";
  ASSERT_NE(mkdtemp(folder.data()), nullptr);
  std::string entry;
  std::vector<std::string> warnings;
  auto run = [&] {
    auto store = std::make_shared<CacheStore>(
        folder, 1 << 30,
        [&](const std::string &text) { warnings.push_back(text); });
    Program program({}, "key");
    program.runtime.launcher().onDevice().keepBlockSizes(
        {[&, store](const std::string &key) {
           entry = folder + "/" + CacheStore::fileName(key);
           return store->get(key);
         },
         [store](std::string key, std::string bytes) {
           store->putLater(std::move(key), std::move(bytes));
         }});
    return program.threads(kLarge, kEnough);
  };
  EXPECT_EQ(run()[2], 64);
  EXPECT_EQ(run(), std::vector<double>(kEnough, 512));
  ASSERT_EQ(truncate(entry.c_str(), 60), 0);
  EXPECT_EQ(run()[2], 64);
  EXPECT_EQ(warnings.size(), 1u);
  EXPECT_EQ(run(), std::vector<double>(kEnough, 512));
  // A change of one byte is detected.
  std::fstream file(entry, std::ios::binary | std::ios::in | std::ios::out);
  file.seekp(-1, std::ios::end);
  file.put('3');
  file.close();
  std::vector<double> threads = run();
  EXPECT_EQ(threads[2], 64);
  EXPECT_EQ(threads.back(), 512);
  EXPECT_EQ(run(), std::vector<double>(kEnough, 512));
  unlink(entry.c_str());
  rmdir(folder.c_str());
}
#endif // TAI_FAKE_CUDA_LIBRARY
