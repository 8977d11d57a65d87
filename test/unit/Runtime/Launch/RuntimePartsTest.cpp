//===- RuntimePartsTest.cpp - The parts of a runtime, each by itself ------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// No test here creates a Runtime: each part is used only with the parts that it
// is composed of.
//
//===----------------------------------------------------------------------===//

#include "../../Utils/RuntimeTestUtils.h"
#include "tai/Runtime/Host/Gradients.h"
#include "tai/Runtime/Host/HostWrites.h"
#include "tai/Runtime/Launch/KernelList.h"
#include <numeric>
#include <thread>

using namespace mlir::tai;
using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

namespace {
/// Storage, and its parts.
struct Stored {
  Workers workers{2};
  SkipSet skips;
  SkipCounters counters;
  MemoryAccount memory{1 << 20};
  LaunchState state;
  TreeStore store{memory, state, {workers, skips, counters}};

  FieldPtr add(const std::string &name, const std::vector<int64_t> &shape,
               const std::string &adjoint = "", const std::string &dual = "") {
    FieldInfo info;
    info.name = name;
    info.layout = rowMajor(ScalarKind::F64, shape);
    info.adjoint = adjoint;
    info.dual = dual;
    int64_t bytes = 8;
    for (int64_t extent : shape)
      bytes *= extent;
    FieldPtr field;
    EXPECT_OK(store.addTree(name + "_tree", bytes, info.tree));
    EXPECT_OK(store.addField(std::move(info), field));
    return field;
  }
};

/// Storage with the parts that the host uses.
struct Hosted : Stored {
  Printer printer;
  DeviceHost devices{{printer, memory, skips, counters}};
  Recordings recordings{state, store};
  FieldCopies copies{workers, devices};
  Gradients gradients{store, recordings, copies, skips, counters};
  Halos halos;
  HostWrites writes{store, memory, recordings, copies, devices, halos};
};

/// A tape that records its calls.
struct Heard final : Recorder {
  explicit Heard(const FieldPtr &used = nullptr) : used(used) {}

  Status launch(Launch &, Kernel &, const uint64_t *, uint64_t *,
                uint64_t) override {
    return Status::success();
  }
  bool isSuspended() const override { return false; }
  Status findLoops(Kernel &, LoopLists &, bool &) override {
    return Status::success();
  }
  void watch(const TreePtr &) override {}
  Status write(const HostWrite &) override {
    ++numWrites;
    return Status::success();
  }
  Status changeActivity(const TreePtr &, std::function<Status()>) override {
    return Status::success();
  }
  bool needsValues(const Field &field) const override {
    return &field == used.get();
  }
  bool uses(const FieldPtr &field) const override { return field == used; }

  FieldPtr used;
  int numWrites = 0;
};
} // namespace

//===----------------------------------------------------------------------===//
// Threads, text
//===----------------------------------------------------------------------===//

TEST(Workers, RunEachPartOnce) {
  for (int threads : {1, 3}) {
    Workers workers(threads);
    std::vector<std::atomic<int>> seen(1000);
    workers.parallel(
        1000,
        [](void *context, int64_t part) {
          ++(*static_cast<std::vector<std::atomic<int>> *>(context))[part];
        },
        &seen);
    for (const std::atomic<int> &times : seen)
      ASSERT_EQ(times.load(), 1);
    EXPECT_EQ(workers.numForks(), threads > 1);
    EXPECT_EQ(workers.numInline(), threads == 1);
  }
}

TEST(Printer, GivesWholeLinesToItsSink) {
  Printer printer;
  std::string text;
  printer.setSink([&](std::string_view line) { text += line; });
  printer.print("a\n");
  printer.print("b\n");
  EXPECT_EQ(text, "a\nb\n");
}

//===----------------------------------------------------------------------===//
// Storage
//===----------------------------------------------------------------------===//

TEST(LaunchState, IsTheEpochWhereNothingIsSpecial) {
  LaunchState state;
  std::atomic<uint64_t> published{0};
  state.publishTo(published);
  EXPECT_EQ(published, state.epoch());
  state.beginSpecial();
  state.beginSpecial();
  state.storageChanged();
  state.endSpecial();
  EXPECT_EQ(published, LaunchState::never);
  state.endSpecial();
  EXPECT_EQ(published, state.epoch());
  EXPECT_EQ(state.epoch(), 2u);
}

TEST(MemoryAccount, CountsWhatIsTaken) {
  MemoryAccount memory(1000);
  memory.reserve(600);
  EXPECT_EQ(memory.left(), 400);
  memory.release(600);
  memory.setLimit(0);
  EXPECT_GT(memory.limit(), 1000);
}

TEST(TreeStore, GivesBackWhatItsTreesHad) {
  Stored scene;
  uint64_t epoch = scene.state.epoch();
  FieldPtr x = scene.add("x", {4});
  EXPECT_EQ(scene.memory.reserved(), 32);
  EXPECT_EQ(scene.store.firstOf(x->tree()), x);
  TreePtr tree;
  EXPECT_EQ(scene.store.addTree("huge", 1 << 21, tree).code(),
            StatusCode::Memory);
  ASSERT_OK(scene.store.destroyTree("x_tree"));
  EXPECT_EQ(scene.memory.reserved(), 0);
  EXPECT_FALSE(x->valid());
  EXPECT_EQ(scene.store.findField("x"), nullptr);
  EXPECT_NE(scene.state.epoch(), epoch);
}

TEST(TreeStore, LinksPartnersInAnyOrder) {
  Stored scene;
  FieldPtr x = scene.add("x", {3}, "x_grad", "x_dual");
  EXPECT_EQ(x->adjoint(), nullptr);
  FieldPtr adjoint = scene.add("x_grad", {3}), dual = scene.add("x_dual", {3});
  EXPECT_EQ(x->adjoint(), adjoint.get());
  EXPECT_TRUE(adjoint->isAdjoint());
  EXPECT_TRUE(scene.store.isPartner(*dual));
  EXPECT_FALSE(scene.store.isPartner(*x));
  ASSERT_OK(scene.store.destroyTree("x_grad_tree"));
  EXPECT_EQ(x->adjoint(), nullptr);
}

//===----------------------------------------------------------------------===//
// Work of the host
//===----------------------------------------------------------------------===//

TEST(DeviceHost, WithoutADeviceThereIsNothingToDo) {
  Hosted scene;
  EXPECT_OK(scene.devices.synchronize());
  scene.devices.noteFailure(Status::failure(StatusCode::Internal, "nowhere"));
  EXPECT_OK(scene.devices.takeFailure());
  void *address = nullptr;
  EXPECT_EQ(scene.devices.allocate(8, address).code(), StatusCode::Usage);
  EXPECT_FALSE(scene.devices.isThere(&scene));
}

TEST(FieldCopies, GoThereAndBack) {
  Hosted scene;
  FieldPtr x = scene.add("x", {65537});
  std::vector<double> values(65537), found(65537);
  std::iota(values.begin(), values.end(), 1);
  scene.copies.copyIn(*x, values.data());
  ASSERT_OK(scene.copies.copyOut(*x, found.data()));
  EXPECT_EQ(found, values);
  scene.copies.clear(*x);
  ASSERT_OK(scene.copies.copyOut(*x, found.data()));
  EXPECT_EQ(found, std::vector<double>(65537));
}

TEST(Recordings, AreOfTheThreadThatBegan) {
  Hosted scene;
  std::atomic<uint64_t> published{0};
  scene.state.publishTo(published);
  Heard mine, other;
  scene.recordings.begin(mine);
  EXPECT_EQ(scene.recordings.current(), &mine);
  EXPECT_EQ(published, LaunchState::never);
  std::thread([&] {
    EXPECT_EQ(scene.recordings.current(), nullptr);
    EXPECT_FALSE(scene.recordings.areTogether());
    scene.recordings.begin(other);
    EXPECT_EQ(scene.recordings.current(), &other);
    EXPECT_TRUE(scene.recordings.areTogether());
    scene.recordings.end(other);
  }).join();
  scene.recordings.end(mine);
  EXPECT_EQ(scene.recordings.current(), nullptr);
  EXPECT_FALSE(scene.recordings.areTogether());
  EXPECT_EQ(published, scene.state.epoch());
}

TEST(Recordings, ForwardModeIsOfOneThread) {
  Hosted scene;
  scene.recordings.setForward(true);
  scene.recordings.setForward(true);
  EXPECT_TRUE(scene.recordings.isForward());
  std::thread([&] { EXPECT_FALSE(scene.recordings.isForward()); }).join();
  scene.recordings.setForward(false);
  EXPECT_FALSE(scene.recordings.isForward());
  EXPECT_FALSE(scene.state.isSpecial());
}

TEST(Recordings, RefuseWhatWouldChangeAnotherGradient) {
  Hosted scene;
  FieldPtr x = scene.add("x", {2});
  Heard tape;
  scene.recordings.beginHolding();
  ASSERT_OK(scene.recordings.hold(tape, *x, HoldKind::Read));
  std::thread([&] {
    EXPECT_OK(scene.recordings.check(*x, HoldKind::Read));
    EXPECT_EQ(scene.recordings.check(*x, HoldKind::Write).code(),
              StatusCode::Usage);
    EXPECT_EQ(scene.writes.fillF64(*x, 1).code(), StatusCode::Usage);
    Heard second;
    EXPECT_OK(scene.recordings.hold(second, *x, HoldKind::Read));
    EXPECT_EQ(scene.recordings.hold(second, *x, HoldKind::Add).code(),
              StatusCode::Usage);
    scene.recordings.release(second, *x);
  }).join();
  // The recording thread itself is not restricted.
  EXPECT_OK(scene.recordings.check(*x, HoldKind::Write));
  scene.recordings.release(tape, *x);
  std::thread([&] {
    EXPECT_OK(scene.recordings.check(*x, HoldKind::Write));
  }).join();
  scene.recordings.endHolding();
  EXPECT_FALSE(scene.state.isSpecial());
}

namespace {
/// Stands for a kernel that another thread runs and that changes a field.
struct RunsElsewhere final : OtherLaunches {
  bool areAny() const override { return true; }
  void publishState() const override { ++numSeen; }
  void visitChanges(const std::function<void(const std::string &, const Field &,
                                             HoldKind)> &visit) override {
    visit("k", *changed, kind);
  }

  FieldPtr changed;
  HoldKind kind = HoldKind::Add;
  mutable int numSeen = 0;
};
} // namespace

TEST(Recordings, RefuseWhatAnotherThreadIsChanging) {
  Hosted scene;
  FieldPtr x = scene.add("x", {2}, "x_grad"), y = scene.add("y", {2}),
           adjoint = scene.add("x_grad", {2});
  RunsElsewhere other;
  other.changed = adjoint;
  scene.recordings.setLaunches(&other);
  Heard tape;
  scene.recordings.beginHolding();
  EXPECT_EQ(other.numSeen, 1);
  EXPECT_OK(scene.recordings.hold(tape, *y, HoldKind::Write));
  EXPECT_OK(scene.recordings.hold(tape, *adjoint, HoldKind::Add));
  scene.recordings.release(tape, *adjoint);
  EXPECT_EQ(scene.recordings.hold(tape, *adjoint, HoldKind::Read).message(),
            "another thread runs kernel 'k', which adds to the gradient of "
            "field 'x', while a tape of this thread reads it: give each thread "
            "fields of its own, or wait until the kernel has returned");
  // A field whose hold was refused is not held.
  std::thread([&] {
    EXPECT_OK(scene.recordings.check(*adjoint, HoldKind::Write));
    EXPECT_EQ(scene.recordings.check(*y, HoldKind::Read).code(),
              StatusCode::Usage);
  }).join();
  scene.recordings.release(tape, *y);
  scene.recordings.endHolding();
}

TEST(HostWrites, GoToTheTapeThatRecords) {
  Hosted scene;
  FieldPtr x = scene.add("x", {2}, "x_grad"),
           adjoint = scene.add("x_grad", {2});
  ASSERT_OK(scene.writes.fillF64(*x, 3));
  EXPECT_EQ(get(*x, {1}), 3);
  uint64_t version = x->version();
  Heard tape;
  scene.recordings.begin(tape);
  ASSERT_OK(scene.writes.fillF64(*x, 4));
  // Programs do not compute values from gradients.
  ASSERT_OK(scene.writes.fillF64(*adjoint, 5));
  scene.recordings.end(tape);
  EXPECT_EQ(tape.numWrites, 1);
  EXPECT_EQ(get(*x, {1}), 3);
  EXPECT_EQ(x->version(), version);
  EXPECT_EQ(get(*adjoint, {0}), 5);
}

TEST(HostWrites, WhatStaysAsItWasIsNoChange) {
  Hosted scene;
  FieldPtr x = scene.add("x", {2});
  int64_t index[] = {1};
  uint64_t version = x->version();
  ASSERT_OK(scene.writes.writeF64(*x, index, 0, 0));
  EXPECT_EQ(x->version(), version);
  ASSERT_OK(scene.writes.writeF64(*x, index, 0, 7));
  EXPECT_EQ(x->version(), version + 1);
}

TEST(Gradients, ClearWhatIsDirtyAndOfThisThread) {
  Hosted scene;
  FieldPtr x = scene.add("x", {2}, "x_grad"),
           adjoint = scene.add("x_grad", {2});
  EXPECT_TRUE(scene.gradients.clear());
  EXPECT_EQ(scene.counters.get(SkipCount::FieldsNotCleared), 1);
  std::thread([&] { ASSERT_OK(scene.writes.fillF64(*adjoint, 2)); }).join();
  // A gradient of another thread does not concern a tape that does not use the
  // gradient.
  Heard apart, user(adjoint);
  EXPECT_TRUE(scene.gradients.clear(&apart));
  EXPECT_EQ(get(*adjoint, {0}), 2);
  EXPECT_TRUE(scene.gradients.clear(&user));
  EXPECT_EQ(get(*adjoint, {0}), 0);
  EXPECT_FALSE(adjoint->dirty());
}

//===----------------------------------------------------------------------===//
// Launches
//===----------------------------------------------------------------------===//

TEST(KernelList, ForgetsKernelsThatAreGone) {
  KernelList kernels;
  KernelPtr kept = kernels.create({});
  for (int i = 0; i < 1000; ++i)
    (void)kernels.create({});
  EXPECT_EQ(kernels.size(), 1);
  int64_t found = 0;
  kernels.forEach([&](Kernel &kernel) { found += &kernel == kept.get(); });
  EXPECT_EQ(found, 1);
}
