//===- BackgroundTest.cpp - Work ahead of need ----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Tests how jobs end when the process ends, forks, or has no more threads.
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Compile/Background.h"
#include "gtest/gtest.h"
#include <atomic>
#include <pthread.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>
#include <vector>

using namespace mlir::tai;

namespace {
/// A job that has begun, and finishes its work once `goesOn` is set.
struct HalfDone {
  explicit HalfDone(Background &background)
      : job(background.start([this] {
          begun = true;
          while (!goesOn)
            std::this_thread::yield();
          for (int i = 0; i < 1 << 24; ++i)
            steps.fetch_add(1, std::memory_order_relaxed);
        })) {
    while (!begun)
      std::this_thread::yield();
  }
  bool isWhole() const { return steps == 1 << 24; }

  std::atomic<bool> begun{false}, goesOn{false};
  std::atomic<int> steps{0};
  Background::JobPtr job;
};
} // namespace

TEST(Background, StopsWhenItsJobIsDone) {
  Background background(1);
  HalfDone first(background);
  std::atomic<int> ran{0};
  Background::JobPtr second = background.start([&] { ++ran; });
  first.goesOn = true;
  Background::stopAll();
  EXPECT_TRUE(first.isWhole());
  Background::JobPtr third = background.start([&] { ++ran; });
  EXPECT_EQ(ran, 0);
  background.finish(*second);
  background.finish(*third);
  EXPECT_EQ(ran, 2);
}

namespace {
/// A job that waits, for something that never comes, until its wish is no
/// longer Wait.
struct Waiting {
  explicit Waiting(Background &background)
      : job(background.start([this] {
          while ((wish = Background::getWish()) == Background::Wish::Wait)
            begun = true;
        })) {
    while (!begun)
      std::this_thread::yield();
  }

  std::atomic<Background::Wish> wish{Background::Wish::Wait};
  std::atomic<bool> begun{false};
  Background::JobPtr job;
};
} // namespace

TEST(Background, JobsThatNobodyWantsDoNotWait) {
  Background background(1);
  Waiting dropped(background);
  background.cancel(*dropped.job);
  EXPECT_EQ(dropped.wish, Background::Wish::Abandon);
  // At the end of the process, a waiting job is told to hurry.
  Waiting last(background);
  background.stop();
  EXPECT_EQ(last.wish, Background::Wish::Hurry);
}

TEST(Background, ForksDoNotWaitForOthers) {
  Background background(1);
  Waiting waiting(background);
  pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0)
    _exit(0);
  waitpid(child, nullptr, 0);
  background.finish(*waiting.job);
  EXPECT_EQ(waiting.wish, Background::Wish::Hurry);
}

/// The number of jobs that the calling thread has run, including this one.
static int countOnThisThread() {
  static thread_local int count = 0;
  return ++count;
}

TEST(Background, ThreadsServeAgain) {
  Background background(1);
  int last = 0;
  for (int i = 1; i <= 3; ++i) {
    EXPECT_TRUE(background.runAside([&] { last = countOnThisThread(); }));
    EXPECT_EQ(last, i);
  }
  // Also after a fork, which ends them.
  pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0)
    _exit(0);
  waitpid(child, nullptr, 0);
  for (int i = 1; i <= 2; ++i) {
    EXPECT_TRUE(background.runAside([&] { last = countOnThisThread(); }));
    EXPECT_EQ(last, i);
  }
}

TEST(Background, WhatIsWaitedForWaitsForNoOtherJob) {
  Background background(1);
  EXPECT_TRUE(background.runAside([] {}));
  HalfDone first(background);
  bool ran = false;
  EXPECT_TRUE(background.runAside([&] { ran = true; }));
  EXPECT_TRUE(ran && !first.isWhole());
  // Jobs that several threads start at once do not wait either.
  std::atomic<int> begun{0};
  std::vector<std::thread> callers;
  for (int i = 0; i < 40; ++i)
    callers.emplace_back([&] {
      background.runAside([&] {
        ++begun;
        while (begun != 40)
          std::this_thread::yield();
      });
    });
  for (std::thread &caller : callers)
    caller.join();
  EXPECT_EQ(begun, 40);
  first.goesOn = true;
  background.finish(*first.job);
}

TEST(Background, LeavesNothingUndoneThatIsNeeded) {
  std::atomic<int> ran{0};
  {
    Background background(1);
    HalfDone first(background);
    background.doLater([&] { ++ran; });
    background.doLater([&] { ++ran; });
    first.goesOn = true;
    background.stop();
    EXPECT_EQ(ran, 2);
    // Once stopped, jobs run only when the object is destroyed.
    background.doLater([&] { ++ran; });
    EXPECT_EQ(ran, 2);
  }
  EXPECT_EQ(ran, 3);
}

TEST(Background, ChildrenInheritNoHalfJob) {
  Background background(1);
  HalfDone first(background);
  std::atomic<int> ran{0};
  Background::JobPtr second = background.start([&] { ++ran; });
  first.goesOn = true;
  pid_t child = fork();
  if (child == 0) {
    alarm(200);
    bool good = first.isWhole() && ran == 0;
    background.finish(*first.job);
    background.finish(*second);
    good &= ran == 1;
    background.stop();
    _exit(good ? 0 : 1);
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  background.finish(*second);
  EXPECT_EQ(ran, 1);
}

#if defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__)
TEST(Background, NeedsNoThread) {
  // The address space has no room for such a stack, so that no thread can
  // start.
  pthread_attr_t usual, impossible;
  ASSERT_EQ(pthread_getattr_default_np(&usual), 0);
  ASSERT_EQ(pthread_getattr_default_np(&impossible), 0);
  ASSERT_EQ(pthread_attr_setstacksize(&impossible, size_t(1) << 50), 0);
  ASSERT_EQ(pthread_setattr_default_np(&impossible), 0);
  std::atomic<int> ran{0};
  {
    Background background(2);
    Background::JobPtr job = background.start([&] { ++ran; });
    background.finish(*job);
  }
  EXPECT_EQ(pthread_setattr_default_np(&usual), 0);
  EXPECT_EQ(ran, 1);
}
#endif
