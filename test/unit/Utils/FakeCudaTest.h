//===- FakeCudaTest.h - Tests with the fake CUDA driver ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A queue on top of a fake CUDA driver, which counts calls and executes them on
// the CPU.
//
//===----------------------------------------------------------------------===//

#ifndef TEST_UNIT_RUNTIME_FAKECUDATEST_H
#define TEST_UNIT_RUNTIME_FAKECUDATEST_H

#include "RuntimeTestUtils.h"
#include "tai/Runtime/Queue/DeviceQueue.h"
#include <cstdlib>
#include <cstring>
#include <dlfcn.h>

#ifdef TAI_FAKE_CUDA_LIBRARY

namespace mlir::tai::runtime::test {

class FakeCudaTest : public ::testing::Test {
protected:
  static constexpr int64_t n = 8;

  void TearDown() override {
    close();
    for (const char *name :
         {"TAI_CUDA_DRIVER", "TAI_FAKE_CUDA", "TAI_KEEP_LAUNCHES_US",
          "TAI_COLLECT_RECORDINGS", "TAI_FILLS_TOGETHER_BYTES"})
      unsetenv(name);
  }
  /// Opens a queue. `words` are options of the fake driver (TAI_FAKE_CUDA).
  void openQueue(const char *words) {
    close();
    setenv("TAI_CUDA_DRIVER", TAI_FAKE_CUDA_LIBRARY, 1);
    setenv("TAI_FAKE_CUDA", words, 1);
    std::unique_ptr<Device> device;
    ASSERT_OK(openCudaDevice(0, device));
    queue = std::make_unique<DeviceQueue>(std::move(device));
    library = dlopen(TAI_FAKE_CUDA_LIBRARY, RTLD_NOW | RTLD_NOLOAD);
    ASSERT_NE(library, nullptr);
  }
  void close() {
    module.reset();
    queue.reset();
    if (library)
      dlclose(library);
    library = nullptr;
  }
  int counter(const char *name) {
    std::string symbol = std::string("tai_fake_cuda_") + name;
    return *static_cast<int *>(dlsym(library, symbol.c_str()));
  }

  std::unique_ptr<DeviceQueue> queue;
  std::unique_ptr<DeviceModule> module;
  void *library = nullptr;
};

/// Two device functions that do not commute, and the expected result of running
/// them one after another.
class FakeCudaSteps : public FakeCudaTest {
protected:
  void openSteps(const char *words) {
    ASSERT_NO_FATAL_FAILURE(openQueue(words));
    ASSERT_OK(queue->load(image(), module));
    ASSERT_OK(queue->find(*module, "scale", scale));
    ASSERT_OK(queue->find(*module, "add", add));
    for (DevicePtr *memory : {&x, &y}) {
      ASSERT_OK(queue->allocate(n * 8, *memory));
      double zero = 0;
      ASSERT_OK(queue->fill(*memory, &zero, 8, n));
    }
    ASSERT_OK(queue->synchronize());
    expected = 0;
  }
  static DeviceImage image() {
    return DeviceImage{DeviceKind::Cuda, "//", {"scale", "add"}, {}, nullptr};
  }
  int submissions() { return counter("submissions"); }

  void apply(DeviceFunction *function, double value) {
    uint64_t slots[] = {x, n, 0};
    std::memcpy(&slots[2], &value, 8);
    LaunchShape shape;
    shape.threads = 32;
    EXPECT_OK(queue->launch(*function, shape, slots, 3));
    expected = function == scale ? expected * value : expected + value;
  }
  double read() {
    double value = 0;
    EXPECT_OK(queue->copyOut(&value, x, 8));
    return value;
  }
  void expectAsOneByOne() { EXPECT_EQ(read(), expected); }

  DeviceFunction *scale = nullptr, *add = nullptr;
  DevicePtr x = 0, y = 0;
  double expected = 0;
};

} // namespace mlir::tai::runtime::test

#endif // TAI_FAKE_CUDA_LIBRARY

#endif // TEST_UNIT_RUNTIME_FAKECUDATEST_H
