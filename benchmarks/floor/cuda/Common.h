//===- Common.h - Shared parts of the CUDA floors ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The floors are code that a person would write by hand in CUDA C++ for a scene
// of the benchmark and its gradient: f32, adjoints derived by hand. The bodies
// of their kernels are functions for both sides, so that the same formulas can
// be checked on a machine without a GPU: with HOST_CHECK defined, any C++
// compiler makes a program that runs them one after another, on the CPU.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_BENCHMARKS_FLOOR_CUDA_COMMON_H
#define TAI_BENCHMARKS_FLOOR_CUDA_COMMON_H

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#ifdef __CUDACC__
#define TAI_BOTH __host__ __device__ __forceinline__
#else
#define TAI_BOTH inline
#endif

#ifdef __CUDA_ARCH__
#define TAI_UNROLL _Pragma("unroll")
#else
#define TAI_UNROLL
#endif

namespace tai::floor {

struct alignas(8) Pair {
  float x, y;
};

struct alignas(16) Quad {
  float x, y, z, w;
};

/// Adds to memory that other threads may add to as well. The adds of two and
/// four floats are single instructions on compute capability 9.0, for memory of
/// the device; they do not wait for the former value.
TAI_BOTH void addTo(float *p, float v) {
#ifdef __CUDA_ARCH__
  atomicAdd(p, v);
#else
  *p += v;
#endif
}

TAI_BOTH void addTo(Pair *p, Pair v) {
#ifdef __CUDA_ARCH__
  asm volatile("red.relaxed.gpu.global.add.v2.f32 [%0], {%1, %2};" ::"l"(
                   __cvta_generic_to_global(p)),
               "f"(v.x), "f"(v.y)
               : "memory");
#else
  p->x += v.x;
  p->y += v.y;
#endif
}

TAI_BOTH void addTo(Quad *p, Quad v) {
#ifdef __CUDA_ARCH__
  asm volatile(
      "red.relaxed.gpu.global.add.v4.f32 [%0], {%1, %2, %3, %4};" ::"l"(
          __cvta_generic_to_global(p)),
      "f"(v.x), "f"(v.y), "f"(v.z), "f"(v.w)
      : "memory");
#else
  p->x += v.x;
  p->y += v.y;
  p->z += v.z;
  p->w += v.w;
#endif
}

/// Runs `body(k)` for k below `count` on the threads of this block.
template <typename Body> TAI_BOTH void forEach(int count, const Body &body) {
#ifdef __CUDA_ARCH__
  for (int k = int(threadIdx.x); k < count; k += int(blockDim.x))
    body(k);
#else
  for (int k = 0; k < count; ++k)
    body(k);
#endif
}

/// Code behind it sees all earlier writes of the threads of this block.
TAI_BOTH void blockSync() {
#ifdef __CUDA_ARCH__
  __syncthreads();
#endif
}

struct Options {
  int runs = 50;
  bool quick = false;
  /// Where a HOST_CHECK program, or a run, writes its gradient as raw f32.
  std::string dump;
  /// Names of the variants to run; all of them where this is empty.
  std::vector<std::string> only;

  bool wants(const char *name) const {
    for (const std::string &one : only)
      if (one == name)
        return true;
    return only.empty();
  }
};

inline Options parse(int argc, char **argv) {
  Options options;
  for (int i = 1; i < argc; ++i) {
    const std::string argument = argv[i];
    if (argument == "--quick") {
      options.quick = true;
    } else if (argument.rfind("--runs=", 0) == 0) {
      options.runs = std::atoi(argument.c_str() + 7);
    } else if (argument.rfind("--dump=", 0) == 0) {
      options.dump = argument.substr(7);
    } else if (argument.rfind("--", 0) == 0) {
      std::fprintf(
          stderr, "usage: %s [--quick] [--runs=N] [--dump=FILE] [variant...]\n",
          argv[0]);
      std::exit(2);
    } else {
      options.only.push_back(argument);
    }
  }
  if (options.runs < 1)
    options.runs = 1;
  if (options.quick && options.runs > 10)
    options.runs = 10;
  return options;
}

/// Loss and gradient of a run, for comparison with other implementations.
struct Outcome {
  double loss = 0;
  std::vector<float> gradient;

  double norm() const {
    double sum = 0;
    for (float g : gradient)
      sum += double(g) * g;
    return std::sqrt(sum);
  }

  /// Weighted sum that depends on the order: the norm alone would not see
  /// values in the wrong places.
  double probe() const {
    double sum = 0;
    for (size_t k = 0; k < gradient.size(); ++k)
      sum += double(gradient[k]) * std::sin(1.0 + 0.1 * double(k));
    return sum;
  }

  void dump(const std::string &path) const {
    if (path.empty())
      return;
    FILE *file = std::fopen(path.c_str(), "wb");
    if (!file || std::fwrite(gradient.data(), sizeof(float), gradient.size(),
                             file) != gradient.size()) {
      std::fprintf(stderr, "cannot write %s\n", path.c_str());
      std::exit(1);
    }
    std::fclose(file);
  }
};

struct Times {
  double ms = 0, p10 = 0, p90 = 0;
  int n = 0;
};

/// One measurement as a line of JSON; `bytes`, where it is not 0, is the memory
/// traffic of one run.
inline void print(const char *scene, const char *variant, const char *phase,
                  const Times &times, const Outcome *outcome,
                  double bytes = 0) {
  std::printf("{\"peer\": \"floor\", \"version\": \"cuda c++\", \"scene\": "
              "\"%s\", \"variant\": \"%s\", \"phase\": \"%s\", \"ms\": %.6g, "
              "\"p10\": %.6g, \"p90\": %.6g, \"n\": %d",
              scene, variant, phase, times.ms, times.p10, times.p90, times.n);
  if (outcome)
    std::printf(", \"loss\": %.9g, \"gradient_norm\": %.9g, "
                "\"gradient_probe\": %.9g",
                outcome->loss, outcome->norm(), outcome->probe());
  if (bytes > 0)
    std::printf(", \"gb_per_s\": %.6g", bytes / times.ms * 1e-6);
  std::printf("}\n");
  std::fflush(stdout);
}

} // namespace tai::floor

#endif // TAI_BENCHMARKS_FLOOR_CUDA_COMMON_H
