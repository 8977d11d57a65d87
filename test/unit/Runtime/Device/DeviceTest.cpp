//===- DeviceTest.cpp - Kernels on devices --------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Launches on the emulated device with hand-written device functions instead of
// compiled ones, and on the CUDA device with a driver that needs no GPU.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Device/Device.h"
#include "../../Utils/RuntimeTestUtils.h"
#include "tai/Runtime/Device/DeviceHeap.h"
#include "tai/Runtime/Device/DeviceReport.h"
#include <cstdlib>
#include <cstring>
#include <numeric>
#include <unistd.h>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

//===----------------------------------------------------------------------===//
// Device functions
//===----------------------------------------------------------------------===//

template <typename T> static T slot(uint64_t bits) {
  T value;
  std::memcpy(&value, &bits, sizeof(value));
  return value;
}

/// x[i] += i + 1, for i < n.
static void addIndex(const uint64_t *slots) {
  auto *x = slot<double *>(slots[0]);
  auto n = slot<int64_t>(slots[1]);
  for (int64_t i =
           tai_emu_block_id() * tai_emu_block_dim() + tai_emu_thread_id();
       i < n; i += int64_t(tai_emu_grid_dim()) * tai_emu_block_dim())
    x[i] += double(i + 1);
}

/// sum += the n numbers at x; run by one thread.
static void sum(const uint64_t *slots) {
  auto *x = slot<double *>(slots[0]);
  auto *result = slot<double *>(slots[2]);
  for (int64_t i = 0; i < slot<int64_t>(slots[1]); ++i)
    *result += x[i];
}

/// Each thread counts its runs in its own element.
static void countThreads(const uint64_t *slots) {
  auto *counts = slot<int32_t *>(slots[0]);
  ++counts[tai_emu_block_id()];
  counts[8] = tai_emu_grid_dim();
}

/// Stores a failure in the device state.
static void failOnDevice(const uint64_t *slots) {
  auto *state = slot<TaiDeviceState *>(slots[0]);
  state->failed = 1;
  auto *record = reinterpret_cast<TaiDeviceRecord *>(state->failure);
  std::memset(record, 0, sizeof(*record));
  record->kind = TAI_FAIL_ASSERT;
  std::memcpy(record + 1, "it broke\0a.py:3:4", 18);
  record->textBytes = 8;
  record->whereBytes = 8;
  record->bytes = sizeof(*record) + 24;
}

static Status linkHere(std::string_view, const std::vector<std::string> &names,
                       std::vector<void *> &addresses,
                       std::shared_ptr<void> &) {
  for (const std::string &name : names)
    addresses.push_back(
        name == "addIndex.slots"       ? reinterpret_cast<void *>(&addIndex)
        : name == "sum.slots"          ? reinterpret_cast<void *>(&sum)
        : name == "countThreads.slots" ? reinterpret_cast<void *>(&countThreads)
        : name == "failOnDevice.slots" ? reinterpret_cast<void *>(&failOnDevice)
                                       : nullptr);
  return Status::success();
}

static std::shared_ptr<const DeviceImage>
imageOf(std::vector<std::string> functions,
        DeviceKind kind = DeviceKind::Emulated, std::string text = "") {
  return std::make_shared<const DeviceImage>(
      DeviceImage{kind, std::move(text), std::move(functions), {}, nullptr});
}

static KernelPtr onDevice(Runtime &runtime, std::string name,
                          TaiKernelFn function,
                          std::shared_ptr<const DeviceImage> image,
                          std::vector<Access> summary, int64_t argSlots = 0) {
  KernelPtr kernel = makeKernel(runtime, std::move(name), function,
                                std::move(summary), argSlots);
  kernel->setDeviceImage(std::move(image));
  return kernel;
}

/// The host part of a kernel: x[i] += i + 1 for all elements of the first tree;
/// the first argument is their number.
static int32_t addIndexHost(TaiFrame *frame) {
  uint64_t slots[] = {reinterpret_cast<uint64_t>(frame->trees[0]),
                      frame->args[0]};
  tai_rt_device_launch(frame, 0, int64_t(frame->args[0]), slots, 2);
  return tai_rt_failed(frame);
}

namespace {
class RuntimeDevice : public ::testing::Test {
protected:
  void SetUp() override {
    ASSERT_OK(runtime.useDevice(openEmulatedDevice(linkHere)));
  }
  KernelPtr addIndexKernel(const FieldPtr &x) {
    return onDevice(runtime, "add_index", addIndexHost, imageOf({"addIndex"}),
                    {{x, AccessKind::Read}, {x, AccessKind::Write}}, 1);
  }
  Status launch(Kernel &kernel, std::vector<uint64_t> args,
                uint64_t *results = nullptr) {
    return runtime.launch(kernel, args.data(), int64_t(args.size()), results);
  }
  Runtime runtime;
};
} // namespace

//===----------------------------------------------------------------------===//
// The emulated device
//===----------------------------------------------------------------------===//

TEST_F(RuntimeDevice, RunsKernelsAndMirrorsTrees) {
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {1000});
  set(*x, {7}, 0.5);
  KernelPtr kernel = addIndexKernel(x);
  EXPECT_OK(launch(*kernel, {1000}));
  EXPECT_EQ(get(*x, {7}), 8.5);
  // Write between launches, on the host and on the device.
  set(*x, {7}, 1.0);
  EXPECT_OK(launch(*kernel, {1000}));
  EXPECT_EQ(get(*x, {7}), 9.0);
  EXPECT_EQ(get(*x, {999}), 2000.0);
  std::vector<double> values(1000);
  EXPECT_OK(runtime.writes().fillF64(*x, 2.0));
  EXPECT_OK(launch(*kernel, {1000}));
  EXPECT_OK(runtime.copies().copyOut(*x, values.data()));
  for (int i = 0; i < 1000; ++i)
    ASSERT_EQ(values[i], 3.0 + i);
  std::iota(values.begin(), values.end(), 100.0);
  EXPECT_OK(runtime.writes().copyIn(*x, values.data()));
  EXPECT_OK(launch(*kernel, {10}));
  EXPECT_EQ(get(*x, {3}), 107.0);
  EXPECT_EQ(get(*x, {30}), 130.0);
}

// A tree of more than a megabyte, so that elements are copied one by one.
TEST_F(RuntimeDevice, CopiesSingleElementsOfLargeTrees) {
  constexpr int64_t n = 1 << 20;
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {n});
  KernelPtr kernel = addIndexKernel(x);
  EXPECT_OK(launch(*kernel, {n}));
  for (int64_t i = 0; i < 500; ++i)
    ASSERT_EQ(get(*x, {i * 7}), double(i * 7 + 1));
  EXPECT_OK(launch(*kernel, {n}));
  for (int64_t i = 0; i < 500; ++i)
    set(*x, {i * 7}, 5.0);
  EXPECT_EQ(get(*x, {7}), 5.0);
  EXPECT_EQ(get(*x, {8}), 18.0);
  EXPECT_OK(launch(*kernel, {n}));
  for (int64_t i = 0; i < 500; ++i)
    ASSERT_EQ(get(*x, {i * 7}), double(5 + i * 7 + 1));
  EXPECT_EQ(get(*x, {n - 1}), 3.0 * n);
}

/// Two fields that share the cells of a tree, so that the elements of each are
/// evenly spaced.
static void makeShared(Runtime &runtime, ScalarKind scalar, int64_t n,
                       FieldPtr &a, FieldPtr &b) {
  TreePtr tree;
  int64_t bytes = byteSize(scalar);
  ASSERT_OK(runtime.store().addTree("t", 2 * bytes * n, tree));
  for (FieldPtr *field : {&a, &b}) {
    FieldInfo info;
    info.name = field == &a ? "a" : "b";
    info.tree = tree;
    info.layout = rowMajor(scalar, {n});
    info.layout.placeOffset = field == &a ? 0 : bytes;
    info.layout.indices[0][0].stride = 2 * bytes;
    ASSERT_OK(runtime.store().addField(std::move(info), *field));
  }
}

TEST_F(RuntimeDevice, HandlesFieldsThatShareTheirCells) {
  FieldPtr a, b;
  makeShared(runtime, ScalarKind::F64, 100, a, b);
  KernelPtr kernel = addIndexKernel(a);
  EXPECT_OK(launch(*kernel, {200}));
  EXPECT_OK(runtime.writes().fillF64(*b, 0.5));
  std::vector<double> values(100);
  EXPECT_OK(runtime.copies().copyOut(*a, values.data()));
  EXPECT_EQ(values[10], 21.0);
  EXPECT_EQ(get(*b, {10}), 0.5);
  EXPECT_OK(launch(*kernel, {200}));
  EXPECT_OK(runtime.copies().copyOut(*b, values.data()));
  EXPECT_EQ(values[10], 22.5);
  values[11] = 7;
  EXPECT_OK(launch(*kernel, {10}));
  EXPECT_OK(runtime.writes().copyIn(*b, values.data()));
  EXPECT_EQ(get(*b, {11}), 7.0);
  EXPECT_EQ(get(*a, {11}), 46.0);
}

TEST_F(RuntimeDevice, RunsAGridOfSeveralBlocks) {
  FieldPtr counts = makeField(runtime, "counts", ScalarKind::I32, {16});
  auto host = [](TaiFrame *frame) -> int32_t {
    uint64_t slots[] = {reinterpret_cast<uint64_t>(frame->trees[0])};
    tai_rt_device_launch(frame, 0, int64_t(frame->args[0]), slots, 1);
    return tai_rt_failed(frame);
  };
  KernelPtr kernel = onDevice(runtime, "count", host, imageOf({"countThreads"}),
                              {{counts, AccessKind::Write}}, 1);
  auto check = [&](int64_t n, int blocks) {
    EXPECT_OK(runtime.writes().fillI64(*counts, 0));
    EXPECT_OK(launch(*kernel, {uint64_t(n)}));
    for (int i = 0; i < 8; ++i)
      EXPECT_EQ(get(*counts, {i}), i < blocks ? 1 : 0) << n;
    EXPECT_EQ(get(*counts, {8}), blocks);
  };
  check(1, 1);
  check(3, 3);
  check(1000, 4);
  check(-1, 4);
  check(0, 0);
}

TEST_F(RuntimeDevice, HandsValuesOnThroughScratchMemory) {
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {100});
  auto host = [](TaiFrame *frame) -> int32_t {
    void *total = tai_rt_device_scratch(frame, 8);
    void *other = tai_rt_device_scratch(frame, int64_t(frame->args[1]));
    uint64_t slots[] = {reinterpret_cast<uint64_t>(frame->trees[0]),
                        frame->args[0], reinterpret_cast<uint64_t>(total)};
    tai_rt_device_launch(frame, 0, 100, slots, 2);
    tai_rt_device_launch(frame, 1, 1, slots, 3);
    tai_rt_device_fetch(frame, frame->results, total, 8);
    uint64_t last = 0;
    if (frame->args[1] >= 8)
      tai_rt_device_fetch(frame, &last,
                          static_cast<char *>(other) + frame->args[1] - 8, 8);
    frame->results[1] = last;
    return tai_rt_failed(frame);
  };
  KernelInfo info;
  info.name = "sum";
  info.function = host;
  info.argSlots = info.resultSlots = 2;
  info.trees = {runtime.store().findTree("x_tree")};
  info.image = imageOf({"addIndex", "sum"});
  KernelPtr kernel = runtime.launcher().kernels().create(std::move(info));
  uint64_t results[2];
  double expected = 0;
  for (int round = 1; round < 10000; ++round) {
    uint64_t size = round % 1000 ? 0 : uint64_t(round) * 512;
    ASSERT_OK(launch(*kernel, {100, size}, results));
    expected += 5050;
    ASSERT_EQ(slot<double>(results[0]), expected);
    ASSERT_EQ(results[1], 0u);
  }
}

TEST_F(RuntimeDevice, CopiesArraysOfTheCaller) {
  auto host = [](TaiFrame *frame) -> int32_t {
    auto *array = reinterpret_cast<void *>(frame->args[0]);
    void *a = tai_rt_device_array(frame, array, 80, 0);
    void *b = tai_rt_device_array(frame, array, 80, frame->args[1] != 0);
    uint64_t slots[] = {reinterpret_cast<uint64_t>(a == b ? a : nullptr), 10};
    tai_rt_device_launch(frame, 0, 10, slots, 2);
    return tai_rt_failed(frame);
  };
  KernelPtr kernel =
      onDevice(runtime, "arrays", host, imageOf({"addIndex"}), {}, 2);
  std::vector<double> array(10, 0.25);
  EXPECT_OK(launch(*kernel, {reinterpret_cast<uint64_t>(array.data()), 0}));
  EXPECT_EQ(array[9], 0.25);
  EXPECT_OK(launch(*kernel, {reinterpret_cast<uint64_t>(array.data()), 1}));
  EXPECT_EQ(array[9], 10.25);
  EXPECT_EQ(runtime.devices().device()->allocatedBytes(), 0);
}

TEST_F(RuntimeDevice, SaysWhatFailedWhenItWaits) {
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {4});
  auto host = [](TaiFrame *frame) -> int32_t {
    uint64_t slots[] = {reinterpret_cast<uint64_t>(tai_rt_device_state(frame))};
    tai_rt_device_launch(frame, 0, 1, slots, 1);
    return tai_rt_failed(frame);
  };
  KernelPtr kernel = onDevice(runtime, "fails", host, imageOf({"failOnDevice"}),
                              {{x, AccessKind::Write}});
  EXPECT_OK(launch(*kernel, {}));
  Status status = runtime.synchronize();
  EXPECT_EQ(status.code(), StatusCode::Assert);
  EXPECT_EQ(status.message(), "it broke");
  EXPECT_EQ(status.where(), "a.py:3:4");
  EXPECT_OK(runtime.synchronize());
  // In debug mode the launch itself reports the failure.
  runtime.setDebug(true);
  EXPECT_EQ(launch(*kernel, {}).message(), "it broke");
  EXPECT_OK(runtime.synchronize());
  // Reading a field that the kernel has written reports the failure, too.
  runtime.setDebug(false);
  EXPECT_OK(launch(*kernel, {}));
  double value;
  int64_t index = 0;
  EXPECT_EQ(x->readF64(&index, 0, value).message(), "it broke");
  EXPECT_OK(x->readF64(&index, 0, value));
}

TEST_F(RuntimeDevice, KernelsWithoutDeviceCodeRunOnTheHost) {
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {10});
  auto host = [](TaiFrame *frame) -> int32_t {
    static_cast<double *>(frame->trees[0])[3] *= 10;
    return 0;
  };
  KernelPtr onHost = makeKernel(
      runtime, "host", host, {{x, AccessKind::Read}, {x, AccessKind::Write}});
  KernelPtr kernel = addIndexKernel(x);
  EXPECT_OK(launch(*kernel, {10}));
  EXPECT_OK(launch(*onHost, {}));
  EXPECT_OK(launch(*kernel, {10}));
  EXPECT_EQ(get(*x, {3}), 44.0);
}

/// Sums a field of ten numbers into a loss, then changes the field; the adjoint
/// of the sum reads the field.
static void checkTape(Runtime &runtime, const FieldPtr &x,
                      const FieldPtr &beside, Kernel &changes) {
  FieldPtr loss = makeDifferentiable(runtime, "loss", ScalarKind::F64, {});
  auto toSecond = [](TaiFrame *frame) -> int32_t {
    uint64_t slots[] = {reinterpret_cast<uint64_t>(frame->trees[0]),
                        frame->args[0],
                        reinterpret_cast<uint64_t>(frame->trees[1])};
    tai_rt_device_launch(frame, 0, 1, slots, 3);
    return tai_rt_failed(frame);
  };
  TreePtr tree = runtime.store().findTree(x->tree().name());
  KernelInfo adjoint;
  adjoint.name = "reads_grad";
  adjoint.function = toSecond;
  adjoint.argSlots = 1;
  adjoint.trees = {tree, runtime.store().findTree("x_grad_tree")};
  adjoint.image = imageOf({"sum"});
  KernelInfo info;
  info.name = "reads";
  info.function = toSecond;
  info.argSlots = 1;
  info.trees = {tree, runtime.store().findTree("loss_tree")};
  info.summary = {{x, AccessKind::Read}, {loss, AccessKind::Accumulate}};
  info.image = imageOf({"sum"});
  info.adjoint = runtime.launcher().kernels().create(std::move(adjoint));
  uint64_t n = 10;
  if (beside) {
    n = 20;
    info.summary.push_back({beside, AccessKind::Read});
  }
  KernelPtr kernel = runtime.launcher().kernels().create(std::move(info));
  int64_t before = runtime.devices().device()->allocatedBytes();
  {
    std::unique_ptr<Tape> tape;
    ASSERT_OK(runtime.beginTape(loss, true, tape));
    EXPECT_OK(runtime.launch(*kernel, &n, 1, nullptr));
    EXPECT_OK(runtime.launch(changes, &n, 1, nullptr));
    double first = get(*x, {4});
    EXPECT_OK(tape->backward());
    // The sweep used the values that x had while the tape recorded.
    double sum = get(*loss);
    EXPECT_EQ(get(*x->adjoint(), {0}), sum);
    EXPECT_EQ(get(*x, {4}), first);
    EXPECT_OK(tape->replay(true, true));
    EXPECT_GT(get(*loss), sum);
    EXPECT_EQ(get(*x->adjoint(), {0}), get(*loss));
    EXPECT_OK(tape->replay(false, true));
    EXPECT_EQ(get(*x->adjoint(), {0}), get(*loss));
  }
  // Only the loss and the adjoint of x remain, no memory of the tape.
  EXPECT_EQ(runtime.devices().device()->allocatedBytes(),
            before + int64_t(sizeof(double)) * (1 + 10));
}

TEST_F(RuntimeDevice, TapesKeepWhatKernelsOverwrite) {
  FieldPtr x = makeDifferentiable(runtime, "x", ScalarKind::F64, {10});
  EXPECT_OK(runtime.writes().fillF64(*x, 2.0));
  KernelPtr changes = addIndexKernel(x);
  EXPECT_OK(launch(*changes, {10}));
  checkTape(runtime, x, nullptr, *changes);
}

TEST_F(RuntimeDevice, TapesKeepFieldsThatShareTheirCells) {
  FieldPtr a, b;
  makeShared(runtime, ScalarKind::F64, 10, a, b);
  ASSERT_OK(runtime.store().setAdjoint(
      *a, makeField(runtime, "x_grad", ScalarKind::F64, {10})));
  KernelPtr changes = onDevice(
      runtime, "add_index", addIndexHost, imageOf({"addIndex"}),
      {{a, AccessKind::Read}, {a, AccessKind::Write}, {b, AccessKind::Write}},
      1);
  EXPECT_OK(launch(*changes, {20}));
  checkTape(runtime, a, b, *changes);
}

TEST_F(RuntimeDevice, RefusesWhatIsNotThere) {
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {10});
  EXPECT_EQ(runtime.useDevice(nullptr).message(),
            "the device must be chosen before the first field is made");
  KernelPtr kernel = onDevice(runtime, "k", addIndexHost, imageOf({"nothing"}),
                              {{x, AccessKind::Write}}, 1);
  EXPECT_EQ(launch(*kernel, {10}).message(),
            "kernel 'k': device code holds no function 'nothing'");
}

TEST_F(RuntimeDevice, ForgetsDestroyedTrees) {
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {100});
  KernelPtr kernel = addIndexKernel(x);
  EXPECT_OK(launch(*kernel, {100}));
  EXPECT_EQ(runtime.devices().device()->allocatedBytes(), 800);
  EXPECT_OK(runtime.destroyTree("x_tree"));
  EXPECT_EQ(runtime.devices().device()->allocatedBytes(), 0);
  EXPECT_EQ(launch(*kernel, {100}).message(),
            "kernel 'add_index' uses tree 'x_tree', which has been destroyed");
}

TEST(RuntimeDeviceLimits, SaysWhoHoldsTheMemory) {
  Runtime runtime;
  ASSERT_OK(runtime.useDevice(openEmulatedDevice(linkHere), 10000));
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {100});
  FieldPtr y = makeField(runtime, "y", ScalarKind::F64, {1000});
  FieldPtr z = makeField(runtime, "z", ScalarKind::F64, {200});
  for (const FieldPtr &field : {x, y, z}) {
    KernelPtr kernel =
        onDevice(runtime, "k", addIndexHost, imageOf({"addIndex"}),
                 {{field, AccessKind::Write}}, 1);
    uint64_t n = 100;
    Status status = runtime.launch(*kernel, &n, 1, nullptr);
    if (field != z) {
      EXPECT_OK(status);
      continue;
    }
    EXPECT_EQ(status.code(), StatusCode::Memory);
    EXPECT_EQ(status.message(),
              "out of memory on the device 'emulated': tree 'z_tree' needs 1.6 "
              "KiB, a limit of 9.8 KiB is set; this program holds 8.6 KiB: "
              "tree 'y_tree' 7.8 KiB, tree 'x_tree' 800 B");
  }
  // The context can still be used.
  EXPECT_OK(runtime.destroyTree("x_tree"));
  EXPECT_EQ(get(*y, {3}), 4.0);
}

//===----------------------------------------------------------------------===//
// CUDA
//===----------------------------------------------------------------------===//

#ifdef TAI_FAKE_CUDA_LIBRARY
namespace {
class RuntimeCuda : public ::testing::Test {
protected:
  void SetUp() override { use(TAI_FAKE_CUDA_LIBRARY, ""); }
  void TearDown() override {
    for (const char *name :
         {"TAI_CUDA_DRIVER", "TAI_FAKE_CUDA", "CUDA_VISIBLE_DEVICES"})
      unsetenv(name);
  }
  static void use(const char *driver, const char *trouble) {
    setenv("TAI_CUDA_DRIVER", driver, 1);
    setenv("TAI_FAKE_CUDA", trouble, 1);
  }
  static std::string whyNot(int ordinal = 0) {
    std::unique_ptr<Device> device;
    Status status = openCudaDevice(ordinal, device);
    EXPECT_FALSE(status.ok());
    EXPECT_EQ(device, nullptr);
    return status.message();
  }
};
} // namespace

TEST_F(RuntimeCuda, SaysWhyThereIsNoDevice) {
  use("libno-such-driver.so.1", "");
  EXPECT_EQ(whyNot().rfind("no CUDA driver: the library "
                           "'libno-such-driver.so.1' cannot be loaded (",
                           0),
            0u);
  use("libm.so.6", "");
  EXPECT_EQ(whyNot(), "the library 'libm.so.6' is not a CUDA driver");
  use(TAI_FAKE_CUDA_LIBRARY, "no-device");
  EXPECT_EQ(whyNot(), "no CUDA device: the driver finds none");
  use(TAI_FAKE_CUDA_LIBRARY, "zero-devices");
  EXPECT_EQ(whyNot(), "no CUDA device: the driver finds none");
  setenv("CUDA_VISIBLE_DEVICES", "7", 1);
  EXPECT_EQ(whyNot(),
            "no CUDA device: the driver finds none; the environment variable "
            "CUDA_VISIBLE_DEVICES is '7', which hides all others");
  unsetenv("CUDA_VISIBLE_DEVICES");
  use(TAI_FAKE_CUDA_LIBRARY, "");
  EXPECT_EQ(whyNot(5), "no CUDA device: number 5 was asked for, and the driver "
                       "finds 2");
  use(TAI_FAKE_CUDA_LIBRARY, "busy");
  EXPECT_EQ(whyNot(), "the CUDA device cannot be used "
                      "(CUDA_ERROR_DEVICE_UNAVAILABLE: device busy or "
                      "unavailable): Fake GPU 0; another process may hold all "
                      "of its memory, or have it to itself");
  use(TAI_FAKE_CUDA_LIBRARY, "ancient");
  EXPECT_EQ(whyNot(), "Fake GPU 0 has compute capability 5.0, and 6.0 or newer "
                      "is needed");
}

// The driver's version is queried once, when it is loaded.
TEST_F(RuntimeCuda, RefusesOldDrivers) {
  std::string copy = ::testing::TempDir() + "tai-old-cuda.so";
  ASSERT_EQ(symlink(TAI_FAKE_CUDA_LIBRARY, copy.c_str()), 0);
  use(copy.c_str(), "old");
  EXPECT_EQ(whyNot(), "the CUDA driver is too old: it supports CUDA 11.4, and "
                      "CUDA 12.0 or newer is needed; install a newer NVIDIA "
                      "driver");
  unlink(copy.c_str());
}

/// The host part of a kernel: scales the n numbers of the first tree by the
/// second argument.
static int32_t scaleHost(TaiFrame *frame) {
  uint64_t slots[] = {reinterpret_cast<uint64_t>(frame->trees[0]),
                      frame->args[0], frame->args[1]};
  tai_rt_device_launch(frame, 0, int64_t(frame->args[0]), slots, 3);
  return tai_rt_failed(frame);
}

static void checkScaling() {
  Runtime runtime;
  std::unique_ptr<Device> device;
  ASSERT_OK(openCudaDevice(1, device));
  EXPECT_EQ(device->name(), "Fake GPU 1");
  EXPECT_EQ(device->target(), "sm_90");
  EXPECT_EQ(device->limits().multiprocessors, 10u);
  ASSERT_OK(runtime.useDevice(std::move(device)));
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {20000});
  KernelPtr kernel =
      onDevice(runtime, "scale", scaleHost,
               imageOf({"scale"}, DeviceKind::Cuda, "// PTX"),
               {{x, AccessKind::Read}, {x, AccessKind::Write}}, 2);
  EXPECT_OK(runtime.writes().fillF64(*x, 3.0));
  uint64_t args[] = {20000, slotOf(2.0)};
  EXPECT_OK(runtime.launch(*kernel, args, 2, nullptr));
  EXPECT_EQ(get(*x, {12345}), 6.0);
  set(*x, {12345}, 0.5);
  EXPECT_OK(runtime.launch(*kernel, args, 2, nullptr));
  EXPECT_EQ(get(*x, {12345}), 1.0);
  EXPECT_EQ(get(*x, {12344}), 12.0);
  // A pattern whose halves differ, on the device.
  EXPECT_OK(runtime.writes().fillF64(*x, 0.1));
  EXPECT_OK(runtime.launch(*kernel, args, 2, nullptr));
  EXPECT_EQ(get(*x, {19999}), 0.2);
  EXPECT_OK(runtime.synchronize());
}

TEST_F(RuntimeCuda, HasAHeapOfTheSizeThatIsWanted) {
  use(TAI_FAKE_CUDA_LIBRARY, "heap-in-use");
  std::unique_ptr<Device> device;
  // A heap size that was not requested causes no error.
  EXPECT_OK(openCudaDevice(0, device));
  setDeviceHeapBytes(1 << 20);
  EXPECT_OK(openCudaDevice(0, device));
  setDeviceHeapBytes(int64_t(1) << 40);
  EXPECT_NE(whyNot().find("the heap of kernels cannot have 1.0 TiB"),
            std::string::npos);
  use(TAI_FAKE_CUDA_LIBRARY, "");
  EXPECT_OK(openCudaDevice(0, device));
  setDeviceHeapBytes(0);
}

TEST_F(RuntimeCuda, RunsKernels) { checkScaling(); }

// Rows are moved by units of one byte and of four bytes.
TEST_F(RuntimeCuda, MovesRows) {
  for (ScalarKind scalar :
       {ScalarKind::F16, ScalarKind::F32, ScalarKind::F64}) {
    Runtime runtime;
    std::unique_ptr<Device> device;
    ASSERT_OK(openCudaDevice(0, device));
    ASSERT_OK(runtime.useDevice(std::move(device)));
    FieldPtr a, b;
    makeShared(runtime, scalar, 50, a, b);
    KernelPtr kernel = onDevice(runtime, "scale", scaleHost,
                                imageOf({"scale"}, DeviceKind::Cuda, "// PTX"),
                                {{a, AccessKind::Write}}, 2);
    uint64_t args[] = {0, slotOf(2.0)};
    // Launches a kernel that changes the field on the device.
    auto touch = [&] {
      args[0] = 1;
      args[1] = slotOf(1.0);
      EXPECT_OK(runtime.launch(*kernel, args, 2, nullptr));
    };
    set(*a, {7}, 1.25);
    touch();
    EXPECT_OK(runtime.writes().fillF64(*b, 0.125));
    EXPECT_EQ(get(*a, {7}), 1.25);
    EXPECT_EQ(get(*b, {49}), 0.125);
    touch();
    std::vector<char> values(size_t(b->hostBytes()));
    EXPECT_OK(runtime.copies().copyOut(*a, values.data()));
    EXPECT_OK(runtime.writes().copyIn(*b, values.data()));
    EXPECT_EQ(get(*b, {7}), 1.25);
    EXPECT_EQ(get(*b, {8}), 0.0);
  }
}

TEST_F(RuntimeCuda, RunsKernelsWithoutMemoryPools) {
  use(TAI_FAKE_CUDA_LIBRARY, "no-pools");
  checkScaling();
}

TEST_F(RuntimeCuda, ReservesMemoryWhereThatCanBe) {
  SparseInfo level;
  level.label = "the 'bitmasked' level above @x";
  level.steps.push_back({int64_t(1) << 40, 8});
  level.activityOffset = int64_t(8) << 40;
  Runtime runtime;
  std::unique_ptr<Device> device;
  ASSERT_OK(openCudaDevice(0, device));
  EXPECT_EQ(device->limits().reservedPieceBytes, 0);
  ASSERT_OK(runtime.useDevice(std::move(device)));
  TreePtr tree;
  Status status = runtime.store().addTree("s", (int64_t(8) << 40) + (1 << 20),
                                          tree, {level});
  EXPECT_EQ(status.code(), StatusCode::Memory);
  EXPECT_EQ(status.message().rfind(
                "tree 's' spans 8.0 TiB with all cells active (the 'bitmasked' "
                "level above @x), and the device 'Fake GPU 0' has ",
                0),
            0u);
  EXPECT_NE(status.message().find(
                " and cannot give it to cells one by one: make the levels "
                "smaller, or use the CPU for this program"),
            std::string::npos);

  use(TAI_FAKE_CUDA_LIBRARY, "managed");
  ASSERT_OK(openCudaDevice(0, device));
  EXPECT_EQ(device->limits().reservedPieceBytes, 2 << 20);
  int64_t allocated = device->allocatedBytes();
  DevicePtr memory = 0;
  ASSERT_OK(device->reserve(1 << 22, memory));
  EXPECT_EQ(device->allocatedBytes(), allocated);
  int32_t one = 1, found[2] = {7, 7};
  EXPECT_OK(device->copyIn(memory + 4, &one, sizeof(one)));
  EXPECT_OK(device->copyOut(found, memory, sizeof(found)));
  EXPECT_EQ(found[0], 0);
  EXPECT_EQ(found[1], 1);
  device->free(memory);
  EXPECT_OK(device->reserve(1 << 20, memory));
}

TEST_F(RuntimeCuda, ChoosesBlocks) {
  for (int wanted : {0, 128}) {
    Runtime runtime;
    std::unique_ptr<Device> device;
    ASSERT_OK(openCudaDevice(0, device));
    ASSERT_OK(runtime.useDevice(std::move(device)));
    runtime.setBlockThreads(wanted);
    FieldPtr x = makeField(runtime, "x", ScalarKind::I32, {2});
    auto host = [](TaiFrame *frame) -> int32_t {
      uint64_t slots[] = {reinterpret_cast<uint64_t>(frame->trees[0])};
      tai_rt_device_launch(frame, 0, int64_t(frame->args[0]), slots, 1);
      return tai_rt_failed(frame);
    };
    KernelPtr kernel = onDevice(runtime, "where", host,
                                imageOf({"where"}, DeviceKind::Cuda, "// PTX"),
                                {{x, AccessKind::Write}}, 1);
    auto shape = [&](int64_t n) {
      auto arg = uint64_t(n);
      EXPECT_OK(runtime.launch(*kernel, &arg, 1, nullptr));
      return std::make_pair(get(*x, {0}), get(*x, {1}));
    };
    using Shape = std::pair<double, double>;
    EXPECT_EQ(shape(1), Shape(1, 1));
    EXPECT_EQ(shape(20), Shape(1, 32));
    // Use no more blocks than run at a time: 2048 threads on each of 10
    // multiprocessors.
    EXPECT_EQ(shape(int64_t(1) << 40),
              wanted ? Shape(160, 128) : Shape(80, 256));
    EXPECT_EQ(shape(-1), wanted ? Shape(160, 128) : Shape(80, 256));
    // With few iterations, use smaller blocks, to occupy all multiprocessors.
    EXPECT_EQ(shape(640), Shape(10, 64));
    EXPECT_EQ(shape(12800), wanted ? Shape(100, 128) : Shape(50, 256));
  }
}

TEST_F(RuntimeCuda, MakesCodeOfTheCacheAgainThatTheDriverRefuses) {
  Runtime runtime;
  std::unique_ptr<Device> device;
  ASSERT_OK(openCudaDevice(0, device));
  ASSERT_OK(runtime.useDevice(std::move(device)));
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {100});
  int made = 0;
  auto launch = [&](Kernel &kernel) {
    uint64_t args[] = {100, slotOf(2.0)};
    return runtime.launch(kernel, args, 2, nullptr);
  };
  auto makeScale = [&](const char *fresh, const char *function) {
    DeviceImage image = *imageOf({"scale"}, DeviceKind::Cuda, "refused");
    image.makeAgain = [&made, fresh, function](DeviceImage &again) {
      ++made;
      again = *imageOf({function}, DeviceKind::Cuda, fresh);
      return Status::success();
    };
    return onDevice(runtime, "scale", scaleHost,
                    std::make_shared<const DeviceImage>(std::move(image)),
                    {{x, AccessKind::Read}, {x, AccessKind::Write}}, 2);
  };
  KernelPtr good = makeScale("// PTX", "scale");
  ASSERT_OK(runtime.writes().fillF64(*x, 3));
  EXPECT_OK(launch(*good));
  EXPECT_OK(launch(*good));
  double value = 0;
  int64_t index = 99;
  EXPECT_OK(x->readF64(&index, 0, value));
  EXPECT_EQ(value, 12);
  EXPECT_EQ(made, 1);
  // A driver that accepts neither form of the code reports so once.
  KernelPtr bad = makeScale("refused too", "scale");
  for (int round = 0; round < 2; ++round) {
    Status status = launch(*bad);
    EXPECT_FALSE(status.ok());
    EXPECT_NE(status.message().find("does not take the code"),
              std::string::npos);
  }
  EXPECT_EQ(made, 2);
  // Code with other functions does not fit the host part.
  KernelPtr other = makeScale("// PTX", "add");
  EXPECT_FALSE(launch(*other).ok());
}

TEST_F(RuntimeCuda, ReportsWhatGoesWrong) {
  use(TAI_FAKE_CUDA_LIBRARY, "small");
  Runtime runtime;
  std::unique_ptr<Device> device;
  ASSERT_OK(openCudaDevice(0, device));
  ASSERT_OK(runtime.useDevice(std::move(device)));
  FieldPtr x = makeField(runtime, "x", ScalarKind::F64, {100000});
  FieldPtr y = makeField(runtime, "y", ScalarKind::F64, {100000});
  auto image = imageOf({"scale"}, DeviceKind::Cuda, "// PTX");
  auto scale = [&](const FieldPtr &field) {
    KernelPtr kernel = onDevice(runtime, "scale", scaleHost, image,
                                {{field, AccessKind::Write}}, 2);
    uint64_t args[] = {100, slotOf(2.0)};
    return runtime.launch(*kernel, args, 2, nullptr);
  };
  EXPECT_OK(scale(x));
  Status status = scale(y);
  EXPECT_EQ(status.code(), StatusCode::Memory);
  EXPECT_EQ(
      status.message(),
      "out of memory on the device 'Fake GPU 0': tree 'y_tree' needs "
      "781.2 KiB, 242.8 KiB of 1.0 MiB are free; this program holds 781.2 "
      "KiB: tree 'x_tree' 781.2 KiB");
  use(TAI_FAKE_CUDA_LIBRARY, "bad-ptx");
  EXPECT_EQ(scale(x).message(), "kernel 'scale': the CUDA driver does not take "
                                "the code of a kernel for sm_90 "
                                "(CUDA_ERROR_INVALID_PTX: invalid PTX):\n"
                                "ptxas fatal : line 3: unknown instruction");
  use(TAI_FAKE_CUDA_LIBRARY, "fault");
  EXPECT_OK(scale(x));
  status = runtime.synchronize();
  EXPECT_EQ(status.code(), StatusCode::Index);
  EXPECT_EQ(status.message(),
            "a kernel used memory outside of its fields and arrays: an index "
            "that depends on data was out of range; ti.init(bounds=\"check\") "
            "names the line, the field and the index (a kernel has failed on "
            "the device: CUDA_ERROR_ILLEGAL_ADDRESS: an illegal memory access "
            "was encountered)");
}
#endif // TAI_FAKE_CUDA_LIBRARY
