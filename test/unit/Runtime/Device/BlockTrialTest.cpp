//===- BlockTrialTest.cpp - Trials of block sizes -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Uses a device whose time is a counter that launches advance.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Device/BlockTrial.h"
#include "gtest/gtest.h"

using namespace mlir::tai::runtime;

namespace {
struct Instant : DeviceEvent {
  int64_t ns = 0;
};

/// A device that has a clock and nothing else.
class Clock : public Device {
public:
  int64_t now = 0;
  int eventsLeft = 1000, waits = 0;

  Status record(std::unique_ptr<DeviceEvent> &event) override {
    if (eventsLeft-- <= 0)
      return nothing();
    auto instant = std::make_unique<Instant>();
    instant->ns = now;
    event = std::move(instant);
    return Status::success();
  }
  Status wait(DeviceEvent &) override {
    ++waits;
    return Status::success();
  }
  Status elapsed(const DeviceEvent &from, const DeviceEvent &to,
                 int64_t &ns) override {
    ns = static_cast<const Instant &>(to).ns -
         static_cast<const Instant &>(from).ns;
    return Status::success();
  }

  DeviceKind kind() const override { return DeviceKind::Emulated; }
  std::string name() const override { return "clock"; }
  DeviceLimits limits() const override { return {}; }
  std::string target() const override { return ""; }
  Status allocate(int64_t, DevicePtr &) override { return nothing(); }
  void free(DevicePtr) override {}
  int64_t allocatedBytes() const override { return 0; }
  int64_t freeBytes() const override { return 0; }
  Status copyIn(DevicePtr, const void *, int64_t) override { return nothing(); }
  Status copyOut(void *, DevicePtr, int64_t) override { return nothing(); }
  Status copy(DevicePtr, DevicePtr, int64_t) override { return nothing(); }
  Status fill(DevicePtr, const void *, int, int64_t) override {
    return nothing();
  }
  Status copyRows(const DeviceRows &, DevicePtr, int64_t) override {
    return nothing();
  }
  Status swapRows(const DeviceRows &, DevicePtr, int64_t) override {
    return nothing();
  }
  Status fillRows(const DeviceRows &, const void *, int) override {
    return nothing();
  }
  bool isDeviceMemory(const void *) const override { return false; }
  Status load(const DeviceImage &, std::unique_ptr<DeviceModule> &) override {
    return nothing();
  }
  Status find(DeviceModule &, const std::string &, DeviceFunction *&) override {
    return nothing();
  }
  unsigned mostThreads(const DeviceFunction &) const override { return 0; }
  unsigned residentBlocks(const DeviceFunction &, unsigned) const override {
    return 0;
  }
  Status launch(DeviceFunction &, const LaunchShape &, const uint64_t *,
                int) override {
    return nothing();
  }
  Status synchronize() override { return Status::success(); }

private:
  static Status nothing() {
    return Status::failure(StatusCode::Internal, "a clock has nothing else");
  }
};

/// Runs launches that take `costOf(threads)` nanoseconds for each iteration.
struct Launches {
  Clock clock;
  BlockTrial trial{{{256, 8}, {128, 16}, {512, 4}}};
  std::vector<unsigned> sizes;

  void run(int count, std::function<int64_t(unsigned)> costOf,
           int64_t iterations = 1000) {
    for (int i = 0; i < count; ++i)
      ASSERT_TRUE(trial
                      .run(clock, iterations,
                           [&](BlockTrial::Size size) {
                             sizes.push_back(size.threads);
                             clock.now += costOf(size.threads) * iterations;
                             return Status::success();
                           })
                      .ok());
  }
};
} // namespace

TEST(BlockTrial, KeepsTheQuickest) {
  Launches launches;
  launches.run(40, [](unsigned threads) { return threads == 512 ? 7 : 10; });
  // Each size is tried three times.
  EXPECT_EQ(
      std::vector<unsigned>(launches.sizes.begin(), launches.sizes.begin() + 7),
      (std::vector<unsigned>{256, 256, 128, 512, 256, 128, 512}));
  EXPECT_EQ(launches.sizes.back(), 512u);
  EXPECT_EQ(launches.trial.best().mostBlocks, 4u);
  EXPECT_EQ(launches.clock.waits, 1);
}

TEST(BlockTrial, ComparesIterations) {
  Launches launches;
  // Launches with one size have ten times as many iterations as those with
  // others.
  int number = 0;
  for (int i = 0; i < 40; ++i, ++number)
    launches.run(
        1, [](unsigned threads) { return threads == 128 ? 8 : 10; },
        number % 3 == 2 ? 10000 : 1000);
  EXPECT_EQ(launches.sizes.back(), 128u);
}

TEST(BlockTrial, StaysWhereLittleIsGained) {
  Launches launches;
  launches.run(40, [](unsigned threads) { return threads == 128 ? 99 : 100; });
  EXPECT_EQ(launches.sizes.back(), 256u);
}

TEST(BlockTrial, GoesOnWithoutEvents) {
  Launches launches;
  launches.clock.eventsLeft = 5;
  launches.run(40, [](unsigned threads) { return threads == 128 ? 1 : 100; });
  EXPECT_EQ(launches.sizes.size(), 40u);
  EXPECT_EQ(launches.sizes.back(), 256u);
  EXPECT_EQ(launches.clock.waits, 0);
}
