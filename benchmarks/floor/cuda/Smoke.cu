//===- Smoke.cu - smoke, forward and reverse, by hand ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// smoke [--quick] [--runs=N] [--dump=FILE] [variant...]
//
//   graph             one kernel per operation, in a graph
//   graph-overlapped  the same, each launched while the one before it runs
//   persistent        the operations with barriers over the grid, in one kernel
//   tiled-graph       one kernel per step, of tiles that overlap, in a graph
//   tiled-overlapped  the same, each launched while the one before it runs
//   tiled-persistent  these tiles in one kernel, with a barrier per step
//
// Times are of all steps, forward and backward.
//
//===----------------------------------------------------------------------===//

#include "Smoke.h"

#ifndef HOST_CHECK
#include "Device.h"
#endif

using namespace tai::floor;

namespace {

constexpr size_t storedCells = size_t(smokeSlots) * cells;

#ifdef HOST_CHECK

struct Scene {
  Smoke s;
  std::vector<Pair> v, star, vBar, starBar;
  std::vector<float> density, target, divergence, pressure, densityBar,
      divergenceBar, pressureBar;

  Scene()
      : v(storedCells), star(cells), vBar(storedCells), starBar(cells),
        density(storedCells), divergence(cells), pressure(ring * cells),
        densityBar(storedCells), divergenceBar(cells),
        pressureBar(ring * cells) {
    const SmokeStart start;
    target = start.target;
    for (int cell = 0; cell < cells; ++cell) {
      v[size_t(cell)] = start.v[size_t(cell)];
      density[size_t(cell)] = start.density[size_t(cell)];
    }
    s = {v.data(),           density.data(),
         target.data(),      star.data(),
         divergence.data(),  pressure.data(),
         vBar.data(),        densityBar.data(),
         starBar.data(),     divergenceBar.data(),
         pressureBar.data(), nullptr};
  }

  Outcome outcome(double loss) const {
    Outcome result;
    result.loss = loss;
    for (int cell = 0; cell < cells; ++cell) {
      result.gradient.push_back(vBar[size_t(cell)].x);
      result.gradient.push_back(vBar[size_t(cell)].y);
    }
    return result;
  }
};

template <typename Body> void forCells(const Body &body) {
  for (int cell = 0; cell < cells; ++cell)
    body(cell);
}

Outcome runOperations(Scene &scene) {
  const Smoke &s = scene.s;
  for (int t = 1; t < smokeSlots; ++t) {
    forCells([&](int cell) { advectVelocity(s, t, cell); });
    forCells([&](int cell) { diverge(s, cell); });
    for (int k = t * sweeps; k < (t + 1) * sweeps; ++k)
      forCells([&](int cell) { relax(s, k, cell); });
    forCells([&](int cell) { project(s, t, cell); });
    forCells([&](int cell) { advectDensity(s, t, cell); });
  }
  double loss = 0;
  forCells([&](int cell) { loss += lossBody(s, cell); });
  for (int t = smokeSlots - 1; t > 0; --t) {
    forCells([&](int cell) { densityBarBody(s, t, cell); });
    forCells([&](int cell) { projectBar(s, t, cell); });
    for (int k = (t + 1) * sweeps - 1; k >= t * sweeps; --k)
      forCells([&](int cell) { relaxBar(s, k, cell); });
    forCells([&](int cell) { divergeBar(s, t, cell); });
    forCells([&](int cell) { advectVelocityBar(s, t, cell); });
  }
  return scene.outcome(loss);
}

Outcome runTiles(Scene &scene) {
  const Smoke &s = scene.s;
  TileMemory memory;
  for (int t = 1; t < smokeSlots; ++t)
    for (int tile = 0; tile < tiles; ++tile)
      forwardTile(s, t, tile, memory);
  double loss = 0;
  forCells([&](int cell) { loss += lossBody(s, cell); });
  for (int t = smokeSlots - 1; t > 0; --t)
    for (int tile = 0; tile < tiles; ++tile)
      backwardTile(s, t, tile, memory);
  return scene.outcome(loss);
}

int run(const Options &options) {
  for (const char *variant : {"graph", "tiled-graph"}) {
    if (!options.wants(variant))
      continue;
    Scene scene;
    const Outcome outcome =
        variant[0] == 'g' ? runOperations(scene) : runTiles(scene);
    print("smoke", variant, "check", {}, &outcome);
    outcome.dump(options.dump);
  }
  return 0;
}

#else // HOST_CHECK

constexpr int threads = 128, blocks = (cells + threads - 1) / threads;
constexpr int tileThreads = 512;

/// The work of a kernel of one operation. The number is t or, for the sweeps,
/// k.
enum class Operation {
  AdvectVelocity,
  Diverge,
  Relax,
  Project,
  AdvectDensity,
  DensityBar,
  ProjectBar,
  RelaxBar,
  DivergeBar,
  AdvectVelocityBar
};

template <Operation operation>
__device__ __forceinline__ void perform(const Smoke &s, int number, int cell) {
  if constexpr (operation == Operation::AdvectVelocity)
    advectVelocity(s, number, cell);
  else if constexpr (operation == Operation::Diverge)
    diverge(s, cell);
  else if constexpr (operation == Operation::Relax)
    relax(s, number, cell);
  else if constexpr (operation == Operation::Project)
    project(s, number, cell);
  else if constexpr (operation == Operation::AdvectDensity)
    advectDensity(s, number, cell);
  else if constexpr (operation == Operation::DensityBar)
    densityBarBody(s, number, cell);
  else if constexpr (operation == Operation::ProjectBar)
    projectBar(s, number, cell);
  else if constexpr (operation == Operation::RelaxBar)
    relaxBar(s, number, cell);
  else if constexpr (operation == Operation::DivergeBar)
    divergeBar(s, number, cell);
  else
    advectVelocityBar(s, number, cell);
}

template <Operation operation>
__global__ void operationKernel(Smoke s, int number) {
  followPrevious();
  const int cell = int(blockIdx.x * blockDim.x + threadIdx.x);
  if (cell < cells)
    perform<operation>(s, number, cell);
}

__device__ void addLoss(const Smoke &s, int cell) {
  float part = cell < cells ? lossBody(s, cell) : 0.0f;
  for (int lane = 16; lane > 0; lane /= 2)
    part += __shfl_xor_sync(0xffffffffu, part, lane);
  if (threadIdx.x % 32 == 0)
    atomicAdd(s.loss, part);
}

__global__ void lossKernel(Smoke s) {
  followPrevious();
  addLoss(s, int(blockIdx.x * blockDim.x + threadIdx.x));
}

/// One operation and a barrier after it.
template <Operation operation>
__device__ __forceinline__ void stage(const Smoke &s, int number, int cell,
                                      GridBarrier &barrier) {
  if (cell < cells)
    perform<operation>(s, number, cell);
  barrier.wait();
}

__global__ void __launch_bounds__(threads)
    persistentKernel(Smoke s, unsigned *counter) {
  GridBarrier barrier(counter);
  const int cell = int(blockIdx.x * blockDim.x + threadIdx.x);
  for (int t = 1; t < smokeSlots; ++t) {
    stage<Operation::AdvectVelocity>(s, t, cell, barrier);
    stage<Operation::Diverge>(s, t, cell, barrier);
    for (int k = t * sweeps; k < (t + 1) * sweeps; ++k)
      stage<Operation::Relax>(s, k, cell, barrier);
    // The density is advected with the velocity of its own cell.
    if (cell < cells)
      project(s, t, cell);
    stage<Operation::AdvectDensity>(s, t, cell, barrier);
  }
  addLoss(s, cell);
  for (int t = smokeSlots - 1; t > 0; --t) {
    stage<Operation::DensityBar>(s, t, cell, barrier);
    if (cell < cells)
      projectBar(s, t, cell);
    for (int k = (t + 1) * sweeps - 1; k >= t * sweeps; --k)
      stage<Operation::RelaxBar>(s, k, cell, barrier);
    if (cell < cells)
      divergeBar(s, t, cell);
    stage<Operation::AdvectVelocityBar>(s, t, cell, barrier);
  }
}

__global__ void __launch_bounds__(tileThreads)
    forwardTileKernel(Smoke s, int t) {
  followPrevious();
  __shared__ TileMemory memory;
  forwardTile(s, t, int(blockIdx.x), memory);
}

__global__ void __launch_bounds__(tileThreads)
    backwardTileKernel(Smoke s, int t) {
  followPrevious();
  __shared__ TileMemory memory;
  backwardTile(s, t, int(blockIdx.x), memory);
}

__global__ void __launch_bounds__(tileThreads)
    persistentTileKernel(Smoke s, unsigned *counter) {
  __shared__ TileMemory memory;
  GridBarrier barrier(counter);
  const int tile = int(blockIdx.x);
  for (int t = 1; t < smokeSlots; ++t) {
    forwardTile(s, t, tile, memory);
    barrier.wait();
  }
  addLoss(s, int(blockIdx.x * blockDim.x + threadIdx.x));
  barrier.wait();
  for (int t = smokeSlots - 1; t > 0; --t) {
    backwardTile(s, t, tile, memory);
    if (t > 1)
      barrier.wait();
  }
}

struct Scene {
  SmokeStart start;
  Buffer<Pair> v{storedCells}, star{cells}, vBar{storedCells}, starBar{cells};
  Buffer<float> density{storedCells}, target{start.target}, divergence{cells},
      pressure{ring * cells}, densityBar{storedCells}, divergenceBar{cells},
      pressureBar{ring * cells}, loss{1};
  Buffer<unsigned> counter{1};
  Smoke s;
  cudaStream_t stream;

  Scene() {
    TAI_CHECK(cudaStreamCreate(&stream));
    v.set(start.v);
    density.set(start.density);
    s = {v.get(),           density.get(),
         target.get(),      star.get(),
         divergence.get(),  pressure.get(),
         vBar.get(),        densityBar.get(),
         starBar.get(),     divergenceBar.get(),
         pressureBar.get(), loss.get()};
  }
  ~Scene() { cudaStreamDestroy(stream); }

  void clear() {
    pressure.clear(stream);
    vBar.clear(stream);
    densityBar.clear(stream);
    pressureBar.clear(stream);
    loss.clear(stream);
    counter.clear(stream);
  }

  Outcome outcome() const {
    Outcome result;
    result.loss = loss.values(0, 1)[0];
    for (const Pair &bar : vBar.values(0, cells)) {
      result.gradient.push_back(bar.x);
      result.gradient.push_back(bar.y);
    }
    return result;
  }
};

void queueOperations(Scene &scene, bool overlapped) {
  scene.clear();
  const Smoke &s = scene.s;
  Launcher launch(scene.stream, overlapped);
  auto queue = [&](void (*kernel)(Smoke, int), int number) {
    launch(kernel, blocks, threads, s, number);
  };
  for (int t = 1; t < smokeSlots; ++t) {
    queue(operationKernel<Operation::AdvectVelocity>, t);
    queue(operationKernel<Operation::Diverge>, t);
    for (int k = t * sweeps; k < (t + 1) * sweeps; ++k)
      queue(operationKernel<Operation::Relax>, k);
    queue(operationKernel<Operation::Project>, t);
    queue(operationKernel<Operation::AdvectDensity>, t);
  }
  launch(lossKernel, blocks, threads, s);
  for (int t = smokeSlots - 1; t > 0; --t) {
    queue(operationKernel<Operation::DensityBar>, t);
    queue(operationKernel<Operation::ProjectBar>, t);
    for (int k = (t + 1) * sweeps - 1; k >= t * sweeps; --k)
      queue(operationKernel<Operation::RelaxBar>, k);
    queue(operationKernel<Operation::DivergeBar>, t);
    queue(operationKernel<Operation::AdvectVelocityBar>, t);
  }
}

void queueTiles(Scene &scene, bool overlapped) {
  scene.clear();
  const Smoke &s = scene.s;
  Launcher launch(scene.stream, overlapped);
  for (int t = 1; t < smokeSlots; ++t)
    launch(forwardTileKernel, tiles, tileThreads, s, t);
  launch(lossKernel, blocks, threads, s);
  for (int t = smokeSlots - 1; t > 0; --t)
    launch(backwardTileKernel, tiles, tileThreads, s, t);
}

template <typename Queue>
void report(const Options &options, Scene &scene, const char *variant,
            const Queue &queue) {
  const Times times = measure(scene.stream, options.runs, 1.0, queue);
  const Outcome outcome = scene.outcome();
  print("smoke", variant, "both", times, &outcome);
  outcome.dump(options.dump);
}

int run(const Options &options) {
  Scene scene;
  if (options.wants("graph")) {
    Graph graph(scene.stream, [&] { queueOperations(scene, false); });
    report(options, scene, "graph", [&] { graph.launch(scene.stream); });
  }
  if (options.wants("graph-overlapped")) {
    Graph graph(scene.stream, [&] { queueOperations(scene, true); });
    report(options, scene, "graph-overlapped",
           [&] { graph.launch(scene.stream); });
  }
  if (options.wants("persistent"))
    report(options, scene, "persistent", [&] {
      scene.clear();
      launchTogether(scene.stream, persistentKernel, blocks, threads, 0,
                     scene.s, scene.counter.get());
    });
  if (options.wants("tiled-graph")) {
    Graph graph(scene.stream, [&] { queueTiles(scene, false); });
    report(options, scene, "tiled-graph", [&] { graph.launch(scene.stream); });
  }
  if (options.wants("tiled-overlapped")) {
    Graph graph(scene.stream, [&] { queueTiles(scene, true); });
    report(options, scene, "tiled-overlapped",
           [&] { graph.launch(scene.stream); });
  }
  if (options.wants("tiled-persistent"))
    report(options, scene, "tiled-persistent", [&] {
      scene.clear();
      launchTogether(scene.stream, persistentTileKernel, tiles, tileThreads, 0,
                     scene.s, scene.counter.get());
    });
  return 0;
}

#endif // HOST_CHECK

} // namespace

int main(int argc, char **argv) { return run(parse(argc, argv)); }
