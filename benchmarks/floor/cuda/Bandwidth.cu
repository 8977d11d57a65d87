//===- Bandwidth.cu - copies, maps and stencils ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// bandwidth [--quick] [--runs=N] [variant...]
//
//   copy-engine  cudaMemcpyAsync within the device
//   copy         y = x
//   map          y = 2 x + y
//   stencil      y = x / 2 + (its four neighbours) / 8, inside of the border
//   adjoint      the adjoint of that, added to the adjoint of x
//
// On 16384 x 16384 cells (1 GiB an array), 8192 x 8192 with --quick. Bytes are
// those that must move, each array once; the values are such that f32 holds the
// results exactly, and "loss" is the sum over the row below the middle.
//
//===----------------------------------------------------------------------===//

#include "Device.h"

using namespace tai::floor;

namespace {

constexpr dim3 stencilThreads(32, 8);

__host__ __device__ float valueOfX(int i, int j) {
  return float((i * 7 + j * 3) & 255) / 256.0f;
}
__host__ __device__ float valueOfY(int i, int j) {
  return float((i * 5 + j * 11) & 255) / 256.0f;
}

__global__ void fillKernel(float *x, float *y, int n) {
  const int j = int(blockIdx.x * blockDim.x + threadIdx.x);
  const int i = int(blockIdx.y);
  x[size_t(i) * size_t(n) + size_t(j)] = valueOfX(i, j);
  y[size_t(i) * size_t(n) + size_t(j)] = valueOfY(i, j);
}

__global__ void copyKernel(const float4 *__restrict__ x,
                           float4 *__restrict__ y) {
  const size_t k = size_t(blockIdx.x) * blockDim.x + threadIdx.x;
  y[k] = x[k];
}

__global__ void mapKernel(const float4 *__restrict__ x,
                          float4 *__restrict__ y) {
  const size_t k = size_t(blockIdx.x) * blockDim.x + threadIdx.x;
  const float4 a = x[k], b = y[k];
  y[k] = make_float4(2.0f * a.x + b.x, 2.0f * a.y + b.y, 2.0f * a.z + b.z,
                     2.0f * a.w + b.w);
}

/// Four cells of a row, those above and below, and the two beside them.
struct Patch {
  float own[6], up[4], down[4];

  __device__ Patch(const float *__restrict__ x, int n, int i, int j) {
    const float *row = x + size_t(i) * size_t(n) + size_t(j);
    const float4 zero = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
    const float4 a = *reinterpret_cast<const float4 *>(row);
    const float4 b = i > 0 ? *reinterpret_cast<const float4 *>(row - n) : zero;
    const float4 c =
        i < n - 1 ? *reinterpret_cast<const float4 *>(row + n) : zero;
    own[0] = j > 0 ? row[-1] : 0.0f;
    own[1] = a.x, own[2] = a.y, own[3] = a.z, own[4] = a.w;
    own[5] = j + 4 < n ? row[4] : 0.0f;
    up[0] = b.x, up[1] = b.y, up[2] = b.z, up[3] = b.w;
    down[0] = c.x, down[1] = c.y, down[2] = c.z, down[3] = c.w;
  }
};

__global__ void stencilKernel(const float *__restrict__ x,
                              float *__restrict__ y, int n) {
  const int j = 4 * int(blockIdx.x * blockDim.x + threadIdx.x);
  const int i = int(blockIdx.y * blockDim.y + threadIdx.y);
  if (i == 0 || i == n - 1)
    return;
  const Patch p(x, n, i, j);
  float out[4];
#pragma unroll
  for (int k = 0; k < 4; ++k)
    out[k] = 0.5f * p.own[k + 1] +
             0.125f * (p.up[k] + p.down[k] + p.own[k] + p.own[k + 2]);
  float *to = y + size_t(i) * size_t(n) + size_t(j);
  if (j > 0 && j + 4 < n) {
    *reinterpret_cast<float4 *>(to) =
        make_float4(out[0], out[1], out[2], out[3]);
    return;
  }
#pragma unroll
  for (int k = 0; k < 4; ++k)
    if (j + k > 0 && j + k < n - 1)
      to[k] = out[k];
}

__global__ void adjointKernel(const float *__restrict__ yBar,
                              float *__restrict__ xBar, int n) {
  const int j = 4 * int(blockIdx.x * blockDim.x + threadIdx.x);
  const int i = int(blockIdx.y * blockDim.y + threadIdx.y);
  Patch p(yBar, n, i, j);
  // Cells of the border have no value of y.
  const bool upper = i > 1, lower = i < n - 2, inner = i > 0 && i < n - 1;
#pragma unroll
  for (int k = 0; k < 6; ++k)
    if (!inner || j + k - 1 < 1 || j + k - 1 > n - 2)
      p.own[k] = 0.0f;
#pragma unroll
  for (int k = 0; k < 4; ++k)
    if (j + k < 1 || j + k > n - 2)
      p.up[k] = p.down[k] = 0.0f;
  float4 *to =
      reinterpret_cast<float4 *>(xBar + size_t(i) * size_t(n) + size_t(j));
  const float4 old = *to;
  float out[4];
#pragma unroll
  for (int k = 0; k < 4; ++k)
    out[k] = 0.5f * p.own[k + 1] +
             0.125f * ((upper ? p.up[k] : 0.0f) + (lower ? p.down[k] : 0.0f) +
                       p.own[k] + p.own[k + 2]);
  *to = make_float4(old.x + out[0], old.y + out[1], old.z + out[2],
                    old.w + out[3]);
}

/// The sum over the row below the middle, and that row.
Outcome rowOf(const Buffer<float> &y, int n) {
  Outcome result;
  result.gradient = y.values(size_t(n / 2 + 1) * size_t(n), size_t(n));
  for (float value : result.gradient)
    result.loss += value;
  return result;
}

int run(const Options &options) {
  const int n = options.quick ? 8192 : 16384;
  const size_t count = size_t(n) * size_t(n);
  const double bytes = double(count) * sizeof(float);
  Buffer<float> x(count), y(count);
  cudaStream_t stream;
  TAI_CHECK(cudaStreamCreate(&stream));
  const dim3 grid(unsigned(n / 128), unsigned(n / 8));
  const unsigned flat = unsigned(count / 4 / 256);
  auto *from = reinterpret_cast<float4 *>(x.get());
  auto *to = reinterpret_cast<float4 *>(y.get());
  auto fill = [&] {
    fillKernel<<<dim3(unsigned(n / 256), unsigned(n)), 256, 0, stream>>>(
        x.get(), y.get(), n);
  };
  // The timed work adds up over the runs; the values are those of one run.
  auto time = [&](const char *variant, double arrays, const auto &queue) {
    if (!options.wants(variant))
      return;
    fill();
    const Times times = measure(stream, options.runs, 1.0, queue);
    fill();
    queue();
    TAI_CHECK(cudaStreamSynchronize(stream));
    const Outcome outcome = rowOf(std::strcmp(variant, "adjoint") ? y : x, n);
    print("bandwidth", variant, "forward", times, &outcome, arrays * bytes);
  };
  time("copy-engine", 2, [&] {
    TAI_CHECK(cudaMemcpyAsync(y.get(), x.get(), y.bytes(),
                              cudaMemcpyDeviceToDevice, stream));
  });
  time("copy", 2, [&] { copyKernel<<<flat, 256, 0, stream>>>(from, to); });
  time("map", 3, [&] { mapKernel<<<flat, 256, 0, stream>>>(from, to); });
  time("stencil", 2, [&] {
    stencilKernel<<<grid, stencilThreads, 0, stream>>>(x.get(), y.get(), n);
  });
  time("adjoint", 3, [&] {
    adjointKernel<<<grid, stencilThreads, 0, stream>>>(y.get(), x.get(), n);
  });
  TAI_CHECK(cudaStreamDestroy(stream));
  return 0;
}

} // namespace

int main(int argc, char **argv) { return run(parse(argc, argv)); }
