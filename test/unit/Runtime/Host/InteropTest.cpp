//===- InteropTest.cpp - Queues and memory of other libraries -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "../../Utils/RuntimeTestUtils.h"
#include "tai/Runtime/Device/Device.h"
#include <cstdlib>
#include <cstring>
#include <dlfcn.h>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

static Status exportField(Runtime &runtime, Field &field,
                          ExportedField &exported) {
  return runtime.exportField(field, exported);
}

TEST(RuntimeInterop, LendsFieldsByTheirStrides) {
  Runtime runtime;
  FieldPtr x = makeField(runtime, "x", ScalarKind::F32, {3, 4}, {2});
  ExportedField exported;
  ASSERT_OK(exportField(runtime, *x, exported));
  EXPECT_FALSE(exported.onDevice);
  EXPECT_EQ(exported.strides, (std::vector<int64_t>{32, 8, 4}));
  static_cast<float *>(exported.address)[2 * 8 + 1 * 2 + 1] = 5;
  EXPECT_EQ(get(*x, {2, 1}, 1), 5.0);
  // The owner of an exported address may have written to the memory.
  EXPECT_TRUE(x->dirty());
  // The memory outlives the tree.
  EXPECT_OK(runtime.destroyTree("x_tree"));
  EXPECT_EQ(static_cast<float *>(exported.address)[2 * 8 + 1 * 2 + 1], 5);
  ExportedField again;
  EXPECT_EQ(exportField(runtime, *x, again).message(),
            "field 'x' cannot be shared: its tree has been destroyed");
}

TEST(RuntimeInterop, GivesBackWhatWasLent) {
  Runtime runtime;
  FieldPtr x = makeField(runtime, "x", ScalarKind::F32, {3});
  {
    ExportedField exported;
    ASSERT_OK(exportField(runtime, *x, exported));
    EXPECT_TRUE(x->dirty());
  }
  EXPECT_FALSE(x->dirty());
}

TEST(RuntimeInterop, RefusesWhatHasNoStrides) {
  Runtime runtime;
  FieldInfo info;
  info.name = "blocked";
  ASSERT_OK(runtime.store().addTree("t", 16 * 4, info.tree));
  info.layout = rowMajor(ScalarKind::F32, {16});
  // Interleaved blocks of four elements.
  info.layout.indices[0] = {{4, 4, 4}, {1, 4, 16}};
  FieldPtr field;
  ASSERT_OK(runtime.store().addField(std::move(info), field));
  ExportedField exported;
  EXPECT_NE(exportField(runtime, *field, exported).message().find("in blocks"),
            std::string::npos);
}

#ifdef TAI_FAKE_CUDA_LIBRARY
TEST(RuntimeInterop, PutsStreamsInOrder) {
  setenv("TAI_CUDA_DRIVER", TAI_FAKE_CUDA_LIBRARY, 1);
  setenv("TAI_FAKE_CUDA", "", 1);
  {
    Runtime runtime;
    std::unique_ptr<Device> device;
    ASSERT_OK(openCudaDevice(0, device));
    ASSERT_OK(runtime.useDevice(std::move(device)));
    void *library = dlopen(TAI_FAKE_CUDA_LIBRARY, RTLD_NOW | RTLD_NOLOAD);
    auto *waits =
        static_cast<const char *>(dlsym(library, "tai_fake_cuda_waits"));
    auto events = [&] {
      return *static_cast<int *>(dlsym(library, "tai_fake_cuda_events"));
    };
    int before = events();
    waits += std::strlen(waits);
    // The runtime's stream is s. Work in the default stream, whose handle is 1
    // or 0, is ordered anyway; one event suffices for all other streams.
    EXPECT_OK(runtime.devices().waitForStream(3));
    EXPECT_OK(runtime.devices().letStreamWait(4));
    EXPECT_OK(runtime.devices().waitForStream(0));
    EXPECT_OK(runtime.devices().letStreamWait(1));
    EXPECT_OK(runtime.devices().waitForStream(2));
    EXPECT_STREQ(waits, "3>s s>4 2>s ");
    EXPECT_EQ(events(), before + 1);
    // Device memory remains while it is exported, even without the tree.
    FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {100});
    set(*x, {7}, 2.5);
    ExportedField exported;
    ASSERT_OK(exportField(runtime, *x, exported));
    EXPECT_TRUE(exported.onDevice);
    auto *there = static_cast<double *>(exported.address);
    EXPECT_EQ(there[7], 2.5);
    there[7] = 3.5;
    EXPECT_EQ(get(*x, {7}), 3.5);
    set(*x, {8}, 4.5);
    EXPECT_EQ(there[8], 4.5);
    EXPECT_OK(runtime.destroyTree("x_tree"));
    EXPECT_EQ(there[7], 3.5);
    EXPECT_GE(runtime.devices().device()->allocatedBytes(), 800);
    exported.buffer.reset();
    EXPECT_LT(runtime.devices().device()->allocatedBytes(), 800);
  }
  unsetenv("TAI_CUDA_DRIVER");
  unsetenv("TAI_FAKE_CUDA");
}
#endif // TAI_FAKE_CUDA_LIBRARY
