//===- SectionTest.cpp - Handlers and threads in the middle of work -------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Threads/Section.h"
#include "../../Utils/FakeCudaTest.h"
#include "tai/Runtime/Mirror/OwedZeros.h"
#include <atomic>
#include <thread>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

//===----------------------------------------------------------------------===//
// Handlers
//===----------------------------------------------------------------------===//

namespace {
/// The action of the signal handler in a test; handlers are plain functions.
std::function<void()> handled;

class Sections : public ::testing::Test {
protected:
  void SetUp() override {
    safepoint::setHandler([] {
      handled();
      return 1;
    });
  }
  void TearDown() override {
    safepoint::setHandler(nullptr);
    handled = nullptr;
  }
};
} // namespace

TEST_F(Sections, MayNestInTheirOwnWork) {
  Section section;
  Section::Entry outer(section);
  Section::Entry inner(section);
  EXPECT_OK(outer.check());
  EXPECT_OK(inner.check());
}

TEST_F(Sections, AreClosedToHandlersInTheirMiddle) {
  Section section, other;
  int calls = 0;
  handled = [&] {
    ++calls;
    EXPECT_EQ(safepoint::handlerDepth(), 1u);
    EXPECT_EQ(Section::Entry(section).check().code(), StatusCode::Usage);
    Section::Entry entry(other);
    EXPECT_OK(entry.check());
    // The handler may enter a section for its own work.
    EXPECT_OK(Section::Entry(other).check());
  };
  {
    Section::Entry entry(section);
    EXPECT_TRUE(safepoint::look());
    // The interrupted work continues after the handler.
    EXPECT_OK(Section::Entry(section).check());
  }
  EXPECT_EQ(calls, 1);
  EXPECT_EQ(safepoint::handlerDepth(), 0u);
  handled = [&] { EXPECT_OK(Section::Entry(section).check()); };
  EXPECT_TRUE(safepoint::look());
}

// Work that restores values is not stopped half-way, whereas the handler's own
// work may stop.
TEST_F(Sections, GoOnWhileTheyAreUnstoppable) {
  static int inner;
  inner = 0;
  safepoint::setHandler([] {
    if (safepoint::handlerDepth() == 1) {
      EXPECT_FALSE(safepoint::Unstoppable::wasAsked());
      inner += safepoint::look() ? 1 : 100;
    }
    return 0;
  });
  EXPECT_FALSE(safepoint::look());
  EXPECT_EQ(inner, 100);
  int64_t done = 0;
  auto copy = [&] {
    return safepoint::runInPieces(1000, 10, /*canStop=*/true,
                                  [&](int64_t, int64_t count) {
                                    done += count;
                                    return Status::success();
                                  });
  };
  {
    safepoint::Unstoppable whole;
    EXPECT_FALSE(safepoint::Unstoppable::wasAsked());
    {
      safepoint::Unstoppable nested;
      EXPECT_OK(copy());
    }
    EXPECT_EQ(done, 1000);
    EXPECT_TRUE(safepoint::Unstoppable::wasAsked());
    EXPECT_EQ(inner % 100, 0);
  }
  EXPECT_FALSE(safepoint::Unstoppable::wasAsked());
  EXPECT_EQ(copy().code(), StatusCode::Interrupted);
  EXPECT_EQ(done, 1000);
}

TEST_F(Sections, AreClosedToHandlersOfHandlers) {
  Section section;
  int depth = 0;
  handled = [&] {
    if (++depth == 2) {
      EXPECT_TRUE(Section::Entry(section).isAgain());
      return;
    }
    Section::Entry entry(section);
    EXPECT_FALSE(entry.isAgain());
    EXPECT_TRUE(safepoint::look());
  };
  EXPECT_TRUE(safepoint::look());
  EXPECT_EQ(depth, 2);
}

#ifdef TAI_FAKE_CUDA_LIBRARY

namespace {
class DeviceHandlers : public FakeCudaTest {
protected:
  void TearDown() override {
    safepoint::setHandler(nullptr);
    handled = nullptr;
    FakeCudaTest::TearDown();
  }
};
} // namespace

// A copy that waits for a kernel uses pinned memory: copies of a handler, which
// run meanwhile, must not use the same memory.
TEST_F(DeviceHandlers, CopyWhileACopyWaits) {
  ASSERT_NO_FATAL_FAILURE(openQueue(""));
  DeviceImage image{DeviceKind::Cuda, "//", {"until"}, {}, nullptr};
  ASSERT_OK(queue->load(image, module));
  DeviceFunction *until = nullptr;
  ASSERT_OK(queue->find(*module, "until", until));
  DevicePtr word = 0, values = 0;
  uint32_t zero = 0;
  double first[] = {1, 2}, second[] = {0, 0}, third[] = {0, 0};
  ASSERT_OK(queue->allocate(8, word));
  ASSERT_OK(queue->allocate(sizeof(first), values));
  ASSERT_OK(queue->fill(word, &zero, 4, 2));
  ASSERT_OK(queue->copyIn(values, first, sizeof(first)));
  LaunchShape shape;
  shape.threads = 1;
  uint64_t slots[] = {word};
  ASSERT_OK(queue->launch(*until, shape, slots, 1));

  int calls = 0;
  handled = [&] {
    // Nested waits call the handler, too.
    if (calls++ > 0)
      return;
    reinterpret_cast<std::atomic<uint32_t> *>(word)->store(1);
    double mine[] = {7, 8};
    for (int round = 0; round < 2; ++round)
      EXPECT_OK(queue->copyOut(third, values, sizeof(third)));
    EXPECT_OK(queue->copyIn(values, mine, sizeof(mine)));
    EXPECT_OK(queue->copyOut(mine, values, sizeof(mine)));
  };
  safepoint::setHandler([] {
    handled();
    return 1;
  });
  std::atomic<bool> isOver{false};
  std::thread clock([&] {
    while (!isOver) {
      safepoint::request();
      std::this_thread::yield();
    }
  });
  EXPECT_OK(queue->copyOut(second, values, sizeof(second)));
  isOver = true;
  clock.join();
  EXPECT_GT(calls, 0);
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(second[i], first[i]);
    EXPECT_EQ(third[i], first[i]);
  }
}

#endif // TAI_FAKE_CUDA_LIBRARY

//===----------------------------------------------------------------------===//
// Threads
//===----------------------------------------------------------------------===//

// All users of a field check whether it still needs zeros to be stored; the
// check returns once the zeros are stored.
TEST(OwedZerosOfThreads, AreStoredOnceAndSeenByAll) {
  constexpr int64_t n = 1 << 12;
  constexpr int numThreads = 4, rounds = 200;
  Runtime runtime;
  FieldPtr field = makeField(runtime, "x", ScalarKind::F64, {n});
  auto zeros = std::make_shared<OwedZeros>();
  zeros->boxes.push_back({{0}, {n / 2}});
  std::vector<double> ones(n, 1.0);
  std::atomic<int> round{0}, arrived{0}, wrong{0};
  std::vector<std::thread> threads;
  for (int t = 0; t < numThreads; ++t)
    threads.emplace_back([&] {
      for (int r = 1; r <= rounds; ++r) {
        while (round.load(std::memory_order_acquire) < r)
          std::this_thread::yield();
        if (std::shared_ptr<const OwedZeros> owed = field->owedZeros())
          wrong += !owed->contains(0, n / 2 - 1);
        int64_t last = n / 2 - 1;
        double value = -1;
        wrong += !field->readF64(&last, 0, value) || value != 0;
        ++arrived;
      }
    });
  for (int r = 1; r <= rounds; ++r) {
    EXPECT_OK(runtime.writes().copyIn(*field, ones.data()));
    field->oweZeros(zeros);
    EXPECT_TRUE(field->owesZeros());
    round.store(r, std::memory_order_release);
    while (arrived < r * numThreads)
      std::this_thread::yield();
    EXPECT_FALSE(field->owesZeros());
  }
  for (std::thread &thread : threads)
    thread.join();
  EXPECT_EQ(wrong, 0);
  EXPECT_EQ(get(*field, {n - 1}), 1.0);
}

// Tapes begin and end while other threads query whether there are tapes, and
// number their own.
TEST(TapesOfThreads, AreListedUnderALock) {
  constexpr int numThreads = 4, rounds = 200;
  Runtime runtime;
  std::atomic<int> failures{0};
  std::vector<std::thread> threads;
  std::vector<FieldPtr> losses;
  for (int t = 0; t < numThreads; ++t)
    losses.push_back(makeDifferentiable(runtime, "loss" + std::to_string(t),
                                        ScalarKind::F64, {}));
  for (int t = 0; t < numThreads; ++t)
    threads.emplace_back([&, t] {
      for (int r = 0; r < rounds; ++r) {
        std::unique_ptr<Tape> tape;
        failures += !runtime.beginTape(losses[t], false, tape);
        (void)runtime.recordings().needsValues(*losses[t]);
        failures += !runtime.recordings().areThereTapes();
        if (tape)
          tape->end();
      }
    });
  for (std::thread &thread : threads)
    thread.join();
  EXPECT_EQ(failures, 0);
  EXPECT_FALSE(runtime.recordings().areThereTapes());
}
