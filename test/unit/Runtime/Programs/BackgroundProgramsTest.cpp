//===- BackgroundProgramsTest.cpp - Programs compiled meanwhile -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A queue whose programs are compiled by jobs that the tests end by hand. Until
// a job ends, the sequence must run as a graph, with the same results
// throughout.
//
//===----------------------------------------------------------------------===//

#include "../../Utils/FakeCudaTest.h"
#include "tai/ABI/DeviceAbi.h"

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

#ifdef TAI_FAKE_CUDA_LIBRARY
namespace {
/// The outcome of a job, shared by the queue and the test.
struct Outcome {
  bool isDone = false;
  bool succeeds = true;
  bool isAbandoned = false;
  int scope = 0;
};

class TestJob final : public ProgramJob {
public:
  TestJob(std::shared_ptr<Outcome> outcome, DeviceImage image)
      : outcome(std::move(outcome)), image(std::move(image)) {}
  ~TestJob() override { outcome->isAbandoned = true; }
  bool isDone() const override { return outcome->isDone; }
  Status take(DeviceImage &taken) override {
    if (!outcome->succeeds)
      return Status::failure(StatusCode::Compile, "the test says so");
    taken = image;
    return Status::success();
  }

private:
  std::shared_ptr<Outcome> outcome;
  DeviceImage image;
};

class BackgroundPrograms : public FakeCudaSteps {
protected:
  void open() {
    openSteps("overlaps");
    // Programs need the bitcode and the key of each kernel.
    DeviceImage known = image();
    known.bitcode = std::make_shared<const std::string>("bitcode");
    known.key = "kernels";
    ASSERT_OK(queue->load(known, module));
    ASSERT_OK(queue->find(*module, "scale", scale));
    ASSERT_OK(queue->find(*module, "add", add));
    jobs.clear();
    queue->setProgramStarter(
        [this](const ProgramPlan &plan) -> std::unique_ptr<ProgramJob> {
          auto outcome = std::make_shared<Outcome>();
          outcome->scope = plan.scope;
          // The fake driver cannot run a kernel that is composed of other
          // kernels.
          outcome->succeeds = plan.scope == TAI_SCOPE_LAUNCHES;
          jobs.push_back(outcome);
          DeviceImage made = image();
          made.functions.clear();
          for (const ProgramPart &part : plan.parts)
            made.functions.push_back(part.function);
          return std::make_unique<TestJob>(outcome, made);
        });
    queue->keepChoices(
        {[this](const std::string &key) -> std::optional<std::string> {
           auto found = kept.find(key);
           if (found == kept.end())
             return std::nullopt;
           return found->second;
         },
         [this](std::string key, std::string bytes) { kept[key] = bytes; }});
  }
  void replay() {
    queue->beginCollecting(/*isReplay=*/true);
    apply(scale, 0.5);
    apply(add, 0.25);
    apply(scale, 1.5);
    apply(add, -0.125);
    EXPECT_OK(queue->endCollecting());
  }
  /// Replays until `isReached`, and checks the result. The bound on replays is
  /// far above the number that run before a compilation begins.
  template <typename Condition> void replayUntil(const Condition &isReached) {
    constexpr int most = 20'000'000;
    int i = 0;
    for (; i < most && !isReached(); ++i)
      replay();
    EXPECT_LT(i, most) << queue->explain();
    expectAsOneByOne();
  }
  bool explains(const char *text) {
    return queue->explain().find(text) != std::string::npos;
  }

  std::vector<std::shared_ptr<Outcome>> jobs;
  std::map<std::string, std::string> kept;
};
} // namespace

TEST_F(BackgroundPrograms, ASequenceThatRunsForAMomentIsNotCompiled) {
  open();
  for (int i = 0; i < 10; ++i)
    replay();
  EXPECT_TRUE(jobs.empty());
  EXPECT_TRUE(explains("a graph (4 nodes)")) << queue->explain();
  EXPECT_TRUE(explains("(used)")) << queue->explain();
  EXPECT_TRUE(explains("not compiled yet")) << queue->explain();
  expectAsOneByOne();
}

TEST_F(BackgroundPrograms, TheGraphRunsUntilThePrograms) {
  open();
  replayUntil([&] { return !jobs.empty(); });
  EXPECT_NE(jobs.front()->scope, TAI_SCOPE_LAUNCHES);
  EXPECT_TRUE(explains("is being compiled")) << queue->explain();
  // Programs are compiled one at a time, and each replay submits the graph
  // once.
  int before = submissions();
  for (int i = 0; i < 100; ++i)
    replay();
  EXPECT_EQ(submissions() - before, 100);
  EXPECT_EQ(jobs.size(), 1u);
  expectAsOneByOne();
}

TEST_F(BackgroundPrograms, WhatCannotBeCompiledIsRefusedAndTheNextOneTried) {
  open();
  bool reached = false;
  replayUntil([&] {
    for (const auto &job : jobs)
      job->isDone = true;
    reached |= !jobs.empty() && jobs.back()->scope == TAI_SCOPE_LAUNCHES;
    return reached && explains("(chosen)");
  });
  EXPECT_TRUE(explains("refused: the test says so")) << queue->explain();
  // The overlapping graph was created, and both graphs were measured.
  std::string text = queue->explain();
  size_t at = text.find("a graph of launches that overlap");
  ASSERT_NE(at, std::string::npos) << text;
  EXPECT_NE(text.find("ms measured", at), std::string::npos) << text;
  EXPECT_EQ(kept.size(), 1u);
}

TEST_F(BackgroundPrograms, AChoiceOfAnEarlierProcessIsTakenWithoutTrials) {
  open();
  replayUntil([&] {
    for (const auto &job : jobs)
      job->isDone = true;
    return explains("(chosen)");
  });
  ASSERT_EQ(kept.size(), 1u);
  kept.begin()->second = "a graph of launches that overlap";
  // Another process has the same kernels at other addresses.
  open();
  replay();
  replay();
  replayUntil([&] { return !jobs.empty(); });
  EXPECT_EQ(jobs.size(), 1u);
  EXPECT_EQ(jobs.front()->scope, TAI_SCOPE_LAUNCHES);
  jobs.front()->isDone = true;
  replayUntil([&] { return explains("(chosen)"); });
  EXPECT_TRUE(explains("an earlier process has found a faster way"))
      << queue->explain();
}

TEST_F(BackgroundPrograms, AnUnknownChoiceIsNotTrusted) {
  open();
  replayUntil([&] {
    for (const auto &job : jobs)
      job->isDone = true;
    return explains("(chosen)");
  });
  ASSERT_EQ(kept.size(), 1u);
  kept.begin()->second = std::string("\0\xff nonsense", 11);
  open();
  replayUntil([&] { return !jobs.empty(); });
  EXPECT_NE(jobs.front()->scope, TAI_SCOPE_LAUNCHES);
}

TEST_F(BackgroundPrograms, AJobWhoseSequenceIsGoneIsAbandoned) {
  open();
  replayUntil([&] { return !jobs.empty(); });
  EXPECT_FALSE(jobs.front()->isAbandoned);
  close();
  EXPECT_TRUE(jobs.front()->isAbandoned);
}

TEST_F(BackgroundPrograms, ChangedParametersRunMeanwhile) {
  open();
  replayUntil([&] { return !jobs.empty(); });
  for (int i = 0; i < 50; ++i) {
    queue->beginCollecting(/*isReplay=*/true);
    apply(scale, 0.5 + i / 128.0);
    apply(add, 0.25);
    apply(scale, 1.0 - i / 256.0);
    apply(add, -0.125);
    EXPECT_OK(queue->endCollecting());
  }
  expectAsOneByOne();
  EXPECT_EQ(jobs.size(), 1u);
}
#endif // TAI_FAKE_CUDA_LIBRARY
