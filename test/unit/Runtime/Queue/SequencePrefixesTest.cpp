//===- SequencePrefixesTest.cpp - Launches between replays ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Uses a CUDA driver that needs no GPU and counts its calls. Whatever launches
// the queue keeps, memory must be the same as if each operation had run alone.
//
//===----------------------------------------------------------------------===//

#include "../../Utils/FakeCudaTest.h"
#include <cstring>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

#ifdef TAI_FAKE_CUDA_LIBRARY
namespace {
class KeptLaunches : public FakeCudaSteps {
protected:
  void SetUp() override { open(""); }

  /// Opens a queue that keeps launches for as long as needed.
  void open(const char *trouble, const char *longestUs = "1000000000") {
    setenv("TAI_KEEP_LAUNCHES_US", longestUs, 1);
    openSteps(trouble);
  }

  /// Replays work that does not commute with the steps after it.
  void replay(double value = 0.25, int extra = 0, bool isReplay = true) {
    queue->beginCollecting(isReplay);
    apply(scale, 0.5);
    apply(add, value);
    apply(scale, 1.5);
    apply(add, -0.125);
    for (int i = 0; i < extra; ++i)
      apply(scale, 0.75);
    EXPECT_OK(queue->endCollecting());
  }
  /// Repeats the step until all trials have ended and the step is known.
  template <typename Step> void learn(const Step &step) {
    for (int i = 0; i < 12; ++i) {
      replay();
      step();
    }
  }
  void learn() {
    learn([&] { apply(scale, 0.875); });
  }
};
} // namespace

TEST_F(KeptLaunches, OneSubmissionForReplayAndStep) {
  learn();
  int before = submissions(), records = counter("records"),
      changes = counter("changes");
  for (int i = 0; i < 10; ++i) {
    replay();
    apply(scale, 0.875 - i / 64.0);
  }
  EXPECT_EQ(submissions() - before, 10);
  EXPECT_EQ(counter("records"), records);
  // The first has the factor that it had before.
  EXPECT_EQ(counter("changes") - changes, 8);
  expectAsOneByOne();
  EXPECT_EQ(submissions() - before, 11);
  std::string text = queue->explain();
  EXPECT_NE(text.find("with scale before it"), std::string::npos) << text;
  EXPECT_NE(text.find("as one graph"), std::string::npos) << text;
}

TEST_F(KeptLaunches, SeveralLaunchesAndFillsAmongThem) {
  auto step = [&](double rate) {
    apply(scale, rate);
    double zero = 0;
    EXPECT_OK(queue->fill(y, &zero, 8, n));
    apply(add, 1 - rate);
    apply(scale, 2 - rate);
  };
  learn([&] { step(0.5); });
  int before = submissions();
  for (int i = 0; i < 10; ++i) {
    replay();
    step(0.5 + i / 32.0);
  }
  EXPECT_EQ(submissions() - before, 10);
  expectAsOneByOne();
}

TEST_F(KeptLaunches, ParametersOfTheSequenceChangeToo) {
  learn();
  int before = submissions();
  for (int i = 0; i < 10; ++i) {
    replay(i / 8.0);
    apply(scale, 0.875 - i / 64.0);
  }
  EXPECT_EQ(submissions() - before, 10);
  expectAsOneByOne();
}

TEST_F(KeptLaunches, WhateverElseComesQueuesThemFirst) {
  std::unique_ptr<DeviceEvent> event;
  std::unique_ptr<DeviceModule> other;
  DevicePtr spare = 0;
  double value = 1;
  // Each operation has memory of its own.
  auto rows = [&] { return DeviceRows{y, 8, 8, 2}; };
  const std::pair<const char *, std::function<Status()>> others[] = {
      {"synchronize", [&] { return queue->synchronize(); }},
      {"copy out", [&] { return queue->copyOut(&value, y, 8); }},
      {"copy in", [&] { return queue->copyIn(y, &value, 8); }},
      {"copy", [&] { return queue->copy(y, x, 8); }},
      {"copy of rows", [&] { return queue->copyRows(rows(), x, 8); }},
      {"exchange of rows", [&] { return queue->swapRows(rows(), y + 16, 8); }},
      {"event", [&] { return queue->record(event); }},
      {"a stream waits", [&] { return queue->letStreamWait(4); }},
      {"waits for a stream", [&] { return queue->waitForStream(4); }},
      {"a timed launch", [&] { return queue->interrupt(); }},
      {"free",
       [&] {
         queue->free(spare);
         return Status::success();
       }},
      {"the end of code",
       [&] {
         other.reset();
         return Status::success();
       }},
      {"profiler",
       [&] {
         queue->setOneByOne(true);
         queue->setOneByOne(false);
         return Status::success();
       }},
      {"mode",
       [&] {
         queue->setMode(ProgramMode::Automatic);
         return Status::success();
       }},
      {"loan", [&] { return queue->share(); }},
  };
  for (const auto &[name, something] : others) {
    SCOPED_TRACE(name);
    open("");
    ASSERT_OK(queue->allocate(64, spare));
    ASSERT_OK(queue->load(image(), other));
    learn();
    replay();
    int before = submissions();
    apply(scale, 0.75);
    EXPECT_EQ(submissions(), before);
    EXPECT_OK(something());
    EXPECT_GE(submissions(), before + 1);
    int after = submissions();
    EXPECT_OK(queue->synchronize());
    EXPECT_EQ(submissions(), after);
    expectAsOneByOne();
    // The queue continues as before.
    for (int i = 0; i < 4; ++i) {
      replay();
      apply(scale, 0.75 + i / 32.0);
    }
    expectAsOneByOne();
    if (std::string(name) == "loan")
      queue->unshare();
    event.reset();
    other.reset();
  }
}

TEST_F(KeptLaunches, NothingIsKeptWhileMemoryIsShared) {
  learn();
  EXPECT_OK(queue->share());
  replay();
  int before = submissions();
  apply(scale, 0.75);
  EXPECT_EQ(submissions(), before + 1);
  expectAsOneByOne();
}

TEST_F(KeptLaunches, AnUnexpectedLaunchComesInItsPlace) {
  learn();
  int before = submissions();
  replay();
  apply(scale, 0.75);
  EXPECT_EQ(submissions(), before + 1);
  apply(add, 3);
  // Both launches are submitted.
  EXPECT_EQ(submissions(), before + 3);
  replay();
  apply(add, 5);
  EXPECT_EQ(submissions(), before + 5);
  expectAsOneByOne();
  // The longer step is learnt instead of the shorter one.
  auto longer = [&] {
    apply(scale, 0.75);
    apply(add, 3);
  };
  learn(longer);
  before = submissions();
  for (int i = 0; i < 5; ++i) {
    replay();
    longer();
  }
  EXPECT_EQ(submissions() - before, 5);
  // Fewer launches than expected.
  for (int i = 0; i < 5; ++i) {
    replay();
    apply(scale, 0.75);
  }
  replay();
  expectAsOneByOne();
}

TEST_F(KeptLaunches, TwoSequencesInTurns) {
  auto both = [&](double rate) {
    replay();
    apply(scale, rate);
    replay(0.5, /*extra=*/2);
    apply(add, rate);
  };
  for (int i = 0; i < 12; ++i)
    both(0.5);
  int before = submissions();
  for (int i = 0; i < 6; ++i)
    both(0.5 + i / 64.0);
  EXPECT_EQ(submissions() - before, 12);
  expectAsOneByOne();
}

TEST_F(KeptLaunches, ValuesThatAreReadAfterEachStep) {
  for (int i = 0; i < 14; ++i) {
    replay();
    int before = submissions();
    apply(scale, 0.75);
    EXPECT_EQ(submissions(), before + 1);
    expectAsOneByOne();
  }
}

TEST_F(KeptLaunches, ValuesThatAreReadBeforeEachStep) {
  auto iterate = [&] {
    replay();
    expectAsOneByOne();
    apply(scale, 0.75);
  };
  for (int i = 0; i < 12; ++i)
    iterate();
  int before = submissions();
  for (int i = 0; i < 6; ++i)
    iterate();
  EXPECT_EQ(submissions() - before, 6);
  expectAsOneByOne();
}

TEST_F(KeptLaunches, ValuesThatAreReadNowAndThen) {
  learn();
  int before = submissions();
  for (int i = 0; i < 20; ++i) {
    replay();
    apply(scale, 0.75);
    if (i % 5 == 4)
      expectAsOneByOne();
  }
  // The steps after which values were read are submitted separately.
  EXPECT_EQ(submissions() - before, 24);
}

TEST_F(KeptLaunches, WhatIsKeptForNothingTwiceIsNotKept) {
  learn();
  for (int i = 0; i < 2; ++i) {
    replay();
    int before = submissions();
    apply(scale, 0.75);
    EXPECT_EQ(submissions(), before);
    expectAsOneByOne();
  }
  // The step must be repeated four times to be known again.
  for (int i = 0; i < 6; ++i) {
    replay();
    int before = submissions();
    apply(scale, 0.75);
    EXPECT_EQ(submissions() - before, i < 4 ? 1 : 0) << i;
  }
  expectAsOneByOne();
}

TEST_F(KeptLaunches, WhatTakesLongIsNotKept) {
  open("", "-1");
  learn();
  replay();
  int before = submissions();
  apply(scale, 0.75);
  EXPECT_EQ(submissions(), before + 1);
  expectAsOneByOne();
}

TEST_F(KeptLaunches, ManyLaunchesAreNotKept) {
  auto step = [&] {
    for (int i = 0; i < 20; ++i)
      apply(i % 2 ? scale : add, 0.5);
  };
  learn(step);
  replay();
  int before = submissions();
  step();
  EXPECT_EQ(submissions(), before + 20);
  expectAsOneByOne();
}

TEST_F(KeptLaunches, SweepsThatAreNoReplaysTakeNone) {
  learn();
  replay();
  apply(scale, 0.75);
  replay(0.5, 1, /*isReplay=*/false);
  expectAsOneByOne();
}

TEST_F(KeptLaunches, NothingIsKeptWithoutSequences) {
  queue->setMode(ProgramMode::Launches);
  learn();
  replay();
  int before = submissions();
  apply(scale, 0.75);
  EXPECT_EQ(submissions(), before + 1);
  expectAsOneByOne();
}

TEST_F(KeptLaunches, DevicesWithoutGraphs) {
  open("no-graphs");
  learn();
  learn();
  expectAsOneByOne();
}
#endif // TAI_FAKE_CUDA_LIBRARY
