//===- DeviceInterruptTest.cpp - Waits for a device that are given up -----===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Uses a driver without a GPU, whose function "until" runs until it is told to
// end. Compiled loops are tested from Python.
//
//===----------------------------------------------------------------------===//

#include "../../Utils/FakeCudaTest.h"
#include "tai/Runtime/Threads/Safepoint.h"
#include <atomic>
#include <thread>

#ifdef TAI_FAKE_CUDA_LIBRARY

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

namespace {
class DeviceInterrupts : public FakeCudaTest {
protected:
  void SetUp() override {
    ASSERT_NO_FATAL_FAILURE(openQueue(""));
    DeviceImage image{DeviceKind::Cuda, "//", {"until"}, {}, nullptr};
    ASSERT_OK(queue->load(image, module));
    ASSERT_OK(queue->find(*module, "until", until));
    uint32_t zero = 0;
    for (DevicePtr *memory : {&told, &other}) {
      ASSERT_OK(queue->allocate(8, *memory));
      ASSERT_OK(queue->fill(*memory, &zero, 4, 2));
    }
    queue->setStopWord(told);
  }
  void TearDown() override {
    safepoint::setHandler(nullptr);
    FakeCudaTest::TearDown();
  }

  /// Starts a loop that runs until the number at the address is not zero.
  void start(DevicePtr word) {
    LaunchShape shape;
    shape.threads = 1;
    uint64_t slots[] = {word};
    ASSERT_OK(queue->launch(*until, shape, slots, 1));
  }
  /// Waits for the device, and interrupts the wait as Ctrl-C does.
  Status interruptedWait() {
    safepoint::setHandler([] { return 0; });
    std::atomic<bool> isOver{false};
    std::thread clock([&] {
      while (!isOver) {
        safepoint::request();
        std::this_thread::yield();
      }
    });
    Status status = queue->synchronize();
    isOver = true;
    clock.join();
    safepoint::setHandler(nullptr);
    return status;
  }
  // The memory of this device is host memory.
  static uint32_t &at(DevicePtr word, int which = 0) {
    return reinterpret_cast<uint32_t *>(word)[which];
  }

  DeviceFunction *until = nullptr;
  DevicePtr told = 0, other = 0;
};
} // namespace

TEST_F(DeviceInterrupts, EndLoopsThatAsk) {
  // Twice, since the first interrupt must leave no trace on the device.
  for (int round = 0; round < 2; ++round) {
    at(told, 1) = 0;
    ASSERT_NO_FATAL_FAILURE(start(told));
    EXPECT_EQ(interruptedWait().code(), StatusCode::Interrupted);
    EXPECT_EQ(at(told, 1), safepoint::threadNumber());
    EXPECT_EQ(at(told), 0u) << "the next kernel would end, too";
    EXPECT_OK(queue->synchronize());
  }
}

TEST_F(DeviceInterrupts, LeaveOtherLoopsToThemselves) {
  ASSERT_NO_FATAL_FAILURE(start(other));
  EXPECT_EQ(interruptedWait().code(), StatusCode::Interrupted);
  EXPECT_EQ(at(other, 1), 0u);
  at(other) = 1;
  EXPECT_OK(queue->synchronize());
  EXPECT_EQ(at(other, 1), 1u);
  EXPECT_EQ(at(told), 0u);
}

TEST_F(DeviceInterrupts, AreToldToLoopsThatLookLate) {
  // As if other processes used the GPU: meanwhile, no work of this process
  // runs.
  ASSERT_NO_FATAL_FAILURE(start(other));
  EXPECT_EQ(interruptedWait().code(), StatusCode::Interrupted);
  EXPECT_EQ(at(told), safepoint::threadNumber());
  at(other) = 1;
  EXPECT_OK(queue->synchronize());
  EXPECT_EQ(at(told), 0u) << "the next kernel would end, too";
}

TEST_F(DeviceInterrupts, TellNobodyWithoutAWord) {
  queue->setStopWord(0);
  ASSERT_NO_FATAL_FAILURE(start(told));
  EXPECT_EQ(interruptedWait().code(), StatusCode::Interrupted);
  EXPECT_EQ(at(told, 1), 0u);
}

TEST_F(DeviceInterrupts, DoNotCountWhereNothingRuns) {
  EXPECT_OK(interruptedWait());
  EXPECT_EQ(at(told), 0u);
}

TEST(ThreadNumbers, Differ) {
  uint32_t mine = safepoint::threadNumber(), others = 0;
  std::thread([&] { others = safepoint::threadNumber(); }).join();
  EXPECT_NE(mine, 0u);
  EXPECT_NE(others, 0u);
  EXPECT_NE(mine, others);
  EXPECT_EQ(mine, safepoint::threadNumber());
}

#endif // TAI_FAKE_CUDA_LIBRARY
