//===- PreparedLaunchesTest.cpp - Tests of launches that come again -------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The second launch of a kernel takes a shorter path than the first: tests
// invariants that must hold even if something has changed between two launches,
// and the number of driver calls of each launch.
//
//===----------------------------------------------------------------------===//

#include "../../Utils/RuntimeTestUtils.h"
#include "tai/Runtime/Device/Device.h"
#include "tai/Runtime/Mirror/OwedZeros.h"
#include "tai/Runtime/Queue/DeviceQueue.h"
#include <cstdlib>
#include <dlfcn.h>
#include <set>
#include <thread>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

/// Adds the second argument to the first number of the first tree.
static int32_t addHere(TaiFrame *frame) {
  double value;
  std::memcpy(&value, &frame->args[0], sizeof(value));
  *static_cast<double *>(frame->trees[0]) += value;
  return 0;
}

static Status add(Runtime &runtime, Kernel &kernel, double value) {
  uint64_t slot = slotOf(value);
  return runtime.launch(kernel, &slot, 1, nullptr);
}

/// A kernel that adds to x, launched often enough to take the short path.
static KernelPtr makeAdding(Runtime &runtime, const FieldPtr &x) {
  KernelPtr kernel =
      makeKernel(runtime, "add", addHere, {{x, AccessKind::Accumulate}}, 1);
  for (int i = 0; i < 3; ++i)
    EXPECT_OK(add(runtime, *kernel, 1.0));
  EXPECT_EQ(get(*x), 3.0);
  return kernel;
}

TEST(RuntimePrepared, FailsWhenATreeIsGone) {
  Runtime runtime;
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {});
  FieldPtr y = makeField(runtime, "y", ScalarKind::F64, {});
  KernelPtr onX = makeAdding(runtime, x), onY = makeAdding(runtime, y);
  EXPECT_OK(runtime.destroyTree("x_tree"));
  EXPECT_EQ(add(runtime, *onX, 1.0).message(),
            "kernel 'add' uses tree 'x_tree', which has been destroyed");
  EXPECT_OK(add(runtime, *onY, 1.0));
  EXPECT_EQ(get(*y), 4.0);
}

TEST(RuntimePrepared, GoesOnAfterFieldsArePlaced) {
  Runtime runtime;
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {});
  KernelPtr kernel = makeAdding(runtime, x);
  FieldPtr y = makeDifferentiable(runtime, "y", ScalarKind::F64, {4});
  EXPECT_OK(add(runtime, *kernel, 1.0));
  EXPECT_EQ(get(*x), 4.0);
}

// A field may become an adjoint after launches that use it.
TEST(RuntimePrepared, MarksAdjointsOfLaterFields) {
  Runtime runtime;
  FieldPtr g = makeField(runtime, "g", ScalarKind::F64, {});
  KernelPtr kernel = makeAdding(runtime, g);
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {}, {}, "g");
  EXPECT_TRUE(runtime.gradients().clear());
  EXPECT_EQ(get(*g), 3.0);
  EXPECT_OK(add(runtime, *kernel, 1.0));
  EXPECT_TRUE(runtime.gradients().clear());
  EXPECT_EQ(get(*g), 0.0);
}

// At each launch, a kernel that uses a gradient stores the zeros that the
// gradient still needs; other kernels do not.
TEST(RuntimePrepared, StoresTheZerosOfItsGradients) {
  Runtime runtime;
  FieldPtr y = makeField(runtime, "y", ScalarKind::F64, {});
  FieldPtr g = makeField(runtime, "g", ScalarKind::F64, {});
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {}, {}, "g");
  KernelPtr onY = makeAdding(runtime, y);
  KernelPtr onG = makeAdding(runtime, g);
  for (int round = 0; round < 3; ++round) {
    auto zeros = std::make_shared<OwedZeros>();
    zeros->boxes.push_back({{}, {}});
    runtime.gradients().owe(g, zeros);
    ASSERT_TRUE(g->owesZeros());
    for (int i = 0; i < 4; ++i)
      EXPECT_OK(add(runtime, *onY, 1.0));
    EXPECT_TRUE(g->owesZeros());
    EXPECT_OK(add(runtime, *onG, 2.0));
    EXPECT_FALSE(g->owesZeros());
    EXPECT_OK(add(runtime, *onG, 2.0));
    EXPECT_EQ(get(*g), 4.0);
  }
  EXPECT_EQ(get(*y), 15.0);
}

TEST(RuntimePrepared, IsProfiledWhenAsked) {
  Runtime runtime;
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {});
  KernelPtr kernel = makeAdding(runtime, x);
  EXPECT_TRUE(runtime.profile().empty());
  runtime.setProfiler(true);
  for (int i = 0; i < 5; ++i)
    EXPECT_OK(add(runtime, *kernel, 1.0));
  runtime.setProfiler(false);
  for (int i = 0; i < 7; ++i)
    EXPECT_OK(add(runtime, *kernel, 1.0));
  std::vector<ProfileRow> rows = runtime.profile();
  ASSERT_EQ(rows.size(), 1u);
  EXPECT_EQ(rows[0].times.launches, 5);
  EXPECT_EQ(get(*x), 15.0);
}

TEST(RuntimePrepared, IsRecordedByATape) {
  Runtime runtime;
  FieldPtr x = makeDifferentiable(runtime, "x", ScalarKind::F64, {});
  KernelPtr kernel = makeAdding(runtime, x);
  std::unique_ptr<Tape> tape;
  ASSERT_OK(runtime.beginTape(x, true, tape));
  EXPECT_OK(add(runtime, *kernel, 2.0));
  EXPECT_OK(add(runtime, *kernel, 3.0));
  tape->end();
  EXPECT_OK(add(runtime, *kernel, 100.0));
  EXPECT_EQ(runtime.counters().recorded, 2);
  EXPECT_OK(runtime.writes().fillF64(*x, 0.0));
  EXPECT_OK(tape->replay(true, false));
  EXPECT_EQ(get(*x), 5.0);
}

TEST(RuntimePrepared, CarriesTangentsInForwardMode) {
  Runtime runtime;
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {});
  FieldPtr dual = makeField(runtime, "dual", ScalarKind::F64, {});
  KernelInfo info;
  info.name = "add";
  info.function = addHere;
  info.argSlots = 1;
  info.trees = {runtime.store().findTree("x_tree")};
  info.summary = {{x, AccessKind::Accumulate}};
  provide(info).onMakeTangent = [&](KernelPtr &tangent) {
    tangent = makeKernel(runtime, "tangent", addHere,
                         {{dual, AccessKind::Accumulate}}, 1);
    return Status::success();
  };
  KernelPtr kernel = runtime.launcher().kernels().create(std::move(info));
  for (int i = 0; i < 3; ++i)
    EXPECT_OK(add(runtime, *kernel, 1.0));
  runtime.setForward(true);
  EXPECT_OK(add(runtime, *kernel, 1.0));
  runtime.setForward(false);
  EXPECT_OK(add(runtime, *kernel, 1.0));
  EXPECT_EQ(get(*x), 4.0);
  EXPECT_EQ(get(*dual), 1.0);
}

TEST(RuntimePrepared, CanBeInterrupted) {
  Runtime runtime;
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {});
  KernelPtr kernel = makeAdding(runtime, x);
  runtime.interrupt();
  EXPECT_EQ(add(runtime, *kernel, 1.0).code(), StatusCode::Interrupted);
  runtime.launcher().clearInterrupt();
  EXPECT_OK(add(runtime, *kernel, 1.0));
  EXPECT_EQ(get(*x), 4.0);
}

TEST(RuntimePrepared, CountsArgumentsAndWantsNoResults) {
  Runtime runtime;
  KernelInfo info;
  info.name = "k";
  info.argSlots = 1;
  info.resultSlots = 1;
  info.function = [](TaiFrame *frame) -> int32_t {
    frame->results[0] = frame->args[0] + 1;
    return 0;
  };
  KernelPtr kernel = runtime.launcher().kernels().create(std::move(info));
  uint64_t args[] = {41, 7}, result = 0;
  for (int i = 0; i < 3; ++i) {
    result = 0;
    EXPECT_OK(runtime.launch(*kernel, args, 1, &result));
    EXPECT_EQ(result, 42u);
    // A caller that needs no results passes no memory for them.
    EXPECT_OK(runtime.launch(*kernel, args, 1, nullptr));
    EXPECT_EQ(runtime.launch(*kernel, args, 2, &result).message(),
              "kernel 'k' takes 1 argument slots, but got 2");
  }
}

TEST(RuntimePrepared, ReportsFailures) {
  Runtime runtime;
  KernelInfo info;
  info.name = "k";
  info.argSlots = 1;
  info.function = [](TaiFrame *frame) -> int32_t {
    return frame->args[0] == 1;
  };
  KernelPtr kernel = runtime.launcher().kernels().create(std::move(info));
  for (uint64_t fails : {0, 0, 1, 0, 1})
    EXPECT_EQ(runtime.launch(*kernel, &fails, 1, nullptr).ok(), fails == 0);
}

// The random numbers of a launch depend on its seed and number.
TEST(RuntimePrepared, SeesTheSeedAndTheNumber) {
  Runtime runtime;
  static std::vector<std::pair<uint64_t, uint64_t>> seen;
  seen.clear();
  KernelPtr kernel = makeKernel(runtime, "k",
                                [](TaiFrame *frame) -> int32_t {
                                  seen.emplace_back(frame->seed, frame->launch);
                                  return 0;
                                },
                                {});
  for (uint64_t seed : {5, 6}) {
    runtime.setSeed(seed);
    for (int i = 0; i < 3; ++i)
      EXPECT_OK(runtime.launch(*kernel, nullptr, 0, nullptr));
  }
  std::vector<std::pair<uint64_t, uint64_t>> wanted = {{5, 0}, {5, 1}, {5, 2},
                                                       {6, 0}, {6, 1}, {6, 2}};
  EXPECT_EQ(seen, wanted);
}

// A kernel may launch other kernels; each launch has its own frame.
TEST(RuntimePrepared, NestsAndComesFromManyThreads) {
  Runtime runtime;
  static Kernel *inner;
  static std::atomic<int64_t> sum;
  sum = 0;
  KernelPtr adds = makeKernel(
      runtime, "adds",
      [](TaiFrame *frame) -> int32_t {
        sum += static_cast<int64_t>(frame->args[0]);
        return 0;
      },
      {}, 1);
  inner = adds.get();
  KernelPtr outer = makeKernel(
      runtime, "outer",
      [](TaiFrame *frame) -> int32_t {
        uint64_t before = frame->launch, one = 1;
        auto &owner = *static_cast<Runtime *>(frame->runtime);
        bool good = owner.launch(*inner, &one, 1, nullptr).ok();
        sum += static_cast<int64_t>(frame->args[0]);
        return !good || frame->launch != before;
      },
      {}, 1);
  auto launchMany = [&] {
    for (uint64_t i = 0; i < 2000; ++i)
      EXPECT_OK(runtime.launch(*outer, &i, 1, nullptr));
  };
  launchMany();
  std::vector<std::thread> threads;
  for (int i = 0; i < 3; ++i)
    threads.emplace_back(launchMany);
  launchMany();
  for (std::thread &thread : threads)
    thread.join();
  // New threads start after others have ended.
  for (int i = 0; i < 3; ++i)
    std::thread(launchMany).join();
  EXPECT_EQ(sum, 8 * (2000 + 2000 * 1999 / 2));
  EXPECT_EQ(runtime.counters().launches, 8 * 4000);
}

//===----------------------------------------------------------------------===//
// CUDA
//===----------------------------------------------------------------------===//

#ifdef TAI_FAKE_CUDA_LIBRARY
/// Scales the first n numbers of the first tree, on the device.
static int32_t scaleThere(TaiFrame *frame) {
  uint64_t slots[] = {reinterpret_cast<uint64_t>(frame->trees[0]),
                      frame->args[0], frame->args[1]};
  tai_rt_device_launch(frame, 0, int64_t(frame->args[0]), slots, 3);
  return tai_rt_failed(frame);
}

static std::shared_ptr<const DeviceImage> imageOf(const char *function) {
  DeviceImage image;
  image.kind = DeviceKind::Cuda;
  image.bytes = "// PTX";
  image.functions = {function};
  return std::make_shared<const DeviceImage>(std::move(image));
}

namespace {
class RuntimePreparedCuda : public ::testing::Test {
protected:
  void SetUp() override {
    setenv("TAI_CUDA_DRIVER", TAI_FAKE_CUDA_LIBRARY, 1);
    setenv("TAI_FAKE_CUDA", "", 1);
    runtime = std::make_unique<Runtime>();
    std::unique_ptr<Device> device;
    ASSERT_OK(openCudaDevice(0, device));
    ASSERT_OK(runtime->useDevice(std::move(device)));
    library = dlopen(TAI_FAKE_CUDA_LIBRARY, RTLD_NOW | RTLD_NOLOAD);
    ASSERT_TRUE(library);
    x = makeField(*runtime, "x", ScalarKind::F64, {4});
    kernel = makeKernel(*runtime, "k", scaleThere,
                        {{x, AccessKind::Read}, {x, AccessKind::Write}}, 2);
    kernel->setDeviceImage(imageOf("scale"));
    set(*x, {0}, 1.0);
    for (int i = 0; i < 3; ++i)
      EXPECT_OK(scale(2.0));
  }
  void TearDown() override {
    x.reset();
    kernel.reset();
    runtime.reset();
    for (const char *name : {"TAI_CUDA_DRIVER", "TAI_FAKE_CUDA"})
      unsetenv(name);
  }
  Status scale(double factor) {
    uint64_t args[] = {4, slotOf(factor)};
    return runtime->launch(*kernel, args, 2, nullptr);
  }
  /// The number of driver calls that `work` makes.
  template <typename Work> long long countCalls(Work work) {
    auto *calls =
        static_cast<long long *>(dlsym(library, "tai_fake_cuda_calls"));
    long long before = *calls;
    work();
    return *calls - before;
  }
  int countGraphs() {
    return *static_cast<int *>(dlsym(library, "tai_fake_cuda_graphs"));
  }
  void useContext(void *context) {
    using Set = int (*)(void *);
    reinterpret_cast<Set>(dlsym(library, "cuCtxSetCurrent"))(context);
  }

  void *library = nullptr;
  std::unique_ptr<Runtime> runtime;
  FieldPtr x;
  KernelPtr kernel;
};
} // namespace

TEST_F(RuntimePreparedCuda, CallsTheDriverOnceForEachLaunch) {
  auto launchOften = [&] {
    for (int i = 0; i < 100; ++i)
      EXPECT_OK(scale(1.0));
  };
  // One more call each to create a graph, to add the kernel and to instantiate
  // the graph.
  EXPECT_EQ(countCalls(launchOften), 100 + 3);
  EXPECT_EQ(countCalls(launchOften), 100);
  EXPECT_EQ(countGraphs(), 1);
  EXPECT_EQ(get(*x, {0}), 8.0);
}

// A changed parameter takes one more call.
TEST_F(RuntimePreparedCuda, ChangesParametersOfARepeatedLaunch) {
  for (int i = 0; i < 60; ++i)
    EXPECT_OK(scale(i % 2 ? 4.0 : 0.25));
  EXPECT_EQ(get(*x, {0}), 8.0);
  EXPECT_EQ(countGraphs(), 1);
  EXPECT_EQ(countCalls([&] { EXPECT_OK(scale(3.0)); }), 2);
  EXPECT_EQ(countCalls([&] { EXPECT_OK(scale(3.0)); }), 1);
  EXPECT_EQ(get(*x, {0}), 72.0);
  // A timed launch is between events, and otherwise the same.
  runtime->setProfiler(true);
  EXPECT_OK(scale(0.5));
  EXPECT_EQ(get(*x, {0}), 36.0);
  x.reset();
  kernel.reset();
  runtime.reset();
  EXPECT_EQ(countGraphs(), 0);
}

// Another thread, which has not used the device before, repeats a launch of a
// graph.
TEST_F(RuntimePreparedCuda, RepeatsALaunchInAnotherThread) {
  for (int i = 0; i < 60; ++i)
    EXPECT_OK(scale(1.0));
  std::thread([&] { EXPECT_OK(scale(3.0)); }).join();
  EXPECT_EQ(get(*x, {0}), 24.0);
}

TEST_F(RuntimePreparedCuda, LaunchesByItselfWhereThereAreNoGraphs) {
  for (const char *missing : {"no-graphs", "fixed-graphs"}) {
    TearDown();
    SetUp();
    setenv("TAI_FAKE_CUDA", missing, 1);
    for (int i = 0; i < 60; ++i)
      EXPECT_OK(scale(i % 2 ? 4.0 : 0.25));
    EXPECT_EQ(get(*x, {0}), 8.0);
    EXPECT_EQ(countGraphs(), 0);
    EXPECT_EQ(countCalls([&] { EXPECT_OK(scale(3.0)); }), 1);
    EXPECT_EQ(get(*x, {0}), 24.0);
  }
}

// A kernel may need more resources than the limits of its function say.
TEST_F(RuntimePreparedCuda, LaunchesSmallerBlocksWhereTheDeviceHasNoRoom) {
  constexpr int64_t n = 4096;
  FieldPtr many = makeField(*runtime, "many", ScalarKind::F64, {n});
  for (bool hasSize : {false, true}) {
    KernelPtr scaling =
        makeKernel(*runtime, hasSize ? "sized" : "any", scaleThere,
                   {{many, AccessKind::Read}, {many, AccessKind::Write}}, 2);
    DeviceImage image = *imageOf("scale");
    if (hasSize)
      image.blockSizes = {256};
    scaling->setDeviceImage(std::make_shared<const DeviceImage>(image));
    uint64_t args[] = {n, slotOf(2.0)};
    auto launch = [&] { return runtime->launch(*scaling, args, 2, nullptr); };
    EXPECT_OK(runtime->writes().fillF64(*many, 1.0));
    EXPECT_OK(launch());
    setenv("TAI_FAKE_CUDA", "small-blocks", 1);
    Status status = launch();
    auto *threads = static_cast<int *>(dlsym(library, "tai_fake_cuda_threads"));
    if (hasSize) {
      // A loop relies on the block size that it specifies.
      EXPECT_EQ(status.code(), StatusCode::Internal);
    } else {
      EXPECT_OK(status);
      EXPECT_EQ(*threads, 64);
    }
    setenv("TAI_FAKE_CUDA", "", 1);
    EXPECT_EQ(get(*many, {n - 1}), hasSize ? 2.0 : 4.0);
  }
}

// Profiled launches are between events.
TEST_F(RuntimePreparedCuda, CallsItOnceAgainWithoutTheProfiler) {
  auto launch = [&] { EXPECT_OK(scale(2.0)); };
  runtime->setProfiler(true);
  EXPECT_GT(countCalls(launch), 1);
  EXPECT_EQ(runtime->profile().size(), 1u);
  runtime->setProfiler(false);
  launch();
  EXPECT_EQ(countCalls(launch), 1);
  for (const ProfileRow &row : runtime->profile())
    EXPECT_EQ(row.times.launches, 1);
  EXPECT_EQ(get(*x, {0}), 64.0);
}

// Another library has made its context current in the thread, or the thread has
// no context yet.
TEST_F(RuntimePreparedCuda, LaunchesFromThreadsWithOtherContexts) {
  int other;
  for (void *context :
       {static_cast<void *>(&other), static_cast<void *>(nullptr)}) {
    useContext(context);
    EXPECT_OK(scale(2.0));
    EXPECT_EQ(countCalls([&] { EXPECT_OK(scale(2.0)); }), 1);
  }
  std::thread([&] { EXPECT_OK(scale(2.0)); }).join();
  EXPECT_EQ(get(*x, {0}), 256.0);
}

TEST_F(RuntimePreparedCuda, SeesWhatTheHostWrites) {
  EXPECT_EQ(get(*x, {0}), 8.0);
  EXPECT_OK(scale(2.0));
  double values[] = {5.0, 6.0, 7.0, 8.0};
  EXPECT_OK(runtime->writes().copyIn(*x, values));
  EXPECT_OK(scale(2.0));
  EXPECT_EQ(get(*x, {3}), 16.0);
  // Write the element often enough that the host gets the current values of the
  // whole field.
  for (int i = 0; i < 200; ++i)
    set(*x, {1}, double(i));
  EXPECT_OK(scale(2.0));
  EXPECT_EQ(get(*x, {1}), 398.0);
  EXPECT_OK(runtime->writes().fillF64(*x, 3.0));
  EXPECT_OK(scale(2.0));
  EXPECT_EQ(get(*x, {2}), 6.0);
}

TEST_F(RuntimePreparedCuda, IsCollectedWithASequence) {
  DeviceQueue &queue = *runtime->devices().queue();
  queue.beginCollecting();
  EXPECT_EQ(countCalls([&] { EXPECT_OK(scale(2.0)); }), 0);
  EXPECT_EQ(countCalls([&] { EXPECT_OK(queue.endCollecting()); }), 1);
  EXPECT_EQ(countCalls([&] { EXPECT_OK(scale(2.0)); }), 1);
  EXPECT_EQ(get(*x, {0}), 32.0);
}

TEST_F(RuntimePreparedCuda, IsRecordedByATape) {
  std::unique_ptr<Tape> tape;
  ASSERT_OK(runtime->beginTape(nullptr, true, tape));
  EXPECT_OK(scale(3.0));
  tape->end();
  EXPECT_OK(scale(2.0));
  EXPECT_EQ(runtime->counters().recorded, 1);
  EXPECT_OK(runtime->writes().fillF64(*x, 1.0));
  EXPECT_OK(tape->replay(true, false));
  EXPECT_EQ(get(*x, {0}), 3.0);
}

TEST_F(RuntimePreparedCuda, FailsWhenATreeIsGone) {
  EXPECT_OK(runtime->destroyTree("x_tree"));
  EXPECT_EQ(countCalls([&] {
              EXPECT_EQ(
                  scale(2.0).message(),
                  "kernel 'k' uses tree 'x_tree', which has been destroyed");
            }),
            0);
}

// The code of a kernel may change, for example for another block size.
TEST_F(RuntimePreparedCuda, TakesOtherCode) {
  runtime->setBlockThreads(64);
  kernel->setDeviceImage(imageOf("where"));
  uint64_t args[] = {1000, 0};
  EXPECT_OK(runtime->launch(*kernel, args, 2, nullptr));
  EXPECT_OK(runtime->launch(*kernel, args, 2, nullptr));
  int32_t found[8];
  EXPECT_OK(runtime->copies().copyOut(*x, found));
  EXPECT_EQ(found[0], 16);
  EXPECT_EQ(found[1], 64);
}

// The next launch reports an error that an earlier call could not report.
TEST_F(RuntimePreparedCuda, ReportsWhatHasFailedBefore) {
  EXPECT_OK(scale(2.0));
  setenv("TAI_FAKE_CUDA", "fault", 1);
  EXPECT_OK(scale(2.0));
  double values[4];
  (void)runtime->copies().copyOut(*x, values);
  setenv("TAI_FAKE_CUDA", "", 1);
  EXPECT_NE(runtime->synchronize().message().find("illegal memory access"),
            std::string::npos);
}
#endif // TAI_FAKE_CUDA_LIBRARY
