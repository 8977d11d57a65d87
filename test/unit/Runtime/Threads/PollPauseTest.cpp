//===- PollPauseTest.cpp - Pauses between the polls of a wait -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Threads/PollPause.h"
#include "gtest/gtest.h"

using namespace mlir::tai::runtime;
using namespace std::chrono_literals;

TEST(PollPause, ShortWaitsSpin) {
  for (PollPause::Duration waited : {0ms, 1ms, 19ms})
    EXPECT_EQ(PollPause::sleepAfter(waited), 0ms);
}

TEST(PollPause, LongWaitsSleepForASmallPart) {
  for (PollPause::Duration waited : {20ms, 100ms, 1000ms}) {
    EXPECT_GT(PollPause::sleepAfter(waited), 0ms);
    EXPECT_LE(PollPause::sleepAfter(waited), waited / 200);
  }
}

TEST(PollPause, HandlersOfSignalsRunSoon) {
  EXPECT_LE(PollPause::sleepAfter(1h), 10ms);
}
