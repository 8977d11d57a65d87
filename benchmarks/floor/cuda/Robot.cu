//===- Robot.cu - a controlled robot, forward and reverse ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// robot [--quick] [--runs=N] [--dump=FILE] [variant...]
//
//   persistent   2047 steps and their adjoints in one block
//
// Times are of all steps, forward and backward.
//
//===----------------------------------------------------------------------===//

#include "RobotScene.h"

#ifndef HOST_CHECK
#include "Device.h"
#endif

using namespace tai::floor;

namespace {

/// The controller's clock: what no point or weight changes.
TAI_BOTH float sineAt(const Robot &r, int k) {
  const float phase = float(2.0 * 3.14159265358979323846 / waves);
  return sinf(10.0f * float(k / waves) * r.dt + phase * float(k % waves));
}

#ifdef HOST_CHECK

/// Runs a part for all threads, and `rest` with the sums over groups of `lanes`
/// threads.
template <typename Part, typename Rest>
void forSums(int lanes, const Part &part, const Rest &rest) {
  float parts[robotThreads];
  for (int thread = 0; thread < robotThreads; ++thread)
    parts[thread] = part(thread);
  for (int thread = 0; thread < robotThreads; ++thread) {
    float sum = 0;
    for (int lane = 0; lane < lanes; ++lane)
      sum += parts[thread / lanes * lanes + lane];
    rest(thread, sum);
  }
}

template <typename Body> void forThreads(const Body &body) {
  for (int thread = 0; thread < robotThreads; ++thread)
    body(thread);
}

Pair centreOf(const Pair *x) {
  Pair sum = {0, 0};
  for (int point = 0; point < points; ++point) {
    sum.x += x[point].x / points;
    sum.y += x[point].y / points;
  }
  return sum;
}

int run(const Options &options) {
  RobotScene scene;
  const size_t stored = size_t(robotSlots) * points;
  std::vector<Pair> x(stored), v(stored), free(stored);
  std::vector<float> hidden(size_t(robotSlots) * hiddenCount),
      output(size_t(robotSlots) * springs), bars(barCount);
  Robot r = RobotScene::settings();
  r.start = scene.start.data();
  r.first = scene.first.data(), r.second = scene.second.data();
  r.rest = scene.rest.data(), r.stiffness = scene.stiffness.data();
  r.amount = scene.amount.data();
  r.incidentStart = scene.incidentStart.data();
  r.incident = scene.incident.data();
  r.w1 = scene.w1.data(), r.b1 = scene.b1.data();
  r.w2 = scene.w2.data(), r.b2 = scene.b2.data();
  r.sines = scene.sines.data();
  r.x = x.data(), r.v = v.data(), r.free = free.data();
  r.hidden = hidden.data(), r.output = output.data(), r.bars = bars.data();

  RobotMemory m;
  std::vector<RobotThread> own(robotThreads);
  for (int k = 0; k < robotSlots * waves; ++k)
    r.sines[k] = sineAt(r, k);
  forThreads([&](int thread) {
    loadWeights(r, own[size_t(thread)], thread);
    loadBody(r, m, thread);
  });
  for (int t = 0; t < robotSlots - 1; ++t) {
    m.centre = centreOf(m.x);
    forThreads([&](int thread) { seePhase(r, m, t, thread); });
    forSums(
        lanes1,
        [&](int thread) { return layer1Part(m, own[size_t(thread)], thread); },
        [&](int thread, float sum) {
          layer1Phase(r, m, own[size_t(thread)], t, thread, sum);
        });
    forSums(
        lanes2,
        [&](int thread) { return layer2Part(m, own[size_t(thread)], thread); },
        [&](int thread, float sum) {
          layer2Phase(r, m, own[size_t(thread)], t, thread, sum);
        });
    forThreads([&](int thread) { advancePhase(r, m, t, thread); });
  }
  Outcome outcome;
  outcome.loss = -m.x[0].x;
  forThreads([&](int thread) { seedPhase(m, thread); });
  for (int t = robotSlots - 2; t >= 0; --t) {
    forThreads(
        [&](int thread) { contactPhase(r, m, Stored(r, t, thread), thread); });
    m.centre = centreOf(m.x);
    forThreads([&](int thread) { springBarPhase(r, m, t, thread); });
    forSums(
        lanes3,
        [&](int thread) {
          return layer2BarPart(m, own[size_t(thread)], thread);
        },
        [&](int thread, float sum) { layer2BarPhase(m, thread, sum); });
    forSums(
        lanes4,
        [&](int thread) {
          return layer1BarPart(m, own[size_t(thread)], thread);
        },
        [&](int thread, float sum) { layer1BarPhase(m, thread, sum); });
    Pair centre = {0, 0};
    forThreads([&](int thread) {
      const Pair part = centrePart(m, thread);
      centre.x += part.x;
      centre.y += part.y;
    });
    forThreads([&](int thread) { pointBarPhase(r, m, thread, centre); });
  }
  forThreads([&](int thread) { storeBars(r, own[size_t(thread)], thread); });
  outcome.gradient = bars;
  print("mass_spring", "persistent", "check", {}, &outcome);
  outcome.dump(options.dump);
  return 0;
}

#else // HOST_CHECK

/// Sum over groups of neighbouring lanes, in all of them.
template <int lanes> __device__ __forceinline__ float laneSum(float part) {
#pragma unroll
  for (int lane = lanes / 2; lane > 0; lane /= 2)
    part += __shfl_xor_sync(0xffffffffu, part, lane);
  return part;
}

/// The centre, by the warp that has just written the points.
__device__ __forceinline__ void findCentre(RobotMemory &m, int thread) {
  if (thread >= 32)
    return;
  const Pair own = thread < points ? m.x[thread] : Pair{0.0f, 0.0f};
  const float x = laneSum<32>(own.x) / points, y = laneSum<32>(own.y) / points;
  if (thread == 0)
    m.centre = {x, y};
}

__global__ void sineKernel(Robot r) {
  const int k = int(blockIdx.x * blockDim.x + threadIdx.x);
  if (k < robotSlots * waves)
    r.sines[k] = sineAt(r, k);
}

__global__ void __launch_bounds__(robotThreads) robotKernel(Robot r) {
  __shared__ RobotMemory m;
  RobotThread own;
  const int thread = int(threadIdx.x);
  loadWeights(r, own, thread);
  loadBody(r, m, thread);
  __syncwarp();
  findCentre(m, thread);
  __syncthreads();
  for (int t = 0; t < robotSlots - 1; ++t) {
    seePhase(r, m, t, thread);
    __syncthreads();
    const float total1 = laneSum<lanes1>(layer1Part(m, own, thread));
    layer1Phase(r, m, own, t, thread, total1);
    __syncthreads();
    const float total2 = laneSum<lanes2>(layer2Part(m, own, thread));
    layer2Phase(r, m, own, t, thread, total2);
    __syncthreads();
    advancePhase(r, m, t, thread);
    __syncwarp();
    findCentre(m, thread);
    __syncthreads();
  }
  if (thread == 0)
    *r.loss = -m.x[0].x;
  seedPhase(m, thread);
  Stored stored(r, robotSlots - 2, thread);
  for (int t = robotSlots - 2; t >= 0; --t) {
    contactPhase(r, m, stored, thread);
    __syncwarp();
    findCentre(m, thread);
    __syncthreads();
    // The next step's loads run beside this step.
    stored = Stored(r, t > 0 ? t - 1 : 0, thread);
    springBarPhase(r, m, t, thread);
    __syncthreads();
    const float total3 = laneSum<lanes3>(layer2BarPart(m, own, thread));
    layer2BarPhase(m, thread, total3);
    __syncthreads();
    const float total4 = laneSum<lanes4>(layer1BarPart(m, own, thread));
    layer1BarPhase(m, thread, total4);
    __syncthreads();
    if (thread < 32) {
      const Pair part = centrePart(m, thread);
      pointBarPhase(r, m, thread, {laneSum<32>(part.x), laneSum<32>(part.y)});
    }
    __syncthreads();
  }
  storeBars(r, own, thread);
}

int run(const Options &options) {
  if (!options.wants("persistent"))
    return 0;
  RobotScene scene;
  const size_t stored = size_t(robotSlots) * points;
  Buffer<Pair> start(scene.start), x(stored), v(stored), free(stored);
  Buffer<int> first(scene.first), second(scene.second),
      incidentStart(scene.incidentStart), incident(scene.incident);
  Buffer<float> rest(scene.rest), stiffness(scene.stiffness),
      amount(scene.amount), w1(scene.w1), b1(scene.b1), w2(scene.w2),
      b2(scene.b2), sines(scene.sines),
      hidden(size_t(robotSlots) * hiddenCount),
      output(size_t(robotSlots) * springs), bars(barCount), loss(1);
  Robot r = RobotScene::settings();
  r.start = start.get();
  r.first = first.get(), r.second = second.get();
  r.rest = rest.get(), r.stiffness = stiffness.get(), r.amount = amount.get();
  r.incidentStart = incidentStart.get(), r.incident = incident.get();
  r.w1 = w1.get(), r.b1 = b1.get(), r.w2 = w2.get(), r.b2 = b2.get();
  r.sines = sines.get();
  r.x = x.get(), r.v = v.get(), r.free = free.get();
  r.hidden = hidden.get(), r.output = output.get(), r.bars = bars.get();
  r.loss = loss.get();
  cudaStream_t stream;
  TAI_CHECK(cudaStreamCreate(&stream));
  const Times times = measure(stream, options.runs, 1.0, [&] {
    sineKernel<<<(robotSlots * waves + 255) / 256, 256, 0, stream>>>(r);
    robotKernel<<<1, robotThreads, 0, stream>>>(r);
  });
  Outcome outcome;
  outcome.loss = loss.values(0, 1)[0];
  outcome.gradient = bars.values(0, barCount);
  print("mass_spring", "persistent", "both", times, &outcome);
  outcome.dump(options.dump);
  TAI_CHECK(cudaStreamDestroy(stream));
  return 0;
}

#endif // HOST_CHECK

} // namespace

int main(int argc, char **argv) { return run(parse(argc, argv)); }
