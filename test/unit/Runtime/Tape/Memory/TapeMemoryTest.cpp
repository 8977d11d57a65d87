//===- TapeMemoryTest.cpp - Values that a tape saves ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// States without a time axis. Kernels and adjoints are hand-written, with plans
// of the values that the adjoints read; the expected derivatives are closed
// forms.
//
//===----------------------------------------------------------------------===//

#include "../../../Utils/RuntimeTestUtils.h"
#include <cmath>
#include <map>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

namespace {
constexpr int64_t n = 4;

template <int tree> double *in(TaiFrame *frame) {
  return static_cast<double *>(frame->trees[tree]);
}

struct Scene {
  Runtime runtime;
  FieldPtr x = makeDifferentiable(runtime, "x", ScalarKind::F64, {n});
  FieldPtr y = makeDifferentiable(runtime, "y", ScalarKind::F64, {n});
  FieldPtr loss = makeDifferentiable(runtime, "loss", ScalarKind::F64, {});

  TreePtr tree(const Field &field) {
    return runtime.store().findTree(field.tree().name());
  }
  /// A kernel over `fields`; its adjoint gets the fields and then their
  /// adjoints.
  KernelPtr make(const std::string &name, const std::vector<FieldPtr> &fields,
                 std::vector<Access> summary, TaiKernelFn function,
                 TaiKernelFn reverse, const AdjointAccesses &plan,
                 int64_t slots = 0) {
    KernelInfo info;
    info.name = name;
    info.argSlots = slots;
    info.summary = std::move(summary);
    info.function = function;
    KernelInfo adjoint;
    adjoint.name = name + "_grad";
    adjoint.argSlots = slots;
    adjoint.function = reverse;
    for (const FieldPtr &field : fields)
      info.trees.push_back(tree(*field));
    adjoint.trees = info.trees;
    for (const FieldPtr &field : fields)
      if (field->adjoint())
        adjoint.trees.push_back(tree(*field->adjoint()));
    info.adjoint = runtime.launcher().kernels().create(adjoint);
    info.zeroesAdjoints = true;
    provide(info).onPlanAdjoint = [plan](Kernel &, AdjointAccesses &result) {
      result = plan;
      return Status::success();
    };
    return runtime.launcher().kernels().create(info);
  }

  /// x[i] = x[i]^2 in place: the adjoint needs x from before the launch.
  KernelPtr square() {
    return make(
        "square", {x}, {{x, AccessKind::Read}, {x, AccessKind::Write}},
        [](TaiFrame *frame) {
          for (int64_t i = 0; i < n; ++i)
            in<0>(frame)[i] *= in<0>(frame)[i];
          return 0;
        },
        [](TaiFrame *frame) {
          for (int64_t i = 0; i < n; ++i)
            in<1>(frame)[i] *= 2 * in<0>(frame)[i];
          return 0;
        },
        {{{x, AccessKind::Read}}, {x}, false, {}});
  }
  /// Like square(), with an adjoint that squares again while it runs.
  KernelPtr squareByRerun() {
    return make(
        "rerun", {x}, {{x, AccessKind::Read}, {x, AccessKind::Write}},
        [](TaiFrame *frame) {
          for (int64_t i = 0; i < n; ++i)
            in<0>(frame)[i] *= in<0>(frame)[i];
          return 0;
        },
        [](TaiFrame *frame) {
          for (int64_t i = 0; i < n; ++i) {
            double before = in<0>(frame)[i];
            in<0>(frame)[i] *= before;
            in<1>(frame)[i] *= 2 * before;
          }
          return 0;
        },
        {{{x, AccessKind::Read}}, {x}, true, {}});
  }
  /// y[i] += sin(x[i]); the adjoint reads the x after the launch.
  KernelPtr addSine() {
    return make(
        "sine", {x, y}, {{x, AccessKind::Read}, {y, AccessKind::Accumulate}},
        [](TaiFrame *frame) {
          for (int64_t i = 0; i < n; ++i)
            in<1>(frame)[i] += std::sin(in<0>(frame)[i]);
          return 0;
        },
        [](TaiFrame *frame) {
          for (int64_t i = 0; i < n; ++i)
            in<2>(frame)[i] += in<3>(frame)[i] * std::cos(in<0>(frame)[i]);
          return 0;
        },
        {{{x, AccessKind::Read}}, {}, false, {}});
  }
  /// x[i] += 0.5 y[i]: linear, so the adjoint reads no values.
  KernelPtr drift() {
    return make(
        "drift", {x, y}, {{y, AccessKind::Read}, {x, AccessKind::Accumulate}},
        [](TaiFrame *frame) {
          for (int64_t i = 0; i < n; ++i)
            in<0>(frame)[i] += 0.5 * in<1>(frame)[i];
          return 0;
        },
        [](TaiFrame *frame) {
          for (int64_t i = 0; i < n; ++i)
            in<3>(frame)[i] += 0.5 * in<2>(frame)[i];
          return 0;
        },
        {});
  }
  /// loss += sum of x
  KernelPtr sum() {
    return make(
        "sum", {x, loss},
        {{x, AccessKind::Read}, {loss, AccessKind::Accumulate}},
        [](TaiFrame *frame) {
          for (int64_t i = 0; i < n; ++i)
            *in<1>(frame) += in<0>(frame)[i];
          return 0;
        },
        [](TaiFrame *frame) {
          for (int64_t i = 0; i < n; ++i)
            in<2>(frame)[i] += *in<3>(frame);
          return 0;
        },
        {});
  }

  void launch(const KernelPtr &kernel) {
    EXPECT_OK(runtime.launch(*kernel, nullptr, 0, nullptr));
  }
  std::unique_ptr<Tape> begin() {
    std::unique_ptr<Tape> tape;
    EXPECT_OK(runtime.beginTape(loss, true, tape));
    return tape;
  }
  void startAt(double first) {
    for (int64_t i = 0; i < n; ++i) {
      set(*x, {i}, first + 0.1 * double(i));
      set(*y, {i}, 0.2);
    }
  }
  std::vector<double> values(const Field &field) {
    std::vector<double> result;
    for (int64_t i = 0; i < n; ++i)
      result.push_back(get(field, {i}));
    return result;
  }
  std::vector<double> gradient() { return values(*x->adjoint()); }
};

/// The derivative of the final x with respect to the initial x after `steps`
/// steps of y += sin x, x += y / 2, by forward differentiation.
double swing(double x, int steps) {
  double y = 0.2, dx = 1, dy = 0;
  for (int s = 0; s < steps; ++s) {
    dy += std::cos(x) * dx;
    y += std::sin(x);
    dx += 0.5 * dy;
    x += 0.5 * y;
  }
  return dx;
}
} // namespace

TEST(RuntimeTapeSave, StateWithoutTime) {
  Scene scene;
  auto kick = scene.addSine(), drift = scene.drift(), sum = scene.sum();
  scene.startAt(0.3);
  auto tape = scene.begin();
  constexpr int steps = 20;
  for (int s = 0; s < steps; ++s) {
    scene.launch(kick);
    scene.launch(drift);
  }
  scene.launch(sum);
  auto last = scene.values(*scene.x);
  // x is saved once in each step; y, which no adjoint reads, is never saved.
  EXPECT_EQ(tape->stats().savedBytes, steps * n * 8);
  for (int round = 0; round < 2; ++round) {
    EXPECT_TRUE(scene.runtime.gradients().clear());
    ASSERT_OK(tape->backward());
    for (int64_t i = 0; i < n; ++i)
      EXPECT_NEAR(scene.gradient()[i], swing(0.3 + 0.1 * double(i), steps),
                  1e-12);
    EXPECT_EQ(scene.values(*scene.x), last) << "memory is left as it was";
  }
  // Replay with other contents.
  scene.startAt(-0.7);
  ASSERT_OK(tape->replay(true, true));
  for (int64_t i = 0; i < n; ++i)
    EXPECT_NEAR(scene.gradient()[i], swing(-0.7 + 0.1 * double(i), steps),
                1e-12);
  EXPECT_EQ(tape->stats().savedBytes, steps * n * 8);
  EXPECT_NE(tape->explain().find("@drift: replayed, from the adjoints of @x to "
                                 "those of @y; record 2 reads @x; saved 32 B"),
            std::string::npos)
      << tape->explain();
}

TEST(RuntimeTapeSave, BeforeAndRerun) {
  for (bool rerun : {false, true}) {
    Scene scene;
    auto square = rerun ? scene.squareByRerun() : scene.square();
    auto sum = scene.sum();
    scene.startAt(0.6);
    auto tape = scene.begin();
    for (int s = 0; s < 3; ++s)
      scene.launch(square);
    scene.launch(sum);
    EXPECT_EQ(tape->stats().savedBytes, 3 * n * 8);
    auto last = scene.values(*scene.x);
    ASSERT_OK(tape->backward());
    for (int64_t i = 0; i < n; ++i)
      EXPECT_NEAR(scene.gradient()[i], 8 * std::pow(0.6 + 0.1 * double(i), 7),
                  1e-14);
    EXPECT_EQ(scene.values(*scene.x), last);
  }
}

TEST(RuntimeTapeSave, OnlyWhatReallyChanges) {
  Scene scene;
  auto none = scene.make(
      "none", {scene.x}, {{scene.x, AccessKind::Write}},
      [](TaiFrame *) { return 0; }, [](TaiFrame *) { return 0; }, {});
  auto kick = scene.addSine();
  scene.startAt(0.3);
  auto tape = scene.begin();
  scene.launch(kick);
  scene.launch(none);
  EXPECT_EQ(tape->stats().savedBytes, 0);
  // The first launch still needs the values that this launch overwrites.
  scene.launch(scene.drift());
  EXPECT_EQ(tape->stats().savedBytes, n * 8);
}

TEST(RuntimeTapeSave, LargeFieldsByCells) {
  Scene scene;
  constexpr int64_t size = 100000;
  auto big = makeDifferentiable(scene.runtime, "big", ScalarKind::F64, {size});
  auto touch = makeKernel(scene.runtime, "touch",
                          [](TaiFrame *frame) {
                            in<0>(frame)[70000] += 1;
                            return 0;
                          },
                          {{big, AccessKind::Read}, {big, AccessKind::Write}});
  auto tape = scene.begin();
  scene.launch(touch);
  EXPECT_EQ(tape->stats().savedBytes, 0);
  scene.launch(touch);
  EXPECT_GT(tape->stats().savedBytes, 0);
  EXPECT_LE(tape->stats().savedBytes, 8192);
}

TEST(RuntimeTapeSave, FixedIndicesDoNotMeet) {
  Scene scene;
  constexpr int64_t steps = 6;
  auto path =
      makeDifferentiable(scene.runtime, "path", ScalarKind::F64, {steps, 3});
  KernelInfo info;
  info.name = "step";
  info.argSlots = 1;
  FixedIndex now{0, 0, {{0, 32, 1}}}, next{0, 1, {{0, 32, 1}}};
  info.summary = {{path, AccessKind::Read, {now}},
                  {path, AccessKind::Write, {next}}};
  info.trees = {scene.tree(*path)};
  info.function = [](TaiFrame *frame) {
    int64_t t = static_cast<int32_t>(frame->args[0]);
    for (int64_t i = 0; i < 3; ++i)
      in<0>(frame)[3 * (t + 1) + i] = std::sin(in<0>(frame)[3 * t + i]) + 1;
    return 0;
  };
  provide(info).onPlanAdjoint = [&](Kernel &, AdjointAccesses &plan) {
    plan.reads = {{path, AccessKind::Read, {now}}};
    return Status::success();
  };
  auto step = scene.runtime.launcher().kernels().create(info);
  auto tape = scene.begin();
  auto run = [&](uint64_t t) {
    EXPECT_OK(scene.runtime.launch(*step, &t, 1, nullptr));
  };
  for (uint64_t t = 0; t + 1 < steps; ++t)
    run(t);
  EXPECT_EQ(tape->stats().savedBytes, 0);
  // Again from the start: launch 1 reads slab 1.
  set(*path, {0, 0}, 0.5);
  run(0);
  EXPECT_EQ(tape->stats().savedBytes, 8 * 3);
}

TEST(RuntimeTapeSave, StridedLayouts) {
  // Interleaved with another field, in blocks, and with the slow index last.
  Scene scene;
  TreePtr tree;
  ASSERT_OK(scene.runtime.store().addTree("cells", 8 * 2 * 12, tree));
  auto add = [&](const char *name, int64_t place) {
    FieldInfo info;
    info.name = name;
    info.tree = tree;
    info.layout.scalar = ScalarKind::F64;
    info.layout.placeOffset = place;
    // 4 x 3, with two blocks of two along the first index.
    info.layout.indices = {{{2, 2, 96}, {1, 2, 48}}, {{1, 3, 16}}};
    FieldPtr field;
    EXPECT_OK(scene.runtime.store().addField(info, field));
    return field;
  };
  FieldPtr a = add("a", 0), b = add("b", 8);
  auto fill = [&](Field &field, double base) {
    for (int64_t i = 0; i < 4; ++i)
      for (int64_t j = 0; j < 3; ++j)
        set(field, {i, j}, base + 10 * double(i) + double(j));
  };
  fill(*a, 100);
  fill(*b, 500);
  FixedIndex column{1, 0, {{0, 32, 1}}};
  auto touch = makeKernel(
      scene.runtime, "touch",
      [](TaiFrame *frame) {
        int64_t j = static_cast<int32_t>(frame->args[0]);
        for (int64_t i = 0; i < 4; ++i) {
          in<0>(frame)[6 * i + 2 * j] += 1;
          in<0>(frame)[6 * i + 2 * j + 1] += 2;
        }
        return 0;
      },
      {{a, AccessKind::Read, {column}},
       {a, AccessKind::Write, {column}},
       {b, AccessKind::Accumulate, {column}}},
      1);
  auto tape = scene.begin();
  std::vector<double> seen;
  tape->recordCallback({nullptr, [&] {
                          for (int64_t i = 0; i < 4; ++i)
                            seen.push_back(get(*a, {i, 1}));
                          for (int64_t i = 0; i < 4; ++i)
                            seen.push_back(get(*b, {i, 1}));
                          return Status::success();
                        }});
  for (uint64_t j : {1, 2, 1})
    EXPECT_OK(scene.runtime.launch(*touch, &j, 1, nullptr));
  // The third launch overwrites elements that the first launch reads: a column
  // of a and a column of b.
  EXPECT_EQ(tape->stats().savedBytes, 2 * 4 * 8);
  ASSERT_OK(tape->backward());
  EXPECT_EQ(seen, (std::vector<double>{102, 112, 122, 132, 503, 513, 523, 533}))
      << "before the third launch";
  EXPECT_EQ(get(*a, {3, 1}), 133);
  EXPECT_EQ(get(*b, {3, 2}), 534);
}

TEST(RuntimeTapeSave, WritesOfTheHost) {
  Scene scene;
  auto kick = scene.addSine(), drift = scene.drift(), sum = scene.sum();
  scene.startAt(0.3);
  Runtime &runtime = scene.runtime;
  auto tape = scene.begin();
  scene.launch(kick);
  int64_t second = 1;
  ASSERT_OK(runtime.writes().writeF64(*scene.x, &second, 0, 2.5));
  scene.launch(kick);
  scene.launch(drift);
  scene.launch(sum);
  EXPECT_EQ(tape->numRecords(), 5);
  ASSERT_OK(tape->backward());
  for (int64_t i = 0; i < n; ++i) {
    double at = 0.3 + 0.1 * double(i);
    double by = i == 1 ? 0.5 * std::cos(at) : 1 + std::cos(at);
    EXPECT_NEAR(scene.gradient()[i], by, 1e-14);
  }
  // The write of the host is part of the sequence.
  scene.startAt(0.8);
  ASSERT_OK(tape->replay(true, true));
  EXPECT_NEAR(get(*scene.x, {1}),
              2.5 + 0.5 * (0.2 + std::sin(0.9) + std::sin(2.5)), 1e-14);
  EXPECT_NEAR(scene.gradient()[1], 0.5 * std::cos(0.9), 1e-14);
  // Whole fields.
  tape.reset();
  tape = scene.begin();
  scene.launch(kick);
  ASSERT_OK(runtime.writes().fillF64(*scene.x, 1.0));
  std::vector<double> other(n, 0.25);
  ASSERT_OK(runtime.writes().copyIn(*scene.x, other.data()));
  scene.launch(drift);
  scene.launch(sum);
  tape->end();
  scene.startAt(0.4);
  ASSERT_OK(tape->replay(true, true));
  for (int64_t i = 0; i < n; ++i)
    EXPECT_NEAR(scene.gradient()[i], 0.5 * std::cos(0.4 + 0.1 * double(i)),
                1e-14);
  EXPECT_EQ(get(*scene.x, {0}), 0.25 + 0.5 * (0.2 + std::sin(0.4)));
}

TEST(RuntimeTapeSave, HostFunctions) {
  Scene scene;
  auto kick = scene.addSine(), drift = scene.drift(), sum = scene.sum();
  scene.startAt(0.3);
  // kick and drift as one step with a custom gradient, which reads x.
  auto forward = [&] {
    scene.launch(kick);
    scene.launch(drift);
    return Status::success();
  };
  auto backward = [&] {
    Status status = scene.runtime.launchAdjoint(*drift, nullptr, 0);
    if (!status)
      return status;
    // The adjoint of the first kernel needs the x that preceded the second
    // kernel.
    for (int64_t i = 0; i < n; ++i)
      set(*scene.x, {i}, get(*scene.x, {i}) - 0.5 * get(*scene.y, {i}));
    return scene.runtime.launchAdjoint(*kick, nullptr, 0);
  };
  auto tape = scene.begin();
  constexpr int steps = 5;
  for (int s = 0; s < steps; ++s) {
    tape->suspend();
    EXPECT_OK(forward());
    ASSERT_OK(tape->resume());
    tape->recordCallback({forward, backward});
  }
  scene.launch(sum);
  ASSERT_OK(tape->backward());
  for (int64_t i = 0; i < n; ++i)
    EXPECT_NEAR(scene.gradient()[i], swing(0.3 + 0.1 * double(i), steps),
                1e-12);
}

TEST(RuntimeTapeSave, Parts) {
  Scene scene;
  auto kick = scene.addSine(), drift = scene.drift(), sum = scene.sum();
  AdjointAccesses plan;
  plan.parts = {kick, drift};
  auto whole = scene.make(
      "whole", {scene.x, scene.y},
      {{scene.x, AccessKind::Read},
       {scene.x, AccessKind::Accumulate},
       {scene.y, AccessKind::Read},
       {scene.y, AccessKind::Accumulate}},
      [](TaiFrame *frame) {
        for (int64_t i = 0; i < n; ++i) {
          in<1>(frame)[i] += std::sin(in<0>(frame)[i]);
          in<0>(frame)[i] += 0.5 * in<1>(frame)[i];
        }
        return 0;
      },
      nullptr, plan);
  scene.startAt(0.3);
  auto tape = scene.begin();
  for (int s = 0; s < 3; ++s)
    scene.launch(whole);
  scene.launch(sum);
  EXPECT_EQ(tape->numRecords(), 7);
  ASSERT_OK(tape->backward());
  for (int64_t i = 0; i < n; ++i)
    EXPECT_NEAR(scene.gradient()[i], swing(0.3 + 0.1 * double(i), 3), 1e-13);
  // Without a tape, the kernel is launched as a whole.
  int64_t before = scene.runtime.counters().launches;
  scene.launch(whole);
  EXPECT_EQ(scene.runtime.counters().launches, before + 1);
}

TEST(RuntimeTapeSave, ChangedAfterwards) {
  Scene scene;
  auto kick = scene.addSine(), drift = scene.drift(), sum = scene.sum();
  scene.startAt(0.3);
  auto tape = scene.begin();
  scene.launch(kick);
  scene.launch(drift);
  scene.launch(sum);
  tape->end();
  ASSERT_OK(tape->backward());
  ASSERT_OK(scene.runtime.writes().fillF64(*scene.x, 3));
  EXPECT_EQ(tape->backward().message(),
            "field 'x' was changed by the host after the tape had recorded, "
            "and the gradient needs what it held; replay the tape forward and "
            "backward instead");
  ASSERT_OK(tape->replay(true, true));
  EXPECT_NEAR(scene.gradient()[0], 1 + 0.5 * std::cos(3), 1e-15);
  scene.launch(drift);
  EXPECT_FALSE(tape->backward().ok()) << "changed by a kernel";
  ASSERT_OK(tape->replay(true, true));
  // An element that no adjoint reads only causes a warning.
  ASSERT_OK(scene.runtime.writes().fillF64(*scene.y, 3));
  EXPECT_TRUE(scene.runtime.gradients().clear());
  ASSERT_OK(tape->backward());
  ASSERT_EQ(tape->warnings().size(), 1u);
  EXPECT_NE(tape->warnings()[0].find("field 'y' was changed by the host"),
            std::string::npos);
}

TEST(RuntimeTapeSave, Warnings) {
  Scene scene;
  auto tape = scene.begin();
  ASSERT_OK(tape->backward());
  ASSERT_EQ(tape->warnings().size(), 1u);
  EXPECT_EQ(tape->warnings()[0], "the tape has recorded no launch: there is "
                                 "nothing to differentiate");
  tape.reset();
  tape = scene.begin();
  scene.launch(scene.drift());
  ASSERT_OK(tape->backward());
  ASSERT_EQ(tape->warnings().size(), 1u);
  EXPECT_EQ(tape->warnings()[0], "the loss 'loss' does not depend on any field "
                                 "that has a gradient");
}

TEST(RuntimeTapeSave, SeveralLossesAndSeeds) {
  Scene scene;
  auto kick = scene.addSine(), drift = scene.drift();
  scene.startAt(0.3);
  std::unique_ptr<Tape> tape;
  ASSERT_OK(scene.runtime.beginTape(nullptr, true, tape));
  ASSERT_OK(tape->addLoss(scene.y));
  EXPECT_FALSE(tape->addLoss(scene.y).ok());
  EXPECT_EQ(get(*scene.y, {0}), 0.2) << "only sums are emptied";
  scene.launch(kick);
  scene.launch(drift);
  EXPECT_EQ(tape->backward().message(),
            "the loss 'y' is more than one number, so the tape needs a seed "
            "for it");
  double seed[n] = {1, 2, 3, 4};
  EXPECT_FALSE(tape->setSeed(*scene.x, seed).ok());
  ASSERT_OK(tape->setSeed(*scene.y, seed));
  ASSERT_OK(tape->backward());
  for (int64_t i = 0; i < n; ++i)
    EXPECT_NEAR(scene.gradient()[i],
                double(i + 1) * std::cos(0.3 + 0.1 * double(i)), 1e-15);
}

TEST(RuntimeTapeSave, OutOfMemory) {
  Options options;
  options.memoryLimit = 2000;
  Runtime runtime(options);
  auto x = makeField(runtime, "x", ScalarKind::F64, {100});
  auto touch = makeKernel(runtime, "touch",
                          [](TaiFrame *frame) {
                            in<0>(frame)[0] += 1;
                            return 0;
                          },
                          {{x, AccessKind::Read}, {x, AccessKind::Write}});
  std::unique_ptr<Tape> tape;
  ASSERT_OK(runtime.beginTape(nullptr, true, tape));
  Status status;
  int launches = 0;
  while (status && launches < 10) {
    status = runtime.launch(*touch, nullptr, 0, nullptr);
    ++launches;
  }
  EXPECT_EQ(launches, 3);
  EXPECT_EQ(status.code(), StatusCode::Memory);
  EXPECT_EQ(get(*x, {0}), 2) << "the launch was not run";
}

TEST(RuntimeTapeSave, DestroyedTrees) {
  Scene scene;
  scene.startAt(0.3);
  auto tape = scene.begin();
  scene.launch(scene.addSine());
  scene.launch(scene.drift());
  scene.launch(scene.sum());
  ASSERT_OK(scene.runtime.destroyTree("x_tree"));
  EXPECT_FALSE(tape->backward().ok());
  EXPECT_FALSE(tape->replay(true, true).ok());
  EXPECT_FALSE(tape->explain().empty());
}

//===----------------------------------------------------------------------===//
// Recomputing
//===----------------------------------------------------------------------===//

/// The smallest number of steps to recompute, determined by trying all
/// positions of the next snapshot.
static int64_t
leastSteps(int64_t steps, int64_t snapshots,
           std::map<std::pair<int64_t, int64_t>, int64_t> &known) {
  if (steps <= 1)
    return 0;
  if (snapshots == 1)
    return steps * (steps - 1) / 2;
  auto [entry, added] = known.try_emplace({steps, snapshots}, INT64_MAX);
  if (!added)
    return entry->second;
  int64_t least = INT64_MAX;
  for (int64_t at = 1; at < steps; ++at)
    least = std::min(least, at + leastSteps(at, snapshots, known) +
                                leastSteps(steps - at, snapshots - 1, known));
  return known[{steps, snapshots}] = least;
}

using Kind = CheckpointPolicy::Kind;

TEST(RuntimeTapeSave, RecomputesTheSame) {
  constexpr int steps = 17;
  std::vector<double> expected;
  for (CheckpointPolicy policy : {CheckpointPolicy{Kind::None, 0, 0},
                                  {Kind::Binomial, 1, 0},
                                  {Kind::Binomial, 2, 0},
                                  {Kind::Binomial, 4, 0},
                                  {Kind::Binomial, 100, 0},
                                  {Kind::Periodic, 0, 0},
                                  {Kind::Periodic, 3, 0},
                                  {Kind::Mixed, 0, 0},
                                  {Kind::Mixed, 2, 0},
                                  {Kind::Mixed, 0, 400}}) {
    Scene scene;
    auto kick = scene.addSine(), drift = scene.drift(),
         square = scene.squareByRerun(), sum = scene.sum();
    scene.startAt(0.1);
    auto tape = scene.begin();
    ASSERT_OK(tape->setCheckpoints(policy));
    int64_t second = 1;
    auto both = [&] {
      scene.launch(kick);
      scene.launch(drift);
      return Status::success();
    };
    for (int s = 0; s < steps; ++s) {
      scene.launch(kick);
      scene.launch(drift);
      if (s == 3)
        ASSERT_OK(scene.runtime.writes().writeF64(*scene.x, &second, 0, 0.2));
      if (s % 8 == 5)
        scene.launch(square);
      if (s == 9) {
        // A host function without a custom gradient.
        tape->suspend();
        EXPECT_OK(both());
        ASSERT_OK(tape->resume());
        tape->recordCallback({both, nullptr});
      }
    }
    scene.launch(sum);
    auto last = scene.values(*scene.x);
    for (int round = 0; round < 2; ++round) {
      EXPECT_TRUE(scene.runtime.gradients().clear());
      ASSERT_OK(tape->backward());
      if (expected.empty())
        expected = scene.gradient();
      EXPECT_EQ(scene.gradient(), expected)
          << int(policy.kind) << " " << policy.snapshots;
      EXPECT_EQ(scene.values(*scene.x), last);
    }
    scene.startAt(0.1);
    ASSERT_OK(tape->replay(true, true));
    EXPECT_EQ(scene.gradient(), expected);
    EXPECT_EQ(scene.values(*scene.x), last);
    if (policy.budget)
      EXPECT_LE(tape->stats().peakBytes, policy.budget);
    if (policy.kind == Kind::Binomial) {
      EXPECT_LE(tape->stats().snapshots, policy.snapshots);
      EXPECT_GE(tape->stats().recomputed, tape->stats().optimum);
    }
  }
  EXPECT_NE(expected[0], 0);
}

TEST(RuntimeTapeSave, KnowsTheOptimum) {
  std::map<std::pair<int64_t, int64_t>, int64_t> known;
  for (int64_t snapshots : {1, 2, 3, 5})
    for (int64_t steps : {1, 2, 7, 20, 41}) {
      Scene scene;
      auto kick = scene.addSine();
      auto tape = scene.begin();
      ASSERT_OK(tape->setCheckpoints({Kind::Binomial, snapshots, 0}));
      for (int64_t s = 0; s < steps; ++s)
        scene.launch(kick);
      EXPECT_EQ(tape->stats().optimum,
                leastSteps(steps, tape->stats().snapshots, known));
    }
}

TEST(RuntimeTapeSave, RefusesBadPolicies) {
  Scene scene;
  auto kick = scene.addSine(), drift = scene.drift(), sum = scene.sum();
  scene.startAt(0.3);
  auto tape = scene.begin();
  EXPECT_FALSE(tape->setCheckpoints({Kind::Mixed, -1, 0}).ok());
  ASSERT_OK(tape->setCheckpoints({Kind::Mixed, 0, 10}));
  scene.launch(kick);
  EXPECT_FALSE(tape->setCheckpoints({Kind::None, 0, 0}).ok());
  scene.launch(drift);
  scene.launch(sum);
  Status status = tape->backward();
  EXPECT_EQ(status.code(), StatusCode::Memory);
  EXPECT_NE(status.message().find("a memory budget of 10 B is too small"),
            std::string::npos)
      << status.message();
  // A launch that cannot be repeated.
  tape.reset();
  tape = scene.begin();
  ASSERT_OK(tape->setCheckpoints({Kind::Periodic, 0, 0}));
  tape->suspend();
  scene.launch(kick);
  ASSERT_OK(tape->resume());
  scene.launch(drift);
  EXPECT_FALSE(tape->backward().ok());
}

TEST(RuntimeTapeSave, WhatWasNotPlannedIsNotLaunched) {
  // The kernel has an adjoint, but no plan of the values that the tape must
  // save.
  Scene scene;
  KernelInfo info;
  info.name = "square";
  info.trees = {scene.tree(*scene.x), scene.tree(*scene.loss)};
  info.summary = {{scene.x, AccessKind::Read},
                  {scene.loss, AccessKind::Accumulate}};
  info.function = [](TaiFrame *) { return 0; };
  int adjointsMade = 0;
  provide(info).onMakeAdjoint = [&](Kernel &, AdjointVariant,
                                    KernelPtr &adjoint) {
    ++adjointsMade;
    KernelInfo info;
    info.name = "square_grad";
    info.function = [](TaiFrame *) { return 0; };
    adjoint = scene.runtime.launcher().kernels().create(info);
    return Status::success();
  };
  provide(info).onPlanAdjoint = [](Kernel &, AdjointAccesses &) {
    return Status::failure(StatusCode::Compile, "no parts", "a.py:1:2");
  };
  auto kernel = scene.runtime.launcher().kernels().create(info);
  auto tape = scene.begin();
  ASSERT_OK(scene.runtime.launch(*kernel, nullptr, 0, nullptr));
  for (int repeat = 0; repeat < 2; ++repeat) {
    Status status = tape->backward();
    EXPECT_EQ(status.code(), StatusCode::Compile);
    EXPECT_EQ(status.message(), "no parts");
    EXPECT_EQ(status.where(), "a.py:1:2");
  }
}
