//===- Mpm.cu - 2-D MLS-MPM, forward and reverse, by hand ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// mpm [--quick] [--runs=N] [--dump=FILE] [variant...]
//
//   graph             three kernels a step, three for its adjoint, in a graph
//   graph-scalar      the same, scattering with an atomic per component
//   graph-overlapped  `graph`, each launched while the one before it runs
//   fused-graph       one kernel a step and one for its adjoint, in a graph
//   fused-overlapped  the same, each launched while the one before it runs
//   persistent        that as one kernel with a barrier over the grid
//   graph-large       `graph` for a million particles on 1024 x 1024 nodes
//   fused-large       `fused-graph` for them
//   shared-large      `graph-large`, the scatters of a block added up in shared
//                     memory first
//
// Times are per step, forward and backward.
//
//===----------------------------------------------------------------------===//

#include "Mpm.h"

#include <algorithm>

#ifndef HOST_CHECK
#include "Device.h"
#endif

using namespace tai::floor;

namespace {

constexpr int smallSide = 80, smallNodes = 128, smallSlots = 51;
/// Particles of a block that adds up in shared memory.
constexpr int blockParticles = 256;
constexpr int largeSide = 1000, largeNodes = 1024, largeSlots = 21;

#ifdef HOST_CHECK

/// The scene on the CPU: all the memory that the bodies use.
struct Scene {
  Mpm s;
  int side;
  std::vector<Pair> x, v, velocity, xBar, vBar, velocityBar;
  std::vector<Quad> c, f, grid, cBar, fBar, gridBar;

  explicit Scene(int n, int sideOfBlock, int slots)
      : s(makeMpm(n, sideOfBlock, slots)), side(sideOfBlock) {
    const size_t stored = size_t(slots) * size_t(s.count),
                 nodes = size_t(slots) * size_t(s.nodes());
    x.resize(stored), v.resize(stored), c.resize(stored), f.resize(stored);
    grid.resize(nodes), velocity.resize(nodes), velocityBar.resize(nodes);
    gridBar.resize(size_t(s.nodes()));
    xBar.resize(size_t(s.count)), vBar = xBar;
    cBar.resize(size_t(s.count)), fBar = cBar;
    s.x = x.data(), s.v = v.data(), s.c = c.data(), s.f = f.data();
    s.grid = grid.data(), s.velocity = velocity.data();
    s.xBar = xBar.data(), s.vBar = vBar.data();
    s.cBar = cBar.data(), s.fBar = fBar.data();
    s.velocityBar = velocityBar.data(), s.gridBar = gridBar.data();
    const std::vector<Particle> initial = initialParticles(s, side);
    for (int p = 0; p < s.count; ++p) {
      const Particle &own = initial[size_t(p)];
      s.x[p] = own.x, s.v[p] = own.v, s.c[p] = own.c, s.f[p] = own.f;
    }
  }

  Outcome outcome(double loss) const {
    Outcome result;
    result.loss = loss;
    for (const Pair &bar : vBar) {
      result.gradient.push_back(bar.x);
      result.gradient.push_back(bar.y);
    }
    return result;
  }
};

Outcome runStages(Scene &scene) {
  const Mpm &s = scene.s;
  for (int t = 0; t < s.slots - 1; ++t) {
    for (int p = 0; p < s.count; ++p)
      scatterBody<true>(s, t, p);
    for (int node = 0; node < s.nodes(); ++node)
      gridBody(s, t, node);
    for (int p = 0; p < s.count; ++p)
      gatherBody(s, t, p);
  }
  double loss = 0;
  for (int p = 0; p < s.count; ++p)
    loss += lossBody(s, p);
  for (int t = s.slots - 2; t >= 0; --t) {
    for (int p = 0; p < s.count; ++p)
      gatherBarBody(s, t, p);
    for (int node = 0; node < s.nodes(); ++node)
      gridBarBody(s, t, node);
    for (int p = 0; p < s.count; ++p)
      scatterBarBody(s, t, p);
  }
  return scene.outcome(loss);
}

Outcome runBlocks(Scene &scene) {
  const Mpm &s = scene.s;
  // Some windows do not fit: blocks that go over a row's end.
  Window<3> forward;
  Window<2> backward;
  for (int t = 0; t < s.slots - 1; ++t) {
    for (int p = 0; p < s.count; p += blockParticles)
      scatterBlock(s, t, p, std::min(blockParticles, s.count - p), forward);
    for (int node = 0; node < s.nodes(); ++node)
      gridBody(s, t, node);
    for (int p = 0; p < s.count; ++p)
      gatherBody(s, t, p);
  }
  double loss = 0;
  for (int p = 0; p < s.count; ++p)
    loss += lossBody(s, p);
  for (int t = s.slots - 2; t >= 0; --t) {
    for (int p = 0; p < s.count; p += blockParticles)
      gatherBarBlock(s, t, p, std::min(blockParticles, s.count - p), backward);
    for (int node = 0; node < s.nodes(); ++node)
      gridBarBody(s, t, node);
    for (int p = 0; p < s.count; ++p)
      scatterBarBody(s, t, p);
  }
  return scene.outcome(loss);
}

Outcome runFused(Scene &scene) {
  const Mpm &s = scene.s;
  for (int t = 0; t < s.slots; ++t)
    for (int p = 0; p < s.count; ++p) {
      Particle own = load(s, t > 0 ? t - 1 : 0, p);
      own.f = s.f[t * s.count + p];
      fusedForward(s, t, p, own);
    }
  double loss = 0;
  for (int p = 0; p < s.count; ++p)
    loss += lossBody(s, p);
  for (int t = s.slots - 1; t >= 0; --t)
    for (int p = 0; p < s.count; ++p) {
      Particle bar = {s.xBar[p], s.vBar[p], s.cBar[p], s.fBar[p]};
      fusedBackward(s, t, p, bar);
      storeBar(s, p, bar);
    }
  return scene.outcome(loss);
}

int run(const Options &options) {
  // The large scene only if it is named: it takes gigabytes.
  for (const std::string variant :
       {"graph", "fused-graph", "shared", "graph-large"}) {
    const bool large = variant == "graph-large";
    if (!options.wants(variant.c_str()) || (large && options.only.empty()))
      continue;
    Scene scene = large ? Scene(largeNodes, largeSide, largeSlots)
                        : Scene(smallNodes, smallSide, smallSlots);
    const Outcome outcome = variant == "shared"        ? runBlocks(scene)
                            : variant == "fused-graph" ? runFused(scene)
                                                       : runStages(scene);
    print(large ? "diffmpm_large" : "diffmpm", variant.c_str(), "check", {},
          &outcome);
    outcome.dump(options.dump);
  }
  return 0;
}

#else // HOST_CHECK

template <bool Whole> __global__ void scatterKernel(Mpm s, int t) {
  followPrevious();
  const int p = int(blockIdx.x * blockDim.x + threadIdx.x);
  if (p < s.count)
    scatterBody<Whole>(s, t, p);
}

__global__ void gridKernel(Mpm s, int t) {
  followPrevious();
  const int node = int(blockIdx.x * blockDim.x + threadIdx.x);
  if (node < s.nodes())
    gridBody(s, t, node);
}

__global__ void gatherKernel(Mpm s, int t) {
  followPrevious();
  const int p = int(blockIdx.x * blockDim.x + threadIdx.x);
  if (p < s.count)
    gatherBody(s, t, p);
}

/// Adds up the parts of a warp's threads, then adds them to memory.
__device__ void addLoss(float *loss, float part) {
  for (int lane = 16; lane > 0; lane /= 2)
    part += __shfl_xor_sync(0xffffffffu, part, lane);
  if (threadIdx.x % 32 == 0)
    atomicAdd(loss, part);
}

__global__ void lossKernel(Mpm s) {
  followPrevious();
  const int p = int(blockIdx.x * blockDim.x + threadIdx.x);
  addLoss(s.loss, p < s.count ? lossBody(s, p) : 0.0f);
}

__global__ void gatherBarKernel(Mpm s, int t) {
  followPrevious();
  const int p = int(blockIdx.x * blockDim.x + threadIdx.x);
  if (p < s.count)
    gatherBarBody(s, t, p);
}

__global__ void gridBarKernel(Mpm s, int t) {
  followPrevious();
  const int node = int(blockIdx.x * blockDim.x + threadIdx.x);
  if (node < s.nodes())
    gridBarBody(s, t, node);
}

__global__ void scatterBarKernel(Mpm s, int t) {
  followPrevious();
  const int p = int(blockIdx.x * blockDim.x + threadIdx.x);
  if (p < s.count)
    scatterBarBody(s, t, p);
}

__global__ void __launch_bounds__(blockParticles)
    scatterBlockKernel(Mpm s, int t) {
  followPrevious();
  __shared__ Window<3> window;
  const int first = int(blockIdx.x) * blockParticles;
  scatterBlock(s, t, first, min(blockParticles, s.count - first), window);
}

__global__ void __launch_bounds__(blockParticles)
    gatherBarBlockKernel(Mpm s, int t) {
  followPrevious();
  __shared__ Window<2> window;
  const int first = int(blockIdx.x) * blockParticles;
  gatherBarBlock(s, t, first, min(blockParticles, s.count - first), window);
}

__global__ void fusedForwardKernel(Mpm s, int t) {
  followPrevious();
  const int p = int(blockIdx.x * blockDim.x + threadIdx.x);
  if (p >= s.count)
    return;
  Particle own = load(s, t > 0 ? t - 1 : 0, p);
  own.f = s.f[t * s.count + p];
  fusedForward(s, t, p, own);
}

__global__ void fusedBackwardKernel(Mpm s, int t) {
  followPrevious();
  const int p = int(blockIdx.x * blockDim.x + threadIdx.x);
  if (p >= s.count)
    return;
  Particle bar = {s.xBar[p], s.vBar[p], s.cBar[p], s.fBar[p]};
  fusedBackward(s, t, p, bar);
  storeBar(s, p, bar);
}

/// All steps, forward, loss and backward; a particle stays in its thread.
__global__ void __launch_bounds__(64)
    persistentKernel(Mpm s, unsigned *counter) {
  GridBarrier barrier(counter);
  const int p = int(blockIdx.x * blockDim.x + threadIdx.x);
  const bool on = p < s.count;
  Particle own = load(s, 0, on ? p : 0);
  for (int t = 0; t < s.slots; ++t) {
    if (on)
      fusedForward(s, t, p, own);
    if (t < s.slots - 1)
      barrier.wait();
  }
  addLoss(s.loss, on ? lossBody(s, p) : 0.0f);
  Particle bar = {on ? s.xBar[p] : Pair{}, {}, {}, {}};
  for (int t = s.slots - 1; t >= 0; --t) {
    if (on)
      fusedBackward(s, t, p, bar);
    if (t > 0)
      barrier.wait();
  }
  if (on)
    storeBar(s, p, bar);
}

struct Scene {
  Mpm s;
  Buffer<Pair> x, v, velocity, xBar, vBar, velocityBar;
  Buffer<Quad> c, f, grid, cBar, fBar, gridBar;
  Buffer<float> loss;
  Buffer<unsigned> counter;
  cudaStream_t stream;

  Scene(int n, int side, int slots)
      : s(makeMpm(n, side, slots)), x(stored()), v(stored()), velocity(grids()),
        xBar(size_t(s.count)), vBar(size_t(s.count)), velocityBar(grids()),
        c(stored()), f(stored()), grid(grids()), cBar(size_t(s.count)),
        fBar(size_t(s.count)), gridBar(size_t(s.nodes())), loss(1), counter(1) {
    TAI_CHECK(cudaStreamCreate(&stream));
    s.x = x.get(), s.v = v.get(), s.c = c.get(), s.f = f.get();
    s.grid = grid.get(), s.velocity = velocity.get();
    s.xBar = xBar.get(), s.vBar = vBar.get();
    s.cBar = cBar.get(), s.fBar = fBar.get();
    s.velocityBar = velocityBar.get(), s.gridBar = gridBar.get();
    s.loss = loss.get();
    std::vector<Pair> x0, v0;
    std::vector<Quad> f0;
    for (const Particle &own : initialParticles(s, side)) {
      x0.push_back(own.x);
      v0.push_back(own.v);
      f0.push_back(own.f);
    }
    x.set(x0);
    v.set(v0);
    f.set(f0);
  }
  ~Scene() { cudaStreamDestroy(stream); }

  size_t stored() const { return size_t(s.slots) * size_t(s.count); }
  size_t grids() const { return size_t(s.slots - 1) * size_t(s.nodes()); }

  /// The start of every run: zeros on the grids, no loss.
  void clear() {
    grid.clear(stream);
    velocityBar.clear(stream);
    loss.clear(stream);
    counter.clear(stream);
  }

  Outcome outcome() const {
    Outcome result;
    result.loss = loss.values(0, 1)[0];
    for (const Pair &bar : vBar.values(0, size_t(s.count))) {
      result.gradient.push_back(bar.x);
      result.gradient.push_back(bar.y);
    }
    return result;
  }
};

int blocksFor(int count, int threads) {
  return (count + threads - 1) / threads;
}

/// Three kernels a step, and three for its adjoint. The scatters add to memory
/// by whole nodes or by components, or in shared memory first.
enum class Scatter { Whole, Components, Shared };

template <Scatter kind>
void queueStages(Scene &scene, int threads, bool overlapped = false) {
  const Mpm &s = scene.s;
  const int blocks = blocksFor(s.count, threads);
  [[maybe_unused]] const int shared = blocksFor(s.count, blockParticles);
  const int gridThreads = 128, gridBlocks = blocksFor(s.nodes(), gridThreads);
  scene.clear();
  Launcher launch(scene.stream, overlapped);
  for (int t = 0; t < s.slots - 1; ++t) {
    if constexpr (kind == Scatter::Shared)
      launch(scatterBlockKernel, shared, blockParticles, s, t);
    else
      launch(scatterKernel<kind == Scatter::Whole>, blocks, threads, s, t);
    launch(gridKernel, gridBlocks, gridThreads, s, t);
    launch(gatherKernel, blocks, threads, s, t);
  }
  launch(lossKernel, blocks, threads, s);
  for (int t = s.slots - 2; t >= 0; --t) {
    if constexpr (kind == Scatter::Shared)
      launch(gatherBarBlockKernel, shared, blockParticles, s, t);
    else
      launch(gatherBarKernel, blocks, threads, s, t);
    launch(gridBarKernel, gridBlocks, gridThreads, s, t);
    launch(scatterBarKernel, blocks, threads, s, t);
  }
}

void queueFused(Scene &scene, int threads, bool overlapped = false) {
  const Mpm &s = scene.s;
  const int blocks = blocksFor(s.count, threads);
  scene.clear();
  Launcher launch(scene.stream, overlapped);
  for (int t = 0; t < s.slots; ++t)
    launch(fusedForwardKernel, blocks, threads, s, t);
  launch(lossKernel, blocks, threads, s);
  for (int t = s.slots - 1; t >= 0; --t)
    launch(fusedBackwardKernel, blocks, threads, s, t);
}

void queuePersistent(Scene &scene) {
  scene.clear();
  launchTogether(scene.stream, persistentKernel, blocksFor(scene.s.count, 64),
                 64, 0, scene.s, scene.counter.get());
}

template <typename Queue>
void timeGraph(const Options &options, Scene &scene, const char *name,
               const char *variant, const Queue &queue) {
  Graph graph(scene.stream, [&] { queue(); });
  const Times times = measure(scene.stream, options.runs, scene.s.slots - 1,
                              [&] { graph.launch(scene.stream); });
  const Outcome outcome = scene.outcome();
  print(name, variant, "both", times, &outcome);
  outcome.dump(options.dump);
}

int run(const Options &options) {
  const char *small = "diffmpm", *large = "diffmpm_large";
  if (options.wants("graph")) {
    Scene scene(smallNodes, smallSide, smallSlots);
    timeGraph(options, scene, small, "graph",
              [&] { queueStages<Scatter::Whole>(scene, 64); });
  }
  if (options.wants("graph-scalar")) {
    Scene scene(smallNodes, smallSide, smallSlots);
    timeGraph(options, scene, small, "graph-scalar",
              [&] { queueStages<Scatter::Components>(scene, 64); });
  }
  if (options.wants("graph-overlapped")) {
    Scene scene(smallNodes, smallSide, smallSlots);
    timeGraph(options, scene, small, "graph-overlapped",
              [&] { queueStages<Scatter::Whole>(scene, 64, true); });
  }
  if (options.wants("fused-overlapped")) {
    Scene scene(smallNodes, smallSide, smallSlots);
    timeGraph(options, scene, small, "fused-overlapped",
              [&] { queueFused(scene, 64, true); });
  }
  if (options.wants("fused-graph")) {
    Scene scene(smallNodes, smallSide, smallSlots);
    timeGraph(options, scene, small, "fused-graph",
              [&] { queueFused(scene, 64); });
  }
  if (options.wants("persistent")) {
    Scene scene(smallNodes, smallSide, smallSlots);
    const Times times = measure(scene.stream, options.runs, scene.s.slots - 1,
                                [&] { queuePersistent(scene); });
    const Outcome outcome = scene.outcome();
    print(small, "persistent", "both", times, &outcome);
    outcome.dump(options.dump);
  }
  if (options.wants("graph-large")) {
    Scene scene(largeNodes, largeSide, largeSlots);
    timeGraph(options, scene, large, "graph-large",
              [&] { queueStages<Scatter::Whole>(scene, 128); });
  }
  if (options.wants("shared-large")) {
    Scene scene(largeNodes, largeSide, largeSlots);
    timeGraph(options, scene, large, "shared-large",
              [&] { queueStages<Scatter::Shared>(scene, 128); });
  }
  if (options.wants("fused-large")) {
    Scene scene(largeNodes, largeSide, largeSlots);
    timeGraph(options, scene, large, "fused-large",
              [&] { queueFused(scene, 128); });
  }
  return 0;
}

#endif // HOST_CHECK

} // namespace

int main(int argc, char **argv) { return run(parse(argc, argv)); }
