//===- ProfilerTest.cpp - Times of kernels on devices ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The fake CUDA driver has a clock that advances by a microsecond with each
// launch, and with each thousand numbers that the launch scales: times are
// known exactly.
//
//===----------------------------------------------------------------------===//

#include "../../Utils/RuntimeTestUtils.h"
#include "tai/Runtime/Device/Device.h"
#include <algorithm>
#include <cstdlib>
#include <dlfcn.h>
#include <fstream>
#include <sstream>
#include <unistd.h>

#ifdef TAI_FAKE_CUDA_LIBRARY
using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

static std::shared_ptr<const DeviceImage> scaleImage() {
  DeviceImage image;
  image.kind = DeviceKind::Cuda;
  image.bytes = "// PTX";
  image.functions = {"scale"};
  image.places = {"/home/someone/a.py:12:3"};
  return std::make_shared<const DeviceImage>(std::move(image));
}

/// Scales the first tree of n numbers by the second argument.
static int32_t scaleHost(TaiFrame *frame) {
  uint64_t slots[] = {reinterpret_cast<uint64_t>(frame->trees[0]),
                      frame->args[0], frame->args[1]};
  tai_rt_device_launch(frame, 0, int64_t(frame->args[0]), slots, 3);
  return tai_rt_failed(frame);
}

namespace {
class RuntimeProfiler : public ::testing::Test {
protected:
  void SetUp() override {
    setenv("TAI_CUDA_DRIVER", TAI_FAKE_CUDA_LIBRARY, 1);
    setenv("TAI_FAKE_CUDA", "", 1);
  }
  void TearDown() override {
    x.reset();
    kernel.reset();
    runtime.reset();
    for (const char *name : {"TAI_CUDA_DRIVER", "TAI_FAKE_CUDA",
                             "NVTX_INJECTION64_PATH", "TAI_FAKE_NVTX_LOG"})
      unsetenv(name);
  }
  void open() {
    runtime = std::make_unique<Runtime>();
    std::unique_ptr<Device> device;
    ASSERT_OK(openCudaDevice(0, device));
    ASSERT_OK(runtime->useDevice(std::move(device)));
    x = makeField(*runtime, "x", ScalarKind::F64, {100000});
    kernel = makeKernel(*runtime, "k", scaleHost,
                        {{x, AccessKind::Read}, {x, AccessKind::Write}}, 2);
    kernel->setDeviceImage(scaleImage());
  }
  void scale(int64_t n) {
    uint64_t args[] = {uint64_t(n), slotOf(1.0)};
    ASSERT_OK(runtime->launch(*kernel, args, 2, nullptr));
  }
  const ProfileRow *find(const std::vector<ProfileRow> &rows,
                         const std::string &name) {
    for (const ProfileRow &row : rows)
      if (row.kernel == name)
        return &row;
    return nullptr;
  }
  static int countEvents() {
    void *library = dlopen(TAI_FAKE_CUDA_LIBRARY, RTLD_NOW | RTLD_NOLOAD);
    return *static_cast<int *>(dlsym(library, "tai_fake_cuda_events"));
  }
  std::unique_ptr<Runtime> runtime;
  FieldPtr x;
  KernelPtr kernel;
};
} // namespace

TEST_F(RuntimeProfiler, TakesTheTimesOfTheDevice) {
  open();
  scale(1000);
  EXPECT_TRUE(runtime->profile().empty());
  runtime->setProfiler(true);
  for (int64_t n : {1000, 5000, 100000})
    scale(n);
  std::vector<ProfileRow> rows = runtime->profile();
  const ProfileRow *row = find(rows, "scale");
  ASSERT_TRUE(row);
  EXPECT_EQ(row->kind, ProfileKind::Device);
  EXPECT_EQ(row->times.launches, 3);
  // A microsecond for each launch, and one for each thousand numbers.
  EXPECT_NEAR(double(row->times.minNs), 2000, 1);
  EXPECT_NEAR(double(row->times.maxNs), 101000, 1);
  EXPECT_NEAR(double(row->times.totalNs), 109000, 3);
  EXPECT_EQ(row->place, "/home/someone/a.py:12:3");
  // All of x is read and written.
  EXPECT_EQ(row->bytes, 2 * 100000 * 8);
  EXPECT_EQ(row->facts.registers, 40);
  EXPECT_EQ(row->facts.sharedBytes, 1024);
  EXPECT_EQ(row->facts.localBytes, 16);
  EXPECT_EQ(row->threads, 256u);
  // 8 blocks of 256 threads fill the 2048 threads of a multiprocessor.
  EXPECT_EQ(row->occupancy, 1.0);
  runtime->clearProfile();
  EXPECT_TRUE(runtime->profile().empty());
  runtime->setProfiler(false);
  scale(1000);
  EXPECT_TRUE(runtime->profile().empty());
}

TEST_F(RuntimeProfiler, PutsBothSidesOnOneLineOfTime) {
  open();
  runtime->setProfiler(true);
  scale(1000);
  scale(2000);
  int64_t lost = -1;
  std::vector<TraceEvent> events = runtime->trace(lost);
  EXPECT_EQ(lost, 0);
  std::vector<TraceEvent> device, enqueued, kernels;
  for (const TraceEvent &event : events)
    if (event.row->kind == ProfileKind::Device)
      (event.onDevice ? device : enqueued).push_back(event);
    else if (event.row->kind == ProfileKind::Host)
      kernels.push_back(event);
  ASSERT_EQ(device.size(), 2u);
  ASSERT_EQ(enqueued.size(), 2u);
  ASSERT_EQ(kernels.size(), 2u);
  EXPECT_EQ(kernels[0].row->kernel, "k");
  // The first launch is preceded by the copy of x to the device, which takes
  // time, too.
  EXPECT_NEAR(double(device[0].durationNs), 2000, 1);
  EXPECT_NEAR(double(device[1].durationNs), 3000, 1);
  EXPECT_NEAR(double(device[1].startNs - device[0].startNs), 2000, 1);
  for (size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(device[i].queuedNs, enqueued[i].startNs);
    EXPECT_GE(enqueued[i].startNs, kernels[i].startNs);
    EXPECT_LE(enqueued[i].startNs + enqueued[i].durationNs,
              kernels[i].startNs + kernels[i].durationNs);
    // No launch starts before it was queued.
    EXPECT_GE(device[i].startNs, device[i].queuedNs);
  }
}

TEST_F(RuntimeProfiler, TimesCopiesAndFills) {
  open();
  runtime->setProfiler(true);
  set(*x, {3}, 1.0);
  scale(1000);
  EXPECT_OK(runtime->writes().fillF64(*x, 0.0));
  std::vector<double> values(100000);
  EXPECT_OK(runtime->copies().copyOut(*x, values.data()));
  std::vector<ProfileRow> rows = runtime->profile();
  for (const char *name : {"copy to the device", "copy to the host", "fill"}) {
    const ProfileRow *row = find(rows, name);
    ASSERT_TRUE(row) << name;
    EXPECT_EQ(row->kind, ProfileKind::Memory);
    EXPECT_GE(row->times.launches, 1);
  }
}

// Launches whose times are not queried for long do not keep an event each.
TEST_F(RuntimeProfiler, ReadsEventsInBetween) {
  int before = 0;
  open();
  before = countEvents();
  runtime->setProfiler(true);
  constexpr int64_t launches = 30000;
  for (int64_t i = 0; i < launches; ++i)
    scale(1000);
  EXPECT_LT(countEvents() - before, 2 * 8192 + 100);
  std::vector<ProfileRow> rows = runtime->profile();
  const ProfileRow *row = find(rows, "scale");
  ASSERT_TRUE(row);
  EXPECT_EQ(row->times.launches, launches);
  EXPECT_NEAR(double(row->times.totalNs), 2000.0 * launches, launches);
  // Destroys all objects that keep the device alive.
  kernel.reset();
  x.reset();
  runtime.reset();
  EXPECT_EQ(countEvents(), before);
}

TEST_F(RuntimeProfiler, ReportsWhatFails) {
  open();
  runtime->setProfiler(true);
  scale(1000);
  setenv("TAI_FAKE_CUDA", "fault", 1);
  scale(1000);
  (void)runtime->profile();
  EXPECT_NE(runtime->synchronize().message().find("a kernel has failed"),
            std::string::npos);
}

static std::string logOfNvtx() {
  void *library = dlopen(TAI_FAKE_NVTX_LIBRARY, RTLD_NOW);
  auto *log = static_cast<char *>(dlsym(library, "tai_fake_nvtx_log"));
  std::string text = log;
  *log = 0;
  return text;
}

TEST_F(RuntimeProfiler, NamesRangesForTools) {
  setenv("NVTX_INJECTION64_PATH", TAI_FAKE_NVTX_LIBRARY, 1);
  (void)logOfNvtx();
  open();
  EXPECT_TRUE(runtime->wantsPlaces());
  scale(1000);
  EXPECT_EQ(logOfNvtx(), "+scale (a.py:12)\n-\n");
  // Older versions use the name of the library, which is loaded already and
  // found by this name.
  unsetenv("NVTX_INJECTION64_PATH");
  open();
  scale(1000);
  EXPECT_EQ(logOfNvtx(), "+scale (a.py:12)\n-\n");
  // A library without the functions for NVTX.
  setenv("NVTX_INJECTION64_PATH", TAI_FAKE_CUDA_LIBRARY, 1);
  open();
  EXPECT_FALSE(runtime->wantsPlaces());
  scale(1000);
  EXPECT_EQ(logOfNvtx(), "");
}
#endif // TAI_FAKE_CUDA_LIBRARY
