//===- TapePartsTest.cpp - Parts of a tape, one by one --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Tests the parts of a tape that hold fields, save values, launch and check,
// each without the parts that depend on it.
//
//===----------------------------------------------------------------------===//

#include "../../../../lib/Runtime/Tape/Record/LostGradients.h"
#include "../../../../lib/Runtime/Tape/Replay/ChangeWatch.h"
#include "../../../../lib/Runtime/Tape/Replay/DirectReplay.h"
#include "../../../../lib/Runtime/Tape/Replay/ForwardReplay.h"
#include "../../../../lib/Runtime/Tape/Sweep/Rematerialiser.h"
#include "../../../../lib/Runtime/Tape/Sweep/SweepSeeds.h"
#include "../../Utils/RuntimeTestUtils.h"
#include <cmath>
#include <limits>
#include <thread>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

namespace {
constexpr int64_t n = 4;

/// The calls of kernels and host functions, with their arguments and numbers.
struct Call {
  char kind;
  uint64_t argument, number;
  bool operator==(const Call &other) const {
    return kind == other.kind && argument == other.argument &&
           number == other.number;
  }
};
std::vector<Call> calls;

template <char kind> int32_t note(TaiFrame *frame) {
  calls.push_back({kind, frame->args[0], frame->launch});
  return 0;
}
/// x[...] *= 2
int32_t doubles(TaiFrame *frame) {
  for (int64_t i = 0; i < n; ++i)
    static_cast<double *>(frame->trees[0])[i] *= 2;
  return 0;
}

/// Reports that floats flow from the first field of a summary to the second.
class OneFlow final : public KernelProvider {
public:
  KernelFlows findFlows(const Kernel &kernel) override {
    KernelFlows flows;
    flows.places.resize(2);
    for (size_t i = 0; i < 2; ++i) {
      flows.places[i].field = kernel.summary()[i].field;
      flows.places[i].name = flows.places[i].field->name();
    }
    flows.flows.push_back({0, 1, "here.py:3:5"});
    return flows;
  }
};

struct Scene {
  Runtime runtime;
  TapeServices services{runtime};
  FieldPtr x = makeDifferentiable(runtime, "x", ScalarKind::F64, {n});
  FieldPtr y = makeDifferentiable(runtime, "y", ScalarKind::F64, {n});
  FieldPtr loss = makeDifferentiable(runtime, "loss", ScalarKind::F64, {});
  /// The tape that holds fields; its records are not used.
  std::unique_ptr<Tape> tape = begin();
  TapeHolds holds{services, *tape, true};

  std::unique_ptr<Tape> begin() {
    std::unique_ptr<Tape> made;
    EXPECT_OK(runtime.beginTape(nullptr, true, made));
    made->end();
    return made;
  }
  /// y = f(x), with an adjoint that records its calls.
  KernelPtr noting() {
    KernelInfo info;
    info.name = "f";
    info.argSlots = 1;
    info.trees = {runtime.store().findTree("x_tree"),
                  runtime.store().findTree("y_tree")};
    info.summary = {{x, AccessKind::Read}, {y, AccessKind::Accumulate}};
    info.function = note<'f'>;
    KernelInfo reverse;
    reverse.name = "f_grad";
    reverse.argSlots = 1;
    reverse.trees = info.trees;
    reverse.function = note<'r'>;
    info.adjoint = runtime.launcher().kernels().create(reverse);
    return runtime.launcher().kernels().create(info);
  }
};
} // namespace

//===----------------------------------------------------------------------===//
// Holds, seeds, changes
//===----------------------------------------------------------------------===//

TEST(TapeHolds, KeepsOtherThreadsOff) {
  Scene scene;
  EXPECT_OK(scene.holds.hold());
  EXPECT_OK(scene.holds.add(scene.x, HoldKind::Read));
  EXPECT_TRUE(scene.holds.has(scene.x));
  EXPECT_FALSE(scene.holds.has(scene.y));
  TapeHolds other(scene.services, *scene.begin(), true);
  std::thread([&] {
    EXPECT_OK(other.hold());
    EXPECT_OK(other.add(scene.x, HoldKind::Read));
    EXPECT_FALSE(other.add(scene.x, HoldKind::Write).ok());
    // The refused field is no longer held for reading either, so that a failure
    // leaves no holds.
    EXPECT_FALSE(other.has(scene.x));
    other.release();
  }).join();
  scene.holds.release();
  std::thread([&] {
    EXPECT_OK(other.hold());
    EXPECT_OK(other.add(scene.x, HoldKind::Write));
    other.release();
  }).join();
}

TEST(SweepSeeds, StartsFromLosses) {
  Scene scene;
  SweepSeeds seeds(scene.services);
  set(*scene.loss, {}, 5);
  EXPECT_TRUE(seeds.empty());
  ASSERT_OK(seeds.add(scene.loss, scene.holds));
  EXPECT_EQ(get(*scene.loss), 0);
  EXPECT_TRUE(scene.holds.has(scene.loss));
  EXPECT_FALSE(seeds.add(scene.loss, scene.holds).ok());
  EXPECT_EQ(seeds.names(), "'loss'");
  EXPECT_OK(seeds.store());
  EXPECT_EQ(get(*scene.loss->adjoint()), 1);
  double weight = 3;
  EXPECT_OK(seeds.set(*scene.loss, &weight));
  EXPECT_FALSE(seeds.set(*scene.x, &weight).ok());
  EXPECT_OK(seeds.store());
  EXPECT_EQ(get(*scene.loss->adjoint()), 3);

  // A field of more than one number has no default seed.
  EXPECT_OK(seeds.add(scene.y, scene.holds));
  EXPECT_FALSE(seeds.store().ok());
}

TEST(SweepSeeds, RefusesWhatIsNoLoss) {
  Scene scene;
  SweepSeeds seeds(scene.services);
  FieldPtr count =
      makeDifferentiable(scene.runtime, "count", ScalarKind::I32, {});
  EXPECT_EQ(seeds.add(count, scene.holds).message(),
            "the loss 'count' is not a field of floating-point numbers");
  // The loss may be destroyed before its adjoint, and before the sweep.
  ASSERT_OK(seeds.add(scene.loss, scene.holds));
  ASSERT_OK(scene.runtime.destroyTree(scene.loss->tree().name()));
  seeds.clearSums();
  EXPECT_EQ(seeds.store().message(),
            "the tree of the loss 'loss' has been destroyed");
}

TEST(SweepSeeds, FindsLiveFields) {
  Scene scene;
  SweepSeeds seeds(scene.services);
  ASSERT_OK(seeds.add(scene.loss, scene.holds));
  using Fields = std::vector<Field *>;
  EXPECT_EQ(seeds.liveFields(false, scene.holds), Fields{scene.loss.get()});
  scene.x->adjoint()->markDirty();
  EXPECT_EQ(seeds.liveFields(false, scene.holds),
            (Fields{scene.x.get(), scene.loss.get()}));
  EXPECT_EQ(seeds.liveFields(true, scene.holds), Fields{scene.loss.get()});
  // A gradient of another thread counts only if the tape uses it.
  std::thread([&] { scene.y->adjoint()->markDirty(); }).join();
  EXPECT_EQ(seeds.liveFields(false, scene.holds).size(), 2u);
  ASSERT_OK(scene.holds.add(scene.runtime.store().findField("y_grad"),
                            HoldKind::Add));
  EXPECT_EQ(seeds.liveFields(false, scene.holds).size(), 3u);
}

TEST(ChangeWatch, TellsWhatMatters) {
  Scene scene;
  KernelPtr kernel = makeKernel(
      scene.runtime, "k", doubles,
      {{scene.x, AccessKind::Read}, {scene.y, AccessKind::Accumulate}});
  TapeMemory memory(scene.runtime);
  // Without a plan, the adjoint may read every field that the kernel reads.
  const TapeMemory::KernelUses &uses = memory.usesOf(*kernel);
  ASSERT_OK(memory.beforeLaunch(uses, nullptr, 0, false));
  memory.afterLaunch(uses, nullptr, 0);
  ChangeWatch changes(scene.services);
  changes.begin(memory);
  std::vector<std::string> notes;
  bool lostStored = true;
  EXPECT_OK(changes.check(memory, notes, lostStored));
  EXPECT_TRUE(notes.empty());
  EXPECT_FALSE(lostStored);
  ASSERT_OK(scene.runtime.writes().fillF64(*scene.x, 3));
  EXPECT_FALSE(changes.check(memory, notes, lostStored).ok());
  changes.begin(memory);
  EXPECT_OK(changes.check(memory, notes, lostStored));
  // A change of a field that the sequence does not use.
  ASSERT_OK(scene.runtime.writes().fillF64(*scene.loss, 3));
  EXPECT_OK(changes.check(memory, notes, lostStored));
  EXPECT_TRUE(notes.empty());
}

//===----------------------------------------------------------------------===//
// Diagnostics
//===----------------------------------------------------------------------===//

TEST(AdjointHealth, LooksAtWhatWasAddedTo) {
  Scene scene;
  KernelPtr kernel = scene.noting();
  ASSERT_OK(kernel->bind(scene.services.epoch()));
  uint64_t argument = 0;
  TapeRecording recording;
  recording.addLaunch(*kernel, &argument, 0);
  Field &adjoint = *scene.x->adjoint();
  set(adjoint, {0}, 3);
  set(adjoint, {1}, -4);
  set(adjoint, {2}, std::nan(""));
  set(adjoint, {3}, std::numeric_limits<double>::infinity());
  AdjointHealth health;
  EXPECT_FALSE(health.isWatching());
  health.watch(true);
  health.examine(recording, 0);
  ASSERT_EQ(health.found().size(), 1u);
  const RecordHealth &found = health.found()[0];
  EXPECT_EQ(found.field, scene.x.get());
  EXPECT_EQ(found.nans, 1);
  EXPECT_EQ(found.infs, 1);
  EXPECT_EQ(found.maxAbs, 4);
  EXPECT_EQ(found.sumSquares, 25);
  health.examine(7, {scene.y.get()});
  EXPECT_EQ(health.found()[1].record, 7);
  EXPECT_EQ(health.found()[1].maxAbs, 0);
  health.clear();
  EXPECT_TRUE(health.found().empty());
}

TEST(LostGradients, SaysOnceWhereTheyEnd) {
  Scene scene;
  FieldPtr plain = makeField(scene.runtime, "plain", ScalarKind::F64, {n});
  auto through = [&](const char *name, const FieldPtr &from,
                     const FieldPtr &to) {
    KernelInfo info;
    info.name = name;
    info.function = note<'t'>;
    info.summary = {{from, AccessKind::Read}, {to, AccessKind::Write}};
    info.provider = std::make_shared<OneFlow>();
    return scene.runtime.launcher().kernels().create(info);
  };
  KernelPtr in = through("in", scene.x, plain);
  KernelPtr out = through("out", plain, scene.loss);
  TapeRecording recording;
  recording.keep(*in);
  recording.addLaunch(*in, nullptr, 0);
  EXPECT_FALSE(LostGradients::mayHave(recording));
  recording.keep(*out);
  recording.addLaunch(*out, nullptr, 1);
  EXPECT_TRUE(LostGradients::mayHave(recording));
  LostGradients lost;
  std::vector<std::string> notes;
  lost.find(scene.services, recording, {scene.loss.get()}, notes);
  ASSERT_EQ(notes.size(), 1u);
  EXPECT_NE(notes[0].find("kernel 'in' stores"), std::string::npos) << notes[0];
  lost.find(scene.services, recording, {scene.loss.get()}, notes);
  EXPECT_EQ(notes.size(), 1u);
}

//===----------------------------------------------------------------------===//
// Replay
//===----------------------------------------------------------------------===//

TEST(DirectReplay, CallsFunctionsInOrder) {
  Scene scene;
  KernelPtr kernel = scene.noting();
  ASSERT_OK(kernel->resolve());
  TapeRecording recording;
  recording.keep(*kernel);
  for (uint64_t argument : {10, 11, 12})
    recording.addLaunch(*kernel, &argument, argument);
  recording.renumber(50);
  TapeMemory memory(scene.runtime);
  TapePlan plan;
  plan.make(scene.services, recording, {scene.y.get()}, {});
  AdjointForms forms(scene.services, recording, plan, memory);
  DirectReplay direct(scene.services, recording);
  HeldLaunch launch(scene.services);
  calls.clear();
  ASSERT_TRUE(direct.findForward());
  ASSERT_TRUE(direct.findReverse(plan, forms));
  EXPECT_TRUE(calls.empty());
  EXPECT_OK(direct.runForward(launch.get()));
  FirstStores first(scene.services, recording, plan, forms);
  EXPECT_OK(direct.runReverse(launch.get(), plan, first));
  EXPECT_EQ(calls, (std::vector<Call>{{'f', 10, 50},
                                      {'f', 11, 51},
                                      {'f', 12, 52},
                                      {'r', 12, 52},
                                      {'r', 11, 51},
                                      {'r', 10, 50}}));
  EXPECT_TRUE(scene.x->adjoint()->dirty());
}

TEST(ForwardReplay, RunsAllKindsOfRecords) {
  Scene scene;
  KernelPtr kernel = makeKernel(scene.runtime, "doubles", doubles,
                                {{scene.x, AccessKind::Accumulate}});
  TapeRecording recording;
  double value = 3;
  int called = 0;
  Status status;
  recording.addWrite(TapeRecording::Write::make(
      scene.x, {HostWrite::What::Fill, scene.x.get(), &value}, status));
  EXPECT_TRUE(status.ok());
  recording.addLaunch(*kernel, nullptr, 0);
  recording.addCallback({[&] {
                           ++called;
                           return Status::success();
                         },
                         nullptr},
                        1, 1);
  recording.addCallback({nullptr, nullptr}, 1, 1);
  TapeMemory memory(scene.runtime);
  TapeTopology topology(scene.runtime);
  HeldLaunch launch(scene.services);
  EXPECT_OK(
      ForwardReplay(scene.services, recording, memory, topology, launch.get())
          .run());
  EXPECT_EQ(get(*scene.x, {2}), 6);
  EXPECT_EQ(called, 1);
  // Record by record, as snapshots need it.
  EXPECT_OK(replayRecord(scene.services, recording, launch.get(), 1, true));
  EXPECT_EQ(get(*scene.x, {2}), 12);
  EXPECT_OK(replayRecord(scene.services, recording, launch.get(), 3, false));
  EXPECT_FALSE(
      replayRecord(scene.services, recording, launch.get(), 3, true).ok());
}

TEST(ReverseSweep, CallsAdjointsAndHostFunctions) {
  Scene scene;
  KernelPtr kernel = scene.noting();
  TapeRecording recording;
  recording.keep(*kernel);
  uint64_t argument = 1;
  recording.addLaunch(*kernel, &argument, 1);
  bool wasInside = false;
  recording.addCallback({nullptr,
                         [&] {
                           wasInside = scene.runtime.inReverseFunction();
                           calls.push_back({'h', 0, 0});
                           scene.y->adjoint()->markDirty();
                           return Status::success();
                         }},
                        2, 2);
  argument = 2;
  recording.addLaunch(*kernel, &argument, 2);
  TapeMemory memory(scene.runtime);
  TapeTopology topology(scene.runtime);
  TapePlan plan;
  plan.make(scene.services, recording, {}, {});
  AdjointForms forms(scene.services, recording, plan, memory);
  FirstStores first(scene.services, recording, plan, forms);
  AdjointHealth health;
  ReverseSweep sweep(scene.services, *scene.tape, recording, plan, forms,
                     memory, topology, first, health);
  HeldLaunch launch(scene.services);
  calls.clear();
  // No adjoint is live after the host function; its reverse function makes y
  // live.
  ASSERT_OK(memory.beginReverse());
  EXPECT_OK(sweep.runDeciding(launch.get()));
  EXPECT_EQ(calls, (std::vector<Call>{{'h', 0, 0}, {'r', 1, 1}}));
  EXPECT_TRUE(wasInside);
  EXPECT_FALSE(scene.runtime.inReverseFunction());
}

//===----------------------------------------------------------------------===//
// Snapshots
//===----------------------------------------------------------------------===//

TEST(Checkpoints, PutsBackWhatChanged) {
  Scene scene;
  Track track(scene.x, {});
  Checkpoints checkpoints(scene.runtime, {CheckpointPolicy::Kind::Binomial, 3});
  auto change = [&](double value) {
    EXPECT_OK(checkpoints.log(track, {}));
    EXPECT_OK(scene.x->writeF64(std::vector<int64_t>{1}.data(), 0, value));
    checkpoints.settle();
  };
  set(*scene.x, {1}, 1);
  checkpoints.push(0);
  change(2);
  checkpoints.push(1);
  change(3);
  EXPECT_EQ(checkpoints.count(), 2);
  EXPECT_OK(checkpoints.keepFinal());
  EXPECT_TRUE(checkpoints.restore());
  EXPECT_EQ(get(*scene.x, {1}), 2);
  checkpoints.pop();
  EXPECT_TRUE(checkpoints.restore());
  EXPECT_EQ(get(*scene.x, {1}), 1);
  checkpoints.restoreFinal();
  EXPECT_EQ(get(*scene.x, {1}), 3);
}

TEST(Checkpoints, MergesWhatTheOneBeforeKnowsNothingOf) {
  Scene scene;
  Track track(scene.x, {});
  Checkpoints checkpoints(scene.runtime, {CheckpointPolicy::Kind::Binomial, 3});
  set(*scene.x, {1}, 1);
  checkpoints.push(0);
  checkpoints.push(1);
  EXPECT_OK(checkpoints.log(track, {}));
  set(*scene.x, {1}, 2);
  checkpoints.settle();
  checkpoints.pop();
  EXPECT_EQ(checkpoints.count(), 1);
  EXPECT_TRUE(checkpoints.restore());
  EXPECT_EQ(get(*scene.x, {1}), 1);
}

TEST(Rematerialiser, RefusesBadPolicies) {
  Scene scene;
  TapeRecording recording;
  TapeMemory memory(scene.runtime);
  TapeTopology topology(scene.runtime);
  TapePlan plan;
  AdjointForms forms(scene.services, recording, plan, memory);
  FirstStores first(scene.services, recording, plan, forms);
  AdjointHealth health;
  ReverseSweep sweep(scene.services, *scene.tape, recording, plan, forms,
                     memory, topology, first, health);
  Rematerialiser rematerialiser(scene.services, recording, plan, memory,
                                topology, sweep);
  EXPECT_FALSE(rematerialiser.isOn());
  EXPECT_FALSE(
      rematerialiser.setPolicy({CheckpointPolicy::Kind::Periodic, -1}).ok());
  EXPECT_FALSE(rematerialiser.isOn());
  EXPECT_FALSE(
      rematerialiser.setPolicy({CheckpointPolicy::Kind::Mixed, 0, -1}).ok());
  EXPECT_FALSE(rematerialiser.isOn());
  EXPECT_OK(rematerialiser.setPolicy({CheckpointPolicy::Kind::Periodic, 2}));
  // An empty sequence has no steps to recompute.
  EXPECT_OK(rematerialiser.sweep());
  EXPECT_TRUE(rematerialiser.isOn());

  // Four doublings, and back without any adjoint: memory has its initial
  // contents.
  KernelPtr kernel = makeKernel(scene.runtime, "doubles", doubles,
                                {{scene.x, AccessKind::Write}});
  recording.keep(*kernel);
  set(*scene.x, {0}, 1);
  HeldLaunch launch(scene.services);
  const TapeMemory::KernelUses &uses = memory.usesOf(*kernel);
  for (uint32_t i = 0; i < 4; ++i) {
    ASSERT_OK(memory.beforeLaunch(uses, nullptr, i, false));
    ASSERT_OK(scene.services.run(launch.get(), *kernel, nullptr, nullptr, i));
    memory.afterLaunch(uses, nullptr, i);
    recording.addLaunch(*kernel, nullptr, i);
  }
  EXPECT_EQ(get(*scene.x, {0}), 16);
  plan.make(scene.services, recording, {}, {});
  EXPECT_OK(rematerialiser.sweep());
  EXPECT_EQ(get(*scene.x, {0}), 16);
  TapeStats stats;
  rematerialiser.addTo(stats);
  EXPECT_EQ(stats.snapshots, 2);
}
