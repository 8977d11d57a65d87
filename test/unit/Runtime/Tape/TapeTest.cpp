//===- TapeTest.cpp - The tape and its reverse replay ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Hand-written kernels and adjoints over small fields, such as y = sin(x).
//
//===----------------------------------------------------------------------===//

#include "../../Utils/RuntimeTestUtils.h"
#include "tai/Runtime/Tape/HostProgram.h"
#include <cmath>
#include <map>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

namespace {
constexpr int64_t n = 5;

template <int tree> double *in(TaiFrame *frame) {
  return static_cast<double *>(frame->trees[tree]);
}
double scaleOf(TaiFrame *frame) {
  double scale;
  std::memcpy(&scale, frame->args, sizeof(scale));
  return scale;
}

/// to[i] = scale * sin(from[i])
int32_t sine(TaiFrame *frame) {
  for (int64_t i = 0; i < n; ++i)
    in<1>(frame)[i] = scaleOf(frame) * std::sin(in<0>(frame)[i]);
  return 0;
}
template <bool zeroes>
int32_t sineAdjoint(TaiFrame *frame) { // from, to, from_grad, to_grad
  for (int64_t i = 0; i < n; ++i) {
    in<2>(frame)[i] +=
        in<3>(frame)[i] * scaleOf(frame) * std::cos(in<0>(frame)[i]);
    if (zeroes)
      in<3>(frame)[i] = 0;
  }
  return 0;
}
/// loss += sum of from[i]^2
int32_t squares(TaiFrame *frame) {
  for (int64_t i = 0; i < n; ++i)
    *in<1>(frame) += in<0>(frame)[i] * in<0>(frame)[i];
  return 0;
}
int32_t squaresAdjoint(TaiFrame *frame) {
  for (int64_t i = 0; i < n; ++i)
    in<2>(frame)[i] += *in<3>(frame) * 2 * in<0>(frame)[i];
  return 0;
}
/// to[i] = 1
int32_t ones(TaiFrame *frame) {
  for (int64_t i = 0; i < n; ++i)
    in<0>(frame)[i] = 1;
  return 0;
}
int32_t onesAdjoint(TaiFrame *frame) { // to, to_grad
  for (int64_t i = 0; i < n; ++i)
    in<1>(frame)[i] = 0;
  return 0;
}

struct Scene {
  Runtime runtime;
  int adjointsMade = 0;
  FieldPtr x = field("x"), y = field("y"), z = field("z"), w = field("w");
  FieldPtr loss = makeDifferentiable(runtime, "loss", ScalarKind::F64, {});

  FieldPtr field(const char *name) {
    return makeDifferentiable(runtime, name, ScalarKind::F64, {n});
  }
  TreePtr tree(const Field &field) {
    return runtime.store().findTree(field.tree().name());
  }

  /// A box of all elements, as the stores of a launch in any layout.
  static std::shared_ptr<const std::vector<StoredBox>> everything() {
    return std::make_shared<const std::vector<StoredBox>>(
        std::vector<StoredBox>{{{{{0, 0, {}}, {0, n, {}}}}, {}}});
  }
  KernelPtr pair(std::string name, FieldPtr from, FieldPtr to, AccessKind kind,
                 TaiKernelFn function, TaiKernelFn reverse, int64_t slots,
                 TaiKernelFn zeroing = nullptr) {
    KernelInfo info;
    info.name = std::move(name);
    info.argSlots = slots;
    info.trees = {tree(*from), tree(*to)};
    info.summary = {{from, AccessKind::Read}, {to, kind}};
    if (kind == AccessKind::Write)
      info.summary.back().boxes = everything();
    info.function = function;
    auto make = [=](Kernel &primal, TaiKernelFn reverse, KernelPtr &adjoint) {
      ++adjointsMade;
      KernelInfo info;
      info.name = primal.name() + "_grad";
      info.argSlots = slots;
      info.trees = {tree(*from), tree(*to), tree(*from->adjoint()),
                    tree(*to->adjoint())};
      info.function = reverse;
      adjoint = runtime.launcher().kernels().create(info);
      return Status::success();
    };
    TestProvider &provider = provide(info);
    provider.onMakeAdjoint = [=](Kernel &primal, AdjointVariant variant,
                                 KernelPtr &adjoint) {
      return make(primal, variant.zeroes ? zeroing : reverse, adjoint);
    };
    provider.zeroes = zeroing != nullptr;
    return runtime.launcher().kernels().create(info);
  }
  KernelPtr sineOf(const FieldPtr &from, const FieldPtr &to) {
    return pair(to->name() + "=sin(" + from->name() + ")", from, to,
                AccessKind::Write, sine, sineAdjoint<false>, 1,
                sineAdjoint<true>);
  }
  KernelPtr squaresOf(const FieldPtr &from) {
    return pair("loss+=" + from->name() + "^2", from, loss,
                AccessKind::Accumulate, squares, squaresAdjoint, 0);
  }
  KernelPtr onesIn(FieldPtr to) {
    KernelInfo info;
    info.name = to->name() + "=1";
    info.trees = {tree(*to)};
    info.summary = {{to, AccessKind::Write}};
    info.summary.back().boxes = everything();
    info.function = ones;
    KernelInfo reverse;
    reverse.name = info.name + "_grad";
    reverse.trees = {tree(*to), tree(*to->adjoint())};
    reverse.function = onesAdjoint;
    info.adjoint = runtime.launcher().kernels().create(reverse);
    info.zeroesAdjoints = true;
    return runtime.launcher().kernels().create(info);
  }

  void launch(const KernelPtr &kernel, double scale = 1) {
    uint64_t arg = slotOf(scale);
    EXPECT_OK(runtime.launch(*kernel, &arg, kernel->argSlots(), nullptr));
  }
  void startAt(double first) {
    for (int64_t i = 0; i < n; ++i)
      set(*x, {i}, first + 0.1 * double(i));
    set(*loss, {}, 0);
  }
  std::unique_ptr<Tape> begin(bool clear = true) {
    std::unique_ptr<Tape> tape;
    EXPECT_OK(runtime.beginTape(loss, clear, tape));
    return tape;
  }
  /// d/dx of sum (s sin x)^2 at element i, for the initial values of x.
  double expected(double first, int64_t i, double scale = 1) {
    double at = first + 0.1 * double(i);
    return 2 * scale * scale * std::sin(at) * std::cos(at);
  }
};
} // namespace

TEST(RuntimeTape, RunsAdjointsInReverse) {
  Scene scene;
  auto step = scene.sineOf(scene.x, scene.y);
  auto sum = scene.squaresOf(scene.y);
  scene.startAt(0.3);
  auto tape = scene.begin();
  EXPECT_TRUE(tape->recording());
  scene.launch(step, 1.5);
  scene.launch(sum);
  EXPECT_EQ(scene.adjointsMade, 0);
  ASSERT_OK(tape->backward());
  EXPECT_FALSE(tape->recording());
  EXPECT_EQ(scene.adjointsMade, 2);
  for (int64_t i = 0; i < n; ++i)
    EXPECT_NEAR(get(*scene.x->adjoint(), {i}), scene.expected(0.3, i, 1.5),
                1e-15);
  EXPECT_EQ(get(*scene.loss->adjoint()), 1);
  EXPECT_EQ(tape->numRecords(), 2);
  EXPECT_EQ(tape->numSkipped(), 0);
}

// A replay clears the gradients first: gradients that an earlier sweep has left
// make no launch replay.
TEST(RuntimeTape, PlansAReplayByClearedGradients) {
  Scene scene;
  auto step = scene.sineOf(scene.x, scene.y);
  auto other = scene.sineOf(scene.z, scene.w);
  auto sum = scene.squaresOf(scene.y);
  scene.startAt(0.3);
  auto tape = scene.begin();
  scene.launch(step, 1.5);
  scene.launch(other, 1.5);
  scene.launch(sum);
  tape->end();
  ASSERT_OK(scene.runtime.writes().fillF64(*scene.w->adjoint(), 1.0));
  EXPECT_EQ(tape->pendingAdjoints(/*cleared=*/true).size(), 2u);
  EXPECT_EQ(tape->pendingAdjoints(/*cleared=*/false).size(), 3u);
  ASSERT_OK(tape->replay(true, true));
  EXPECT_EQ(scene.adjointsMade, 2);
}

TEST(RuntimeTape, SkipsWhatCannotContribute) {
  Scene scene;
  auto used = scene.sineOf(scene.x, scene.y);
  auto unused = scene.sineOf(scene.x, scene.w);
  auto sum = scene.squaresOf(scene.y);
  FieldPtr count = makeField(scene.runtime, "count", ScalarKind::I32, {});
  auto counting = makeKernel(
      scene.runtime, "count", [](TaiFrame *) { return 0; },
      {{scene.x, AccessKind::Read}, {count, AccessKind::Accumulate}});
  KernelInfo plainInfo;
  plainInfo.name = "plain";
  plainInfo.differentiable = false;
  plainInfo.summary = {{scene.y, AccessKind::Read}};
  plainInfo.function = [](TaiFrame *) { return 0; };
  auto plain = scene.runtime.launcher().kernels().create(plainInfo);

  scene.startAt(0.2);
  auto tape = scene.begin();
  scene.launch(used);
  scene.launch(unused);
  scene.launch(counting);
  scene.launch(plain);
  scene.launch(sum);
  scene.launch(used); // after the loss was formed
  EXPECT_EQ(tape->numSkipped(), 4);
  ASSERT_OK(tape->backward());
  EXPECT_EQ(tape->numSkipped(), 4);
  EXPECT_EQ(tape->explain(),
            "0: @y=sin(x): replayed, from the adjoints of @y to those of @x; "
            "record 4 reads @y\n"
            "1: @w=sin(x): skipped: no adjoint reaches @w\n"
            "2: @count: skipped: it changes no field that has an adjoint\n"
            "3: @plain: skipped: it has nothing to differentiate\n"
            "4: @loss+=y^2: replayed, from the adjoints of @loss to those of "
            "@y\n"
            "5: @y=sin(x): skipped: no adjoint reaches @y\n");
  EXPECT_EQ(scene.runtime.counters().recorded, 6);
  EXPECT_EQ(scene.runtime.counters().replayed, 2);
  EXPECT_EQ(scene.runtime.counters().skipped, 4);
  EXPECT_NEAR(get(*scene.x->adjoint(), {2}), scene.expected(0.2, 2), 1e-15);
}

TEST(RuntimeTape, ForgetsAdjointsOfWhatWasOverwritten) {
  Scene scene;
  auto init = scene.onesIn(scene.y);
  auto step = scene.sineOf(scene.x, scene.y);
  auto sum = scene.squaresOf(scene.y);
  scene.startAt(0.4);
  auto tape = scene.begin();
  scene.launch(init); // nothing wrote y before: needs no adjoint
  scene.launch(step); // nothing of y is left for the loss
  scene.launch(init); // overwrites what depends on x: must be replayed
  scene.launch(sum);
  ASSERT_OK(tape->backward());
  EXPECT_EQ(tape->numSkipped(), 2);
  for (int64_t i = 0; i < n; ++i)
    EXPECT_EQ(get(*scene.x->adjoint(), {i}), 0);
  auto overwrites = tape->overwrites();
  ASSERT_EQ(overwrites.size(), 2u);
  EXPECT_EQ(overwrites[0].record, 1);
  EXPECT_EQ(overwrites[0].earlier, 0);
  EXPECT_EQ(overwrites[1].record, 2);
  EXPECT_EQ(overwrites[1].field, scene.y.get());
}

TEST(RuntimeTape, StartsFromSeedsWithoutALoss) {
  Scene scene;
  auto step = scene.sineOf(scene.x, scene.y);
  auto other = scene.sineOf(scene.x, scene.w);
  scene.startAt(0.1);
  std::unique_ptr<Tape> tape;
  ASSERT_OK(scene.runtime.beginTape(nullptr, true, tape));
  scene.launch(step);
  scene.launch(other);
  tape->end();
  set(*scene.y->adjoint(), {3}, 2);
  ASSERT_OK(tape->backward());
  EXPECT_EQ(tape->numSkipped(), 1);
  EXPECT_NEAR(get(*scene.x->adjoint(), {3}), 2 * std::cos(0.4), 1e-15);
  EXPECT_EQ(get(*scene.x->adjoint(), {2}), 0);
}

// Skipping does not lose a seed that the caller set in addition to the loss.
TEST(RuntimeTape, AddsSeedsToTheLoss) {
  Scene scene;
  auto step = scene.sineOf(scene.x, scene.w);
  auto sum = scene.squaresOf(scene.y);
  scene.startAt(0.1);
  auto tape = scene.begin();
  scene.launch(step);
  scene.launch(sum);
  tape->end();
  set(*scene.w->adjoint(), {0}, 1);
  ASSERT_OK(tape->backward());
  EXPECT_EQ(tape->numSkipped(), 0);
  EXPECT_NEAR(get(*scene.x->adjoint(), {0}), std::cos(0.1), 1e-15);
}

TEST(RuntimeTape, ReplaysOnNewContents) {
  Scene scene;
  auto step = scene.sineOf(scene.x, scene.y);
  auto sum = scene.squaresOf(scene.y);
  auto init = makeKernel(scene.runtime, "init",
                         [](TaiFrame *frame) {
                           *in<0>(frame) = 0;
                           return 0;
                         },
                         {{scene.loss, AccessKind::Write}});
  scene.startAt(0.3);
  auto tape = scene.begin();
  scene.launch(init);
  scene.launch(step, 2);
  scene.launch(sum);
  ASSERT_OK(tape->backward());
  for (double first : {0.7, -0.4, 1.2}) {
    scene.startAt(first);
    ASSERT_OK(tape->replay(true, true));
    double loss = 0;
    for (int64_t i = 0; i < n; ++i) {
      loss += std::pow(2 * std::sin(first + 0.1 * double(i)), 2);
      EXPECT_NEAR(get(*scene.x->adjoint(), {i}), scene.expected(first, i, 2),
                  1e-14);
    }
    EXPECT_NEAR(get(*scene.loss), loss, 1e-14);
  }
  // Without the forward part, the gradient is taken at the stored values.
  ASSERT_OK(tape->replay(false, true));
  EXPECT_NEAR(get(*scene.x->adjoint(), {1}), scene.expected(1.2, 1, 2), 1e-14);
}

TEST(RuntimeTape, AccumulatesOverTapesUnlessCleared) {
  Scene scene;
  auto step = scene.sineOf(scene.x, scene.y);
  auto sum = scene.squaresOf(scene.y);
  scene.startAt(0.3);
  for (int round = 0; round < 2; ++round) {
    auto tape = scene.begin(/*clear=*/true);
    scene.launch(step);
    scene.launch(sum);
    ASSERT_OK(tape->backward());
  }
  EXPECT_NEAR(get(*scene.x->adjoint(), {0}), scene.expected(0.3, 0), 1e-15);
  // The adjoints of overwritten elements are zero.
  for (int64_t i = 0; i < n; ++i)
    EXPECT_EQ(get(*scene.y->adjoint(), {i}), 0);
  // As in the paper's system, values that the adjoints had before are
  // propagated as well.
  set(*scene.y->adjoint(), {0}, 2 * std::sin(0.3));
  auto tape = scene.begin(/*clear=*/false);
  scene.launch(step);
  ASSERT_OK(tape->backward());
  EXPECT_NEAR(get(*scene.x->adjoint(), {0}), 2 * scene.expected(0.3, 0), 1e-14);
  EXPECT_EQ(get(*scene.y->adjoint(), {0}), 0);
}

TEST(RuntimeTape, CallsHostFunctionsInPlace) {
  Scene scene;
  auto step = scene.sineOf(scene.x, scene.y);
  auto sum = scene.squaresOf(scene.z);
  std::vector<std::string> calls;
  // z = 3 y, with a custom gradient.
  auto tripled = [&] {
    calls.push_back("forward");
    for (int64_t i = 0; i < n; ++i)
      set(*scene.z, {i}, 3 * get(*scene.y, {i}));
    return Status::success();
  };
  auto reverse = [&] {
    calls.push_back("backward");
    for (int64_t i = 0; i < n; ++i)
      set(*scene.y->adjoint(), {i},
          get(*scene.y->adjoint(), {i}) + 3 * get(*scene.z->adjoint(), {i}));
    return Status::success();
  };
  scene.startAt(0.3);
  auto tape = scene.begin();
  scene.launch(step);
  tape->suspend();
  scene.launch(scene.sineOf(scene.x, scene.w)); // not recorded
  EXPECT_OK(tripled());
  ASSERT_OK(tape->resume());
  tape->recordCallback({tripled, reverse});
  tape->recordCallback({nullptr, nullptr});
  scene.launch(sum);
  EXPECT_EQ(tape->numRecords(), 4);
  EXPECT_EQ(tape->numSkipped(), 1);
  ASSERT_OK(tape->backward());
  EXPECT_EQ(calls, (std::vector<std::string>{"forward", "backward"}));
  EXPECT_EQ(tape->numSkipped(), 1);
  for (int64_t i = 0; i < n; ++i)
    EXPECT_NEAR(get(*scene.x->adjoint(), {i}), 9 * scene.expected(0.3, i),
                1e-14);
  calls.clear();
  scene.startAt(0.6);
  ASSERT_OK(tape->replay(true, true));
  EXPECT_EQ(calls, (std::vector<std::string>{"forward", "backward"}));
  EXPECT_NEAR(get(*scene.x->adjoint(), {0}), 9 * scene.expected(0.6, 0), 1e-14);
  EXPECT_EQ(tape->resume().message(), "the tape is not suspended");
  tape->recordCallback(
      {nullptr, [] { return Status::failure(StatusCode::Usage, "no"); }});
  EXPECT_EQ(tape->numRecords(), 4) << "a tape that has ended records nothing";
}

// A kernel that a reverse callback launches reaches adjoints that no summary on
// the tape mentions.
TEST(RuntimeTape, FollowsWhatCallbacksLaunch) {
  Scene scene;
  auto step = scene.sineOf(scene.x, scene.y);
  auto copy = scene.pair(
      "copy", scene.y, scene.z, AccessKind::Write,
      [](TaiFrame *frame) {
        std::memcpy(in<1>(frame), in<0>(frame), n * sizeof(double));
        return 0;
      },
      [](TaiFrame *frame) {
        for (int64_t i = 0; i < n; ++i)
          in<2>(frame)[i] += in<3>(frame)[i];
        return 0;
      },
      0,
      [](TaiFrame *frame) {
        for (int64_t i = 0; i < n; ++i) {
          in<2>(frame)[i] += in<3>(frame)[i];
          in<3>(frame)[i] = 0;
        }
        return 0;
      });
  auto sum = scene.squaresOf(scene.z);
  scene.startAt(0.3);
  auto tape = scene.begin();
  scene.launch(step);
  tape->suspend();
  scene.launch(copy);
  ASSERT_OK(tape->resume());
  tape->recordCallback({nullptr, [&] {
                          return scene.runtime.launchAdjoint(*copy, nullptr, 0);
                        }});
  scene.launch(sum);
  ASSERT_OK(tape->backward());
  EXPECT_EQ(tape->numSkipped(), 0);
  EXPECT_NEAR(get(*scene.x->adjoint(), {2}), scene.expected(0.3, 2), 1e-15);
}

TEST(RuntimeTape, KeepsItsKernels) {
  Scene scene;
  scene.startAt(0.3);
  auto tape = scene.begin();
  scene.launch(scene.sineOf(scene.x, scene.y));
  scene.launch(scene.squaresOf(scene.y));
  ASSERT_OK(tape->backward());
  EXPECT_NEAR(get(*scene.x->adjoint(), {2}), scene.expected(0.3, 2), 1e-15);
}

TEST(RuntimeTape, GivesReverseTheSameRandomNumbers) {
  Scene scene;
  auto log = makeField(scene.runtime, "log", ScalarKind::I64, {100});
  KernelInfo info;
  info.name = "noise";
  info.trees = {scene.tree(*log)};
  info.summary = {{scene.loss, AccessKind::Accumulate},
                  {scene.x, AccessKind::Read}};
  info.function = [](TaiFrame *frame) {
    auto *log = static_cast<int64_t *>(frame->trees[0]);
    log[++log[0]] = int64_t(frame->launch);
    return 0;
  };
  KernelInfo reverse = info;
  info.adjoint = scene.runtime.launcher().kernels().create(reverse);
  auto noise = scene.runtime.launcher().kernels().create(info);
  auto tape = scene.begin();
  for (int i = 0; i < 3; ++i)
    scene.launch(noise);
  ASSERT_OK(tape->backward());
  ASSERT_OK(tape->replay(true, true));
  std::vector<int64_t> launches(100);
  ASSERT_OK(scene.runtime.copies().copyOut(*log, launches.data()));
  EXPECT_EQ(std::vector<int64_t>(launches.begin(), launches.begin() + 13),
            (std::vector<int64_t>{12, 0, 1, 2, 2, 1, 0, 3, 4, 5, 5, 4, 3}));
}

// A record that does not exist cannot be launched again, nor can a record of a
// tape that is still recording.
TEST(RuntimeTape, RefusesRecordsThatAreNotThere) {
  Scene scene;
  scene.startAt(0.3);
  auto tape = scene.begin();
  scene.launch(scene.sineOf(scene.x, scene.y));
  EXPECT_EQ(tape->runRecord(0).message(),
            "a record cannot be launched again while its tape records");
  ASSERT_OK(tape->backward());
  EXPECT_EQ(tape->runRecord(-1).message(), "the tape has no record -1");
  EXPECT_EQ(tape->runRecord(1).message(), "the tape has no record 1");
  EXPECT_OK(tape->runRecord(0));
  EXPECT_FALSE(tape->setCheckpoints({CheckpointPolicy::Kind::Periodic}).ok());
  // A host function between the stores does not count as an overwrite.
  tape = scene.begin();
  auto step = scene.sineOf(scene.x, scene.y);
  scene.launch(step);
  tape->recordCallback({nullptr, nullptr});
  scene.launch(step);
  ASSERT_EQ(tape->overwrites().size(), 1u);
  EXPECT_EQ(tape->overwrites()[0].record, 2);
  ASSERT_OK(tape->backward());
  EXPECT_OK(tape->runRecord(1));
}

TEST(RuntimeTape, RefusesWhatMakesNoSense) {
  Scene scene;
  std::unique_ptr<Tape> tape, second;
  EXPECT_EQ(scene.runtime.beginTape(scene.x, true, tape).message(),
            "the loss 'x' must be one floating-point number (a field without "
            "indices)");
  FieldPtr bare = makeField(scene.runtime, "bare", ScalarKind::F32, {});
  EXPECT_EQ(scene.runtime.beginTape(bare, true, tape).message(),
            "the loss 'bare' has no adjoint field");
  tape = scene.begin();
  EXPECT_EQ(scene.runtime.beginTape(scene.loss, true, second).code(),
            StatusCode::Usage);
  EXPECT_EQ(tape->replay(true, true).code(), StatusCode::Usage);
  // A needed kernel without an adjoint is an error, not a zero gradient.
  auto opaque = makeKernel(
      scene.runtime, "opaque", [](TaiFrame *) { return 0; },
      {{scene.x, AccessKind::Read}, {scene.loss, AccessKind::Accumulate}});
  scene.launch(opaque);
  EXPECT_EQ(tape->backward().message(), "kernel 'opaque' has no adjoint");
  tape.reset();
  tape = scene.begin();
  ASSERT_OK(scene.runtime.destroyTree("loss_grad_tree"));
  EXPECT_EQ(tape->backward().message(),
            "the tree of the loss 'loss' has been destroyed");
}

TEST(RuntimeTape, ReportsFailuresOfAdjoints) {
  Scene scene;
  auto failing = scene.pair(
      "failing", scene.x, scene.loss, AccessKind::Accumulate,
      [](TaiFrame *) { return 0; },
      [](TaiFrame *frame) {
        tai_rt_fail(frame, TAI_FAIL_INDEX, "bad index", "f:3:4", 0, nullptr,
                    nullptr, nullptr);
        return 1;
      },
      0);
  auto tape = scene.begin();
  scene.launch(failing);
  Status status = tape->backward();
  EXPECT_EQ(status.message(), "bad index");
  EXPECT_EQ(status.where(), "f:3:4");
}

// A launch that fails while a tape records is not part of the sequence.
TEST(RuntimeTape, LeavesFailedLaunchesOut) {
  Scene scene;
  auto failing =
      makeKernel(scene.runtime, "failing", [](TaiFrame *) { return 1; }, {});
  auto tape = scene.begin();
  EXPECT_FALSE(scene.runtime.launch(*failing, nullptr, 0, nullptr).ok());
  EXPECT_EQ(tape->numRecords(), 0);
}

//===----------------------------------------------------------------------===//
// Host programs
//===----------------------------------------------------------------------===//

namespace {
struct Program {
  Scene *scene;
  HostModule module;
  std::map<std::string, KernelPtr> kernels;

  explicit Program(Scene &scene) : scene(&scene) {
    module.findKernel = [this](std::string_view name) {
      return kernels[std::string(name)].get();
    };
  }
  Status run(TaiKernelFn function, uint64_t arg = 0) {
    return runHost(scene->runtime, function, {scene->tree(*scene->loss)},
                   module, &arg, nullptr);
  }
};

int32_t body(TaiFrame *frame, void *) {
  uint64_t scale = slotOf(2);
  return tai_rt_host_launch(frame, "step", &scale, 1, nullptr, 0) ||
         tai_rt_host_launch(frame, "@sum", nullptr, 0, nullptr, 0);
}
} // namespace

TEST(RuntimeHost, RunsATape) {
  Scene scene;
  Program program(scene);
  program.kernels["step"] = scene.sineOf(scene.x, scene.y);
  program.kernels["sum"] = scene.squaresOf(scene.y);
  scene.startAt(0.3);
  ASSERT_OK(program.run([](TaiFrame *frame) -> int32_t {
    return tai_rt_host_tape_begin(frame, "loss") || body(frame, nullptr) ||
           tai_rt_host_tape_end(frame);
  }));
  EXPECT_NEAR(get(*scene.x->adjoint(), {1}), scene.expected(0.3, 1, 2), 1e-15);
  EXPECT_EQ(scene.runtime.recordings().current(), nullptr);
}

TEST(RuntimeHost, ReportsErrors) {
  Scene scene;
  Program program(scene);
  EXPECT_EQ(program
                .run([](TaiFrame *frame) {
                  return tai_rt_host_launch(frame, "nobody", nullptr, 0,
                                            nullptr, 0);
                })
                .message(),
            "there is no kernel 'nobody' in this module");
  EXPECT_EQ(program
                .run([](TaiFrame *frame) {
                  return tai_rt_host_tape_begin(frame, "nothing");
                })
                .message(),
            "there is no field 'nothing'");
  EXPECT_EQ(
      program.run([](TaiFrame *frame) { return tai_rt_host_tape_end(frame); })
          .message(),
      "no tape is open");
  // A program that stops in the middle of a tape leaves none open.
  EXPECT_FALSE(program
                   .run([](TaiFrame *frame) -> int32_t {
                     return tai_rt_host_tape_begin(frame, "loss") || 1;
                   })
                   .ok());
  EXPECT_EQ(scene.runtime.recordings().current(), nullptr);
}

// Host programs need their kernels, fields and trees; kernels belong to no
// program.
TEST(RuntimeHost, ReportsWhatIsMissing) {
  Scene scene;
  for (TaiKernelFn function : std::initializer_list<TaiKernelFn>{
           [](TaiFrame *frame) {
             return tai_rt_host_launch(frame, "step", nullptr, 0, nullptr, 0);
           },
           [](TaiFrame *frame) {
             return tai_rt_host_tape_begin(frame, "loss");
           },
           [](TaiFrame *frame) { return tai_rt_host_tape_end(frame); },
           [](TaiFrame *frame) {
             return tai_rt_host_check_gradient(frame, "loss", nullptr, 0, 1e-9,
                                               body, nullptr, nullptr);
           }})
    EXPECT_EQ(launchOnce(scene.runtime, function).code(), StatusCode::Usage);

  Program program(scene);
  program.kernels["step"] = scene.sineOf(scene.x, scene.y);
  auto messageOf = [&](TaiKernelFn function) {
    std::string message(program.run(function).message());
    EXPECT_EQ(scene.runtime.recordings().current(), nullptr);
    return message;
  };
  EXPECT_EQ(messageOf([](TaiFrame *frame) {
              uint64_t scale = slotOf(2), result = 0;
              return tai_rt_host_launch(frame, "step", &scale, 1, &result, 1);
            }),
            "kernel '" + program.kernels["step"]->name() +
                "' returns 0 slots, but the launch expects 1");
  // A tape without a loss, and a nested tape.
  EXPECT_EQ(messageOf([](TaiFrame *frame) {
              return tai_rt_host_tape_begin(frame, nullptr);
            }),
            "");
  EXPECT_NE(messageOf([](TaiFrame *frame) -> int32_t {
              return tai_rt_host_tape_begin(frame, "@loss") ||
                     tai_rt_host_check_gradient(frame, "@loss", nullptr, 0,
                                                1e-9, body, nullptr, nullptr);
            }),
            "");
  EXPECT_EQ(messageOf([](TaiFrame *frame) {
              return tai_rt_host_check_gradient(frame, "nothing", nullptr, 0,
                                                1e-9, body, nullptr, nullptr);
            }),
            "there is no field 'nothing'");
  static const char *wrt;
  auto check = [](TaiFrame *frame) {
    return tai_rt_host_check_gradient(frame, "loss", &wrt, 1, 1e-9, body,
                                      nullptr, nullptr);
  };
  wrt = "nothing";
  EXPECT_EQ(messageOf(check), "there is no field 'nothing'");
  FieldPtr whole = makeField(scene.runtime, "whole", ScalarKind::I32, {});
  wrt = "whole";
  EXPECT_EQ(messageOf(check), "field 'whole' has no adjoint to be checked");
  whole = makeDifferentiable(scene.runtime, "counts", ScalarKind::I32, {});
  wrt = "counts";
  EXPECT_EQ(messageOf(check), "field 'counts' has no adjoint to be checked");

  // A program without a lookup of kernels, or whose tree was destroyed.
  program.module.findKernel = nullptr;
  EXPECT_EQ(messageOf([](TaiFrame *frame) {
              return tai_rt_host_launch(frame, "step", nullptr, 0, nullptr, 0);
            }),
            "there is no kernel 'step' in this module");
  TreePtr tree = scene.tree(*scene.loss);
  ASSERT_OK(scene.runtime.destroyTree(tree->name()));
  Status gone = runHost(
      scene.runtime, [](TaiFrame *) { return 0; }, {tree}, program.module,
      nullptr, nullptr);
  EXPECT_EQ(gone.message(), "the host program uses tree '" + tree->name() +
                                "', which has been destroyed");
}

// The checked region may fail at any of its evaluations.
TEST(RuntimeHost, ChecksOfWhatFails) {
  static int left;
  auto failing = [](TaiFrame *frame, void *) -> int32_t {
    return left-- == 0 || body(frame, nullptr);
  };
  static int32_t (*region)(TaiFrame *, void *);
  region = failing;
  auto check = [](TaiFrame *frame) {
    const char *wrt[] = {"x"};
    return tai_rt_host_check_gradient(frame, "loss", wrt, 1, 1e-9, region,
                                      nullptr, nullptr);
  };
  int failures = 0;
  for (int fails = 0; fails != 200; ++fails) {
    Scene scene;
    Program program(scene);
    program.kernels["step"] = scene.sineOf(scene.x, scene.y);
    program.kernels["sum"] = scene.squaresOf(scene.y);
    scene.startAt(0.3);
    left = fails;
    Status status = program.run(check);
    EXPECT_EQ(scene.runtime.recordings().current(), nullptr);
    if (status)
      break;
    ++failures;
    EXPECT_EQ(status.message(), "the host program failed");
  }
  // The recorded run, one that finds the written fields, and 4 times 18 pairs.
  EXPECT_EQ(failures, 1 + 1 + 4 * 18 * 2);
}

static int32_t checkX(TaiFrame *frame) {
  const char *wrt[] = {"x"};
  return tai_rt_host_check_gradient(frame, "loss", wrt, 1, 1e-9, body, nullptr,
                                    "f.mlir:3:4");
}

TEST(RuntimeHost, ChecksGradients) {
  Scene scene;
  Program program(scene);
  program.kernels["step"] = scene.sineOf(scene.x, scene.y);
  program.kernels["sum"] = scene.squaresOf(scene.y);
  scene.startAt(0.3);
  set(*scene.loss, {}, 10); // a tape starts from an empty loss
  ASSERT_OK(program.run(checkX));
  // All fields are as the tape left them.
  double loss = 0;
  for (int64_t i = 0; i < n; ++i) {
    EXPECT_EQ(get(*scene.x, {i}), 0.3 + 0.1 * double(i));
    EXPECT_NEAR(get(*scene.x->adjoint(), {i}), scene.expected(0.3, i, 2),
                1e-15);
    loss += std::pow(2 * std::sin(0.3 + 0.1 * double(i)), 2);
  }
  EXPECT_NEAR(get(*scene.loss), loss, 1e-12);
}

TEST(RuntimeHost, FindsWrongGradients) {
  Scene scene;
  Program program(scene);
  // One element of the adjoint is off by a millionth.
  program.kernels["step"] = scene.pair(
      "step", scene.x, scene.y, AccessKind::Write, sine,
      [](TaiFrame *frame) {
        sineAdjoint<false>(frame);
        in<2>(frame)[3] *= 1 + 1e-6;
        return 0;
      },
      1);
  program.kernels["sum"] = scene.squaresOf(scene.y);
  scene.startAt(0.3);
  Status status = program.run(checkX);
  EXPECT_EQ(status.code(), StatusCode::Check);
  EXPECT_EQ(status.where(), "f.mlir:3:4");
  EXPECT_NE(status.message().find("the gradient of 'loss' by 'x' disagrees"),
            std::string::npos)
      << status.message();
  // A NaN in the gradient fails, too.
  program.kernels["step"] = scene.pair(
      "step", scene.x, scene.y, AccessKind::Write, sine,
      [](TaiFrame *frame) {
        in<2>(frame)[3] = std::nan("");
        return 0;
      },
      1);
  EXPECT_EQ(program.run(checkX).code(), StatusCode::Check);
}
