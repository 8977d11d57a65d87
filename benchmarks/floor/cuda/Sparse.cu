//===- Sparse.cu - a stencil on the active blocks of a grid ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// sparse [--quick] [--runs=N] [variant...]
//
//   dense      y = x / 2 + (four neighbours) / 8 on all 16384 x 16384 cells
//   active-1, active-10, active-100
//              on a square that covers that share of the cells in per cent, in
//              blocks of 8 x 8 cells from a pool; a table knows the block of a
//              place, a list the places that have one
//
// "loss" is the sum of y over the row in the middle of the square.
//
//===----------------------------------------------------------------------===//

#include "Device.h"

using namespace tai::floor;

namespace {

constexpr int edge = 8, blockCells = edge * edge;

__host__ __device__ float valueOfX(int i, int j) {
  return float((i * 7 + j * 3) & 255) / 256.0f;
}

struct Grid {
  int n, side;
  /// Number of the block at a place, or -1.
  int *table;
  /// Place of each block.
  int *list;
  float *x, *y;

  __host__ __device__ int across() const { return n / edge; }

  __device__ float at(int i, int j) const {
    const int block = table[i / edge * across() + j / edge];
    if (block < 0)
      return 0.0f;
    return x[size_t(block) * blockCells + size_t(i % edge * edge + j % edge)];
  }
};

__global__ void fillKernel(Grid g, int blocks) {
  const int block = int(blockIdx.x * blockDim.y + threadIdx.y);
  if (block >= blocks)
    return;
  const int place = g.list[block], cell = int(threadIdx.x);
  const int i = place / g.across() * edge + cell / edge,
            j = place % g.across() * edge + cell % edge;
  g.x[size_t(block) * blockCells + size_t(cell)] = valueOfX(i, j);
}

/// 64 threads for a block of cells, four such blocks together.
__global__ void activeKernel(Grid g, int blocks) {
  const int block = int(blockIdx.x * blockDim.y + threadIdx.y);
  if (block >= blocks)
    return;
  const int place = g.list[block], cell = int(threadIdx.x);
  const int row = cell / edge, column = cell % edge;
  const int i = place / g.across() * edge + row,
            j = place % g.across() * edge + column;
  if (i == 0 || i == g.n - 1 || j == 0 || j == g.n - 1)
    return;
  const size_t own = size_t(block) * blockCells + size_t(cell);
  const float *x = g.x + own;
  const float near = (row > 0 ? x[-edge] : g.at(i - 1, j)) +
                     (row < edge - 1 ? x[edge] : g.at(i + 1, j)) +
                     (column > 0 ? x[-1] : g.at(i, j - 1)) +
                     (column < edge - 1 ? x[1] : g.at(i, j + 1));
  g.y[own] = 0.5f * *x + 0.125f * near;
}

__global__ void fillDenseKernel(float *x, int n) {
  const int j = int(blockIdx.x * blockDim.x + threadIdx.x), i = int(blockIdx.y);
  x[size_t(i) * size_t(n) + size_t(j)] = valueOfX(i, j);
}

__global__ void denseKernel(const float *__restrict__ x, float *__restrict__ y,
                            int n) {
  const int j = int(blockIdx.x * blockDim.x + threadIdx.x),
            i = int(blockIdx.y * blockDim.y + threadIdx.y);
  if (i == 0 || i == n - 1 || j == 0 || j == n - 1)
    return;
  const size_t at = size_t(i) * size_t(n) + size_t(j);
  y[at] = 0.5f * x[at] + 0.125f * (x[at - size_t(n)] + x[at + size_t(n)] +
                                   x[at - 1] + x[at + 1]);
}

void timeDense(const Options &options, int n, cudaStream_t stream) {
  if (!options.wants("dense"))
    return;
  const size_t count = size_t(n) * size_t(n);
  Buffer<float> x(count), y(count);
  fillDenseKernel<<<dim3(unsigned(n / 256), unsigned(n)), 256, 0, stream>>>(
      x.get(), n);
  const Times times = measure(stream, options.runs, 1.0, [&] {
    denseKernel<<<dim3(unsigned(n / 64), unsigned(n / 4)), dim3(64, 4), 0,
                  stream>>>(x.get(), y.get(), n);
  });
  Outcome outcome;
  outcome.gradient = y.values(size_t(n / 2) * size_t(n), size_t(n));
  for (float value : outcome.gradient)
    outcome.loss += value;
  print("sparse", "dense", "forward", times, &outcome,
        2.0 * double(count) * sizeof(float));
}

void timeActive(const Options &options, int n, double share, const char *name,
                cudaStream_t stream) {
  if (!options.wants(name))
    return;
  const int side = int(std::lround(n * std::sqrt(share) / edge)) * edge;
  const int across = n / edge, blocksAcross = side / edge;
  std::vector<int> table(size_t(across) * size_t(across), -1), list;
  for (int i = 0; i < blocksAcross; ++i)
    for (int j = 0; j < blocksAcross; ++j) {
      table[size_t(i) * size_t(across) + size_t(j)] = int(list.size());
      list.push_back(i * across + j);
    }
  const int blocks = int(list.size());
  Buffer<int> deviceTable(table), deviceList(list);
  Buffer<float> x(size_t(blocks) * blockCells), y(size_t(blocks) * blockCells);
  const Grid g = {n,       side,   deviceTable.get(), deviceList.get(),
                  x.get(), y.get()};
  const dim3 threads(blockCells, 4);
  const unsigned groups = unsigned(blocks + 3) / 4;
  fillKernel<<<groups, threads, 0, stream>>>(g, blocks);
  const Times times = measure(stream, options.runs, 1.0, [&] {
    activeKernel<<<groups, threads, 0, stream>>>(g, blocks);
  });
  Outcome outcome;
  const int row = side / 2;
  for (int j = 0; j < blocksAcross; ++j) {
    const int block = table[size_t(row / edge) * size_t(across) + size_t(j)];
    for (float value :
         y.values(size_t(block) * blockCells + size_t(row % edge * edge), edge))
      outcome.gradient.push_back(value);
  }
  for (float value : outcome.gradient)
    outcome.loss += value;
  print("sparse", name, "forward", times, &outcome,
        2.0 * double(blocks) * blockCells * sizeof(float));
}

int run(const Options &options) {
  const int n = options.quick ? 8192 : 16384;
  cudaStream_t stream;
  TAI_CHECK(cudaStreamCreate(&stream));
  timeDense(options, n, stream);
  timeActive(options, n, 0.01, "active-1", stream);
  timeActive(options, n, 0.1, "active-10", stream);
  timeActive(options, n, 1.0, "active-100", stream);
  TAI_CHECK(cudaStreamDestroy(stream));
  return 0;
}

} // namespace

int main(int argc, char **argv) { return run(parse(argc, argv)); }
