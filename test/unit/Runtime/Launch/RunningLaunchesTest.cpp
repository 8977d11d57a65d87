//===- RunningLaunchesTest.cpp - Kernels that run in other threads --------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Memory that a running kernel uses is not freed, and its changes are not part
// of a tape that another thread begins meanwhile.
//
//===----------------------------------------------------------------------===//

#include "../../Utils/RuntimeTestUtils.h"
#include "tai/Runtime/Tape/Tape.h"
#include <sys/wait.h>
#include <thread>
#include <unistd.h>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

namespace {
struct Gate {
  std::atomic<bool> isReached{false}, isOpen{false};
  void pass() {
    isReached = true;
    while (!isOpen)
      std::this_thread::yield();
  }
  void waitForOther() {
    while (!isReached)
      std::this_thread::yield();
  }
};

/// x[0] = 1, once the gate that is its argument opens.
int32_t storeAtGate(TaiFrame *frame) {
  reinterpret_cast<Gate *>(frame->args[0])->pass();
  *static_cast<double *>(frame->trees[0]) = 1;
  return 0;
}

int32_t nothing(TaiFrame *) { return 0; }

struct Scene {
  Runtime runtime;
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {4});
  FieldPtr y = makeField(runtime, "y", ScalarKind::F64, {4});
  FieldPtr loss = makeDifferentiable(runtime, "loss", ScalarKind::F64, {});
  KernelPtr store =
      makeKernel(runtime, "store", storeAtGate, {{x, AccessKind::Write}}, 1);
  KernelPtr read =
      makeKernel(runtime, "read", nothing, {{x, AccessKind::Read}});

  /// Runs `meanwhile` while another thread is in `store`.
  template <typename Do> void whileStoring(const Do &meanwhile) {
    Gate gate;
    uint64_t arg = reinterpret_cast<uint64_t>(&gate);
    std::thread other(
        [&] { EXPECT_OK(runtime.launch(*store, &arg, 1, nullptr)); });
    gate.waitForOther();
    meanwhile();
    gate.isOpen = true;
    other.join();
  }

  /// Reads x under a tape of this thread.
  Status readUnderTape() {
    std::unique_ptr<Tape> tape;
    Status status = runtime.beginTape(loss, /*clearGradients=*/true, tape);
    if (status)
      status = runtime.launch(*read, nullptr, 0, nullptr);
    return status;
  }
};
} // namespace

TEST(RuntimeRunning, TreesInUseStay) {
  Scene scene;
  // The second launch takes the short path.
  for (int i = 0; i < 2; ++i)
    scene.whileStoring([&] {
      Status status = scene.runtime.destroyTree("x_tree");
      EXPECT_EQ(status.message(),
                "the tree of field 'x' cannot be destroyed while another "
                "thread runs kernel 'store', which uses it: wait until the "
                "kernel has returned");
      EXPECT_TRUE(scene.x->valid());
      // Trees that the kernel does not use can be destroyed.
      if (i == 1)
        EXPECT_OK(scene.runtime.destroyTree("y_tree"));
    });
  EXPECT_EQ(get(*scene.x, {0}), 1);
  EXPECT_OK(scene.runtime.destroyTree("x_tree"));
  uint64_t arg = 0;
  EXPECT_FALSE(scene.runtime.launch(*scene.store, &arg, 1, nullptr).ok());
}

TEST(RuntimeRunning, OwnTreesStay) {
  Scene scene;
  KernelPtr destroys = makeKernel(
      scene.runtime, "destroys",
      [](TaiFrame *frame) {
        auto &runtime = *static_cast<Runtime *>(frame->runtime);
        EXPECT_NE(runtime.destroyTree("x_tree").message().find("this thread"),
                  std::string::npos);
        EXPECT_OK(runtime.destroyTree("y_tree"));
        return 0;
      },
      {{scene.x, AccessKind::Read}});
  EXPECT_OK(scene.runtime.launch(*destroys, nullptr, 0, nullptr));
  EXPECT_OK(scene.runtime.destroyTree("x_tree"));
}

TEST(RuntimeRunning, TapesKnowOfEarlierLaunches) {
  Scene scene;
  for (int i = 0; i < 2; ++i)
    scene.whileStoring([&] {
      EXPECT_EQ(scene.readUnderTape().message(),
                "another thread runs kernel 'store', which changes field 'x', "
                "while a tape of this thread reads it: give each thread fields "
                "of its own, or wait until the kernel has returned");
    });
  EXPECT_OK(scene.readUnderTape());
}

TEST(RuntimeRunning, ReadersDoNotMind) {
  Scene scene;
  Gate gate;
  uint64_t arg = reinterpret_cast<uint64_t>(&gate);
  KernelPtr look = makeKernel(
      scene.runtime, "look",
      [](TaiFrame *frame) {
        reinterpret_cast<Gate *>(frame->args[0])->pass();
        return 0;
      },
      {{scene.x, AccessKind::Read}}, 1);
  std::thread other(
      [&] { EXPECT_OK(scene.runtime.launch(*look, &arg, 1, nullptr)); });
  gate.waitForOther();
  EXPECT_OK(scene.readUnderTape());
  gate.isOpen = true;
  other.join();
}

// The launch began before the tape, and its kernel is compiled after the tape
// has used the field.
TEST(RuntimeRunning, CompilationIsPartOfALaunch) {
  Scene scene;
  Gate gate;
  KernelInfo info;
  info.name = "late";
  provide(info).onCompile = [&](Kernel &kernel, TaiKernelFn &function) {
    gate.pass();
    kernel.setTrees({scene.runtime.store().findTree("x_tree")});
    kernel.setSummary({{scene.x, AccessKind::Write}});
    function = nothing;
    return Status::success();
  };
  KernelPtr late = scene.runtime.launcher().kernels().create(info);
  Status status;
  std::thread other(
      [&] { status = scene.runtime.launch(*late, nullptr, 0, nullptr); });
  gate.waitForOther();
  std::unique_ptr<Tape> tape;
  EXPECT_OK(scene.runtime.beginTape(scene.loss, /*clearGradients=*/true, tape));
  EXPECT_OK(scene.runtime.launch(*scene.read, nullptr, 0, nullptr));
  gate.isOpen = true;
  other.join();
  EXPECT_NE(status.message().find("another thread records a tape that reads "
                                  "field 'x', which this thread changes"),
            std::string::npos)
      << status.message();
  tape->end();
}

// In a forked child, the thread that runs the kernel does not exist.
TEST(RuntimeRunning, ChildrenFreeWhatTheirParentUses) {
  Scene scene;
  scene.whileStoring([&] {
    pid_t child = fork();
    if (child == 0) {
      alarm(200);
      _exit(scene.runtime.destroyTree("x_tree").ok() ? 0 : 1);
    }
    int status = 1;
    EXPECT_EQ(waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  });
}

// A device that is opened later has launches of its own.
TEST(RuntimeRunning, LaunchesThatAreDroppedAreForgotten) {
  Scene scene;
  EXPECT_OK(scene.runtime.launch(*scene.read, nullptr, 0, nullptr));
  std::thread([&] {
    EXPECT_TRUE(scene.runtime.launcher().running().areAny());
  }).join();
  scene.runtime.launcher().dropLaunches();
  std::thread([&] {
    EXPECT_FALSE(scene.runtime.launcher().running().areAny());
  }).join();
  EXPECT_OK(scene.runtime.destroyTree("x_tree"));
}

// Several threads launch one kernel, also on the short path, while trees are
// created and destroyed.
TEST(RuntimeRunning, TreesComeAndGo) {
  Scene scene;
  std::atomic<bool> isOver{false};
  KernelPtr kernel = makeKernel(
      scene.runtime, "count",
      [](TaiFrame *frame) {
        static_cast<double *>(frame->trees[0])[frame->args[0]] += 1;
        return 0;
      },
      {{scene.x, AccessKind::Write},
       {scene.runtime.store().findField("loss_grad"), AccessKind::Accumulate}},
      1);
  std::vector<std::thread> threads;
  for (int t = 0; t < 3; ++t)
    threads.emplace_back([&, t] {
      uint64_t arg = static_cast<uint64_t>(t);
      int64_t count = 0;
      for (; !isOver || count < 100; ++count)
        if (Status status = scene.runtime.launch(*kernel, &arg, 1, nullptr);
            !status) {
          ADD_FAILURE() << status.message();
          return;
        }
      EXPECT_EQ(get(*scene.x, {t}), double(count));
    });
  for (int i = 0; i < 200; ++i) {
    makeField(scene.runtime, "other", ScalarKind::F64, {4});
    EXPECT_OK(scene.runtime.destroyTree("other_tree"));
  }
  isOver = true;
  for (std::thread &thread : threads)
    thread.join();
}
