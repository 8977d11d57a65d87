//===- RecordedLaunchesTest.cpp - Recordings that come again --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Uses a CUDA driver that needs no GPU and counts its calls. Whatever the queue
// collects, memory must be the same as if each operation had run alone.
//
//===----------------------------------------------------------------------===//

#include "../../../../lib/Runtime/Queue/RecordedLaunches.h"
#include "../../Utils/FakeCudaTest.h"
#include <cstring>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

#ifdef TAI_FAKE_CUDA_LIBRARY
namespace {
class RecordedAgain : public FakeCudaSteps {
protected:
  void SetUp() override { open(""); }

  /// Opens a queue that collects everything that is repeated, and keeps
  /// launches for as long as needed.
  void open(const char *trouble, const char *collect = "1") {
    setenv("TAI_KEEP_LAUNCHES_US", "1000000000", 1);
    setenv("TAI_COLLECT_RECORDINGS", collect, 1);
    openSteps(trouble);
  }

  /// Runs launches that do not commute.
  void forward(double value = 0.25, int count = 6) {
    for (int i = 0; i < count; ++i)
      apply(i % 2 ? scale : add, i % 2 ? 0.5 : value + i);
  }
  void sweep() {
    queue->beginCollecting();
    for (double value : {0.5, 0.75, 1.5}) {
      apply(scale, value);
      apply(add, -value);
    }
    EXPECT_OK(queue->endCollecting());
  }
  void iterate(double value = 0.25, int count = 6) {
    EXPECT_OK(queue->beginRecording());
    forward(value, count);
    EXPECT_OK(queue->endRecording(/*isSwept=*/true));
    sweep();
  }
  /// Repeats a step until all trials have ended.
  template <typename Step> void learn(const Step &step) {
    for (int i = 0; i < 14; ++i)
      step();
  }
  void learn() {
    learn([&] { iterate(); });
  }
};
} // namespace

TEST_F(RecordedAgain, OneSubmissionForRecordingAndSweep) {
  for (int i = 0; i < 2; ++i) {
    int before = submissions();
    iterate();
    EXPECT_GE(submissions() - before, 6);
  }
  learn();
  int before = submissions();
  for (int i = 0; i < 10; ++i)
    iterate();
  EXPECT_EQ(submissions() - before, 10);
  expectAsOneByOne();
  std::string text = queue->explain();
  EXPECT_NE(text.find("times collected as those before"), std::string::npos)
      << text;
}

TEST_F(RecordedAgain, TheSequenceIsThatOfAReplay) {
  learn();
  int before = submissions();
  queue->beginCollecting(/*isReplay=*/true);
  forward();
  for (double value : {0.5, 0.75, 1.5}) {
    apply(scale, value);
    apply(add, -value);
  }
  EXPECT_OK(queue->endCollecting());
  EXPECT_EQ(submissions() - before, 1);
  expectAsOneByOne();
}

TEST_F(RecordedAgain, ParametersThatChange) {
  learn();
  int before = submissions();
  for (int i = 0; i < 10; ++i)
    iterate(i / 8.0);
  EXPECT_EQ(submissions() - before, 10);
  expectAsOneByOne();
}

TEST_F(RecordedAgain, TheStepIsPartOfTheNextRecording) {
  auto both = [&](double rate) {
    iterate();
    apply(scale, rate);
  };
  learn([&] { both(0.5); });
  int before = submissions();
  for (int i = 0; i < 10; ++i)
    both(0.5 + i / 64.0);
  EXPECT_EQ(submissions() - before, 10);
  expectAsOneByOne();
  EXPECT_EQ(submissions() - before, 11);
}

TEST_F(RecordedAgain, NothingWaitsWithoutASweep) {
  auto record = [&] {
    EXPECT_OK(queue->beginRecording());
    forward();
    EXPECT_OK(queue->endRecording(/*isSwept=*/false));
  };
  learn(record);
  int before = submissions();
  record();
  EXPECT_EQ(submissions() - before, 1);
  int after = submissions();
  EXPECT_OK(queue->synchronize());
  EXPECT_EQ(submissions(), after);
  expectAsOneByOne();
}

TEST_F(RecordedAgain, ASweepThatDoesNotCome) {
  learn();
  double zero = 0;
  const std::pair<const char *, std::function<void()>> others[] = {
      {"synchronize", [&] { EXPECT_OK(queue->synchronize()); }},
      {"a launch", [&] { apply(add, 3); }},
      {"a copy", [&] { EXPECT_OK(queue->copy(y, x, 8)); }},
      {"a recording",
       [&] {
         EXPECT_OK(queue->beginRecording());
         forward();
         EXPECT_OK(queue->endRecording(false));
       }},
      {"memory that is lent",
       [&] {
         EXPECT_OK(queue->share());
         queue->unshare();
       }},
      {"the profiler",
       [&] {
         queue->setOneByOne(true);
         queue->setOneByOne(false);
       }},
      {"another sweep after a fill",
       [&] {
         EXPECT_OK(queue->fill(y, &zero, 8, n));
         sweep();
       }},
  };
  for (const auto &[name, something] : others) {
    SCOPED_TRACE(name);
    EXPECT_OK(queue->beginRecording());
    int before = submissions();
    forward();
    EXPECT_OK(queue->endRecording(/*isSwept=*/true));
    EXPECT_EQ(submissions(), before);
    something();
    EXPECT_GT(submissions(), before);
    expectAsOneByOne();
    for (int i = 0; i < 3; ++i)
      iterate();
    expectAsOneByOne();
  }
}

TEST_F(RecordedAgain, WhateverElseComesQueuesThemFirst) {
  std::unique_ptr<DeviceEvent> event;
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
      {"memory of others", [&] { return queue->settle(); }},
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
    learn();
    EXPECT_OK(queue->beginRecording());
    int before = submissions();
    apply(add, 0.25);
    apply(scale, 0.5);
    EXPECT_EQ(submissions(), before);
    EXPECT_OK(something());
    EXPECT_GE(submissions(), before + 2);
    expectAsOneByOne();
    apply(add, 7);
    EXPECT_OK(queue->endRecording(/*isSwept=*/true));
    sweep();
    expectAsOneByOne();
    // The queue continues as before.
    for (int i = 0; i < 4; ++i)
      iterate(i / 8.0);
    expectAsOneByOne();
    if (std::string(name) == "loan")
      queue->unshare();
    event.reset();
  }
}

TEST_F(RecordedAgain, ReadsInTheMiddleMakeTwoSequences) {
  auto record = [&] {
    EXPECT_OK(queue->beginRecording());
    forward();
    expectAsOneByOne();
    forward(0.5, 8);
    EXPECT_OK(queue->endRecording(/*isSwept=*/true));
    sweep();
  };
  for (int i = 0; i < 30; ++i)
    record();
  int before = submissions();
  for (int i = 0; i < 5; ++i)
    record();
  EXPECT_EQ(submissions() - before, 10);
  expectAsOneByOne();
}

TEST_F(RecordedAgain, ALaunchThatIsNotExpectedComesInItsPlace) {
  learn();
  EXPECT_OK(queue->beginRecording());
  int before = submissions();
  apply(add, 0.25);
  apply(scale, 0.5);
  apply(scale, 0.75);
  EXPECT_EQ(submissions() - before, 3);
  apply(add, 3);
  EXPECT_EQ(submissions() - before, 4);
  EXPECT_OK(queue->endRecording(/*isSwept=*/true));
  sweep();
  expectAsOneByOne();
  iterate();
  expectAsOneByOne();
}

TEST_F(RecordedAgain, RecordingsOfSeveralLengths) {
  for (int i = 0; i < 60; ++i)
    iterate(0.25, i % 3 == 0 ? 4 : i % 3 == 1 ? 6 : 9);
  int before = submissions();
  for (int i = 0; i < 9; ++i)
    iterate(i / 4.0, i % 3 == 0 ? 4 : i % 3 == 1 ? 6 : 9);
  EXPECT_EQ(submissions() - before, 9);
  // A sequence that ends in the middle of all previous sequences.
  iterate(0.5, 5);
  expectAsOneByOne();
}

TEST_F(RecordedAgain, WhatIsCollectedForNothingTwiceIsNotCollected) {
  learn();
  auto readEarly = [&] {
    EXPECT_OK(queue->beginRecording());
    forward(0.25, 3);
    expectAsOneByOne();
    apply(scale, 0.75);
    EXPECT_OK(queue->endRecording(/*isSwept=*/true));
    sweep();
  };
  for (int i = 0; i < 2; ++i)
    readEarly();
  // The sequence must be repeated four times to be collected again.
  for (int i = 0; i < 6; ++i) {
    EXPECT_OK(queue->beginRecording());
    int before = submissions();
    forward();
    EXPECT_EQ(submissions() - before, i < 4 ? 6 : 0) << i;
    EXPECT_OK(queue->endRecording(/*isSwept=*/true));
    sweep();
  }
  expectAsOneByOne();
}

TEST_F(RecordedAgain, CopiesOfWhatTapesKeepArePartOfIt) {
  DevicePtr kept = 0;
  auto record = [&] {
    ASSERT_OK(queue->allocate(n * 8, kept));
    EXPECT_OK(queue->beginRecording());
    forward();
    EXPECT_OK(queue->copyKept({kept, n * 8, n * 8, 1}, x, n * 8));
    double value = expected;
    forward(0.75);
    EXPECT_OK(queue->endRecording(/*isSwept=*/true));
    queue->beginCollecting();
    EXPECT_OK(queue->swapRows({x, n * 8, n * 8, 1}, kept, n * 8));
    expected = value;
    apply(add, 0.5);
    EXPECT_OK(queue->endCollecting());
    queue->free(kept);
  };
  learn(record);
  int before = submissions();
  record();
  expectAsOneByOne();
  EXPECT_EQ(submissions() - before, 1);
}

TEST_F(RecordedAgain, MemoryIsFreeOnlyWhenItIsUsedNoMore) {
  learn();
  DevicePtr spare = 0;
  ASSERT_OK(queue->allocate(n * 8, spare));
  int64_t held = queue->allocatedBytes();
  EXPECT_OK(queue->beginRecording());
  forward();
  queue->free(spare);
  EXPECT_EQ(queue->allocatedBytes(), held);
  EXPECT_OK(queue->endRecording(/*isSwept=*/true));
  sweep();
  EXPECT_EQ(queue->allocatedBytes(), held - n * 8);
  expectAsOneByOne();
}

TEST_F(RecordedAgain, ProgramsGoWithTheirCode) {
  std::unique_ptr<DeviceModule> other;
  DeviceImage image{DeviceKind::Cuda, "//", {"scale"}, {}, nullptr};
  ASSERT_OK(queue->load(image, other));
  DeviceFunction *mine = scale;
  ASSERT_OK(queue->find(*other, "scale", scale));
  learn();
  scale = mine;
  EXPECT_NE(queue->explain().find("12 steps"), std::string::npos);
  other.reset();
  EXPECT_EQ(queue->explain().find("12 steps"), std::string::npos);
  learn();
  expectAsOneByOne();
}

TEST_F(RecordedAgain, OffWhereLaunchesAreNotFused) {
  queue->setMode(ProgramMode::Launches);
  learn();
  int before = submissions();
  iterate();
  EXPECT_EQ(submissions() - before, 12);
  open("", /*collect=*/"0");
  learn();
  before = submissions();
  iterate();
  EXPECT_EQ(submissions() - before, 7);
  expectAsOneByOne();
  open("");
  queue->setOneByOne(true);
  learn();
  before = submissions();
  EXPECT_OK(queue->beginRecording());
  forward();
  EXPECT_EQ(submissions() - before, 6);
  EXPECT_OK(queue->endRecording(/*isSwept=*/true));
  sweep();
  expectAsOneByOne();
}

TEST_F(RecordedAgain, DevicesWithoutGraphs) {
  open("no-graphs");
  learn();
  learn();
  expectAsOneByOne();
}
#endif // TAI_FAKE_CUDA_LIBRARY

//===----------------------------------------------------------------------===//
// Whether it pays
//===----------------------------------------------------------------------===//

namespace {
/// Recordings of `count` launches, each of which takes the host `launchNs`.
class RecordedPays : public ::testing::Test {
protected:
  void SetUp() override { unsetenv("TAI_COLLECT_RECORDINGS"); }

  void record() {
    launches.begin();
    for (int i = 0; i < count; ++i)
      if (!launches.expects({nullptr, 1, 32, i}))
        launches.timed([] {
          int64_t start = RecordedLaunches::now();
          while (RecordedLaunches::now() - start < launchNs)
            ;
          return 0;
        });
  }
  /// Whether the recording was collected and then ran as one sequence.
  bool iterate(double chosenMs, double graphMs = -1, bool isPrepared = true) {
    record();
    if (!launches.interrupt())
      return false;
    EXPECT_TRUE(launches.hasRun());
    launches.judge({isPrepared, chosenMs, graphMs, 2 * count, 0});
    EXPECT_FALSE(launches.hasRun());
    return true;
  }
  static constexpr int count = 40, launchNs = 10000;
  RecordedLaunches launches;
};
} // namespace

TEST_F(RecordedPays, WhereTheDeviceIsQuickerThanTheHostLaunches) {
  EXPECT_FALSE(iterate(0));
  EXPECT_FALSE(iterate(0));
  // Half of the steps are launches of the recording: the device takes 0.05 ms
  // for these, the host at least 0.4 ms.
  for (int i = 0; i < 10; ++i)
    EXPECT_TRUE(iterate(0.1)) << i;
  EXPECT_EQ(launches.explain().find("at once"), std::string::npos);
}

TEST_F(RecordedPays, NotWhereTheDeviceTakesLong) {
  iterate(0);
  iterate(0);
  // Without a measured time (-1), sequences continue to be collected.
  for (int i = 0; i < 6; ++i)
    EXPECT_TRUE(iterate(-1)) << i;
  for (int i = 0; i < 3; ++i)
    EXPECT_TRUE(iterate(1e6)) << i;
  EXPECT_FALSE(iterate(1e6));
  std::string text = launches.explain();
  EXPECT_NE(text.find("recordings of 40 launches are launched at once"),
            std::string::npos)
      << text;
}

TEST_F(RecordedPays, WhereLaunchesOneByOneTakeTheDeviceLonger) {
  iterate(0);
  iterate(0);
  for (int i = 0; i < 10; ++i)
    EXPECT_TRUE(iterate(1e6, 3e6)) << i;
}

TEST_F(RecordedPays, NotWhereNoProgramComesOfIt) {
  iterate(0);
  iterate(0);
  for (int i = 0; i < 3; ++i)
    EXPECT_TRUE(iterate(-1, -1, /*isPrepared=*/false)) << i;
  EXPECT_FALSE(iterate(-1, -1, false));
}
