//===- ForkTest.cpp - Forked children -------------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A child process has none of the threads of its parent, and must not wait for
// these.
//
//===----------------------------------------------------------------------===//

#include "../../Utils/RuntimeTestUtils.h"
#include <sys/wait.h>
#include <unistd.h>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

#ifdef TAI_TEST_THREAD_SANITIZER
// The thread sanitizer refuses threads in a forked child, unless told
// otherwise.
extern "C" const char *__tsan_default_options() { return "die_after_fork=0"; }
#endif

namespace {
int32_t sumInParallel(TaiFrame *frame) {
  std::atomic<int64_t> sum{0};
  tai_rt_parallel_for(
      frame,
      [](TaiFrame *, void *closure, int64_t begin, int64_t end, int64_t) {
        for (int64_t i = begin; i < end; ++i)
          *static_cast<std::atomic<int64_t> *>(closure) += i;
      },
      &sum, 1000, 64);
  return sum == 499500 ? 0 : 1;
}

/// Runs `work` in a child with a time limit; true if it returned true.
template <typename Work> bool inChild(const Work &work) {
  pid_t child = fork();
  if (child == 0) {
    alarm(200);
    _exit(work() ? 0 : 1);
  }
  int status = 0;
  return child > 0 && waitpid(child, &status, 0) == child &&
         WIFEXITED(status) && WEXITSTATUS(status) == 0;
}
} // namespace

TEST(RuntimeFork, ChildrenLaunch) {
  Options options;
  options.threads = 4;
  Runtime runtime(options);
  FieldPtr x = makeField(runtime, "x", ScalarKind::F32, {100});
  auto kernel = makeKernel(runtime, "k", sumInParallel, {});
  for (int i = 0; i < 10; ++i)
    ASSERT_OK(runtime.launch(*kernel, nullptr, 0, nullptr));
  set(*x, {3}, 7);
  auto launches = [&] {
    for (int i = 0; i < 100; ++i)
      if (!runtime.launch(*kernel, nullptr, 0, nullptr).ok())
        return false;
    return get(*x, {3}) == 7;
  };
  for (int i = 0; i < 10; ++i) {
    EXPECT_TRUE(inChild(launches));
    // The parent works as before.
    EXPECT_TRUE(launches());
  }
  // Children of children can launch, too.
  EXPECT_TRUE(inChild([&] { return launches() && inChild(launches); }));
}

TEST(RuntimeFork, ChildrenEndWithoutLaunching) {
  auto runtime = std::make_unique<Runtime>();
  auto kernel = makeKernel(*runtime, "k", sumInParallel, {});
  ASSERT_OK(runtime->launch(*kernel, nullptr, 0, nullptr));
  EXPECT_TRUE(inChild([&] {
    runtime.reset();
    return true;
  }));
  EXPECT_TRUE(inChild([&] {
    runtime->setThreads(3);
    bool good = runtime->launch(*kernel, nullptr, 0, nullptr).ok();
    runtime.reset();
    return good;
  }));
  EXPECT_OK(runtime->launch(*kernel, nullptr, 0, nullptr));
}
