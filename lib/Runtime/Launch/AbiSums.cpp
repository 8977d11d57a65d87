//===- AbiSums.cpp - Adding private buffers to fields ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Functions that compiled kernels call when the partitions of a loop have added
// to private buffers. An element that no iteration added to costs only one
// read: most elements of a grid around particles are of this kind.
//
//===----------------------------------------------------------------------===//

#include "tai/ABI/Abi.h"
#include "tai/ABI/SumModes.h"
#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Launch/ShadowLog.h"
#include "tai/Runtime/Storage/Scalars.h"
#include "tai/Runtime/Threads/FixedParts.h"
#include <algorithm>
#include <cmath>

using namespace mlir::tai::runtime;

namespace {
/// The type of functions that add elements [begin, end) of all `parts` private
/// buffers to the target. `count`: the number of elements of a buffer.
using AddBuffers = void (*)(void *target, char *buffers, int64_t begin,
                            int64_t end, int64_t parts, int64_t stride,
                            int64_t count);

struct Combining {
  void *target;
  char *buffers;
  int64_t count, parts, stride, cuts;
  AddBuffers add;
};
} // namespace

namespace {
/// A 16-bit float in memory.
template <double (*extend)(uint16_t), uint16_t (*truncate)(double)>
struct Float16Bits {
  uint16_t bits;
  explicit Float16Bits(double value) : bits(truncate(value)) {}
  operator double() const { return extend(bits); }
};
using Half = Float16Bits<doubleFromHalf, halfFromDouble>;
using Bfloat = Float16Bits<doubleFromBfloat, bfloatFromDouble>;
} // namespace

/// True if some element is not zero. Has no branch for each element, so that
/// the comparisons are vectorized.
template <typename T>
__attribute__((always_inline)) static inline bool isAnyNonZero(const T *from,
                                                               int64_t count) {
  bool isAny = false;
  for (int64_t e = 0; e < count; ++e)
    isAny |= from[e] != 0;
  return isAny;
}

/// Adds a block of a buffer to `sums` (if `isFirst`, copies the block there),
/// and fills the block with zeros. Returns false if the block held only zeros.
template <typename T>
__attribute__((always_inline)) static inline bool
moveBlock(T *from, int64_t count, T *sums, bool isFirst) {
  if (!isAnyNonZero(from, count))
    return false;
  if (isFirst)
    std::copy_n(from, count, sums);
  else
    for (int64_t e = 0; e < count; ++e)
      sums[e] += from[e];
  std::fill_n(from, count, T(0));
  return true;
}

/// Returns `to` + `sum`. If the sum is zero, `to` is returned unchanged, so
/// that -0 remains -0, as it does when blocks of zeros are skipped.
template <typename Target, typename T>
__attribute__((always_inline)) static inline Target added(Target to, T sum) {
  return sum == 0 ? to : static_cast<Target>(to + sum);
}

/// True if private buffers are so small that the next launch zeroes them, which
/// takes less time than searching them for elements that are not zero.
static bool areFew(int64_t bytes) { return bytes <= 8 << 10; }

/// Adds all elements of small buffers (see areFew) and leaves the buffers as
/// they are.
template <typename Target, typename T>
static void addFew(Target *target, const char *buffers, int64_t count,
                   int64_t parts, int64_t stride) {
  for (int64_t e = 0; e < count; ++e) {
    T sum = reinterpret_cast<const T *>(buffers)[e];
    for (int64_t p = 1; p < parts; ++p)
      sum += reinterpret_cast<const T *>(buffers + p * stride)[e];
    target[e] = added(target[e], sum);
  }
}

/// Adds elements [begin, end) of all buffers to the target. The sum of the
/// buffers is formed first, in their order, in blocks that stay in the
/// first-level cache.
template <typename Target, typename T>
__attribute__((always_inline)) static inline void
addBuffers(void *targetBytes, char *buffers, int64_t begin, int64_t end,
           int64_t parts, int64_t stride, int64_t count) {
  constexpr int64_t block = 1024;
  T sums[block];
  Target *target = static_cast<Target *>(targetBytes);
  if (areFew(stride * parts))
    return addFew<Target, T>(target, buffers, count, parts, stride);
  for (int64_t at = begin; at < end; at += block) {
    int64_t length = std::min(block, end - at);
    bool isAny = false;
    for (int64_t p = 0; p < parts; ++p)
      isAny |= moveBlock(reinterpret_cast<T *>(buffers + p * stride) + at,
                         length, sums, !isAny);
    if (isAny)
      for (int64_t e = 0; e < length; ++e)
        target[at + e] = added(target[at + e], sums[e]);
  }
}

/// Adds elements [begin, end) of all private buffers of compensated sums, and
/// rounds each result once. A buffer holds `count` sums, and then their
/// rounding errors.
__attribute__((always_inline)) static inline void
addPairs(void *targetBytes, char *buffers, int64_t begin, int64_t end,
         int64_t parts, int64_t stride, int64_t count) {
  constexpr int64_t block = 512;
  double sums[block], rests[block];
  auto add = [&](int64_t e, double x, double rest) {
    double next = sums[e] + x, taken = next - sums[e];
    rests[e] += (sums[e] - (next - taken)) + (x - taken) + rest;
    sums[e] = next;
  };
  double *target = static_cast<double *>(targetBytes);
  for (int64_t at = begin; at < end; at += block) {
    int64_t length = std::min(block, end - at);
    bool isAny = false;
    for (int64_t p = 0; p < parts; ++p) {
      double *from = reinterpret_cast<double *>(buffers + p * stride) + at;
      double *lost = from + count;
      if (!isAnyNonZero(from, length) && !isAnyNonZero(lost, length))
        continue;
      for (int64_t e = 0; e < length; ++e)
        if (!isAny) {
          sums[e] = from[e];
          rests[e] = lost[e];
        } else {
          add(e, from[e], lost[e]);
        }
      std::fill_n(from, length, 0.0);
      std::fill_n(lost, length, 0.0);
      isAny = true;
    }
    if (!isAny)
      continue;
    for (int64_t e = 0; e < length; ++e) {
      bool isNothing = sums[e] == 0 && rests[e] == 0;
      double old = target[at + e];
      add(e, old, 0);
      // The rounding error of an infinite sum is NaN, and counts as zero.
      double sum = sums[e] + (std::isnan(rests[e]) ? 0 : rests[e]);
      target[at + e] = isNothing ? old : sum;
    }
  }
}

/// The size in bytes of an element of the field to which sums of this kind are
/// added.
static int64_t sizeOfTarget(int32_t kind) {
  switch (kind) {
  case kSumsF16:
  case kSumsBF16:
    return 2;
  case kSumsF64:
  case kSumsPairs:
  case kSumsI64:
    return sizeof(double);
  default:
    return sizeof(float);
  }
}

/// The size in bytes of an element of the private buffers for sums of this
/// kind.
static int64_t sizeOfSums(int32_t kind) {
  switch (kind) {
  case kSumsF32:
  case kSumsI32:
    return sizeof(float);
  case kSumsPairs:
    return 2 * sizeof(double);
  default:
    return sizeof(double);
  }
}

// Variants of the sum functions for AVX2, chosen at run time; all variants
// compute the same sums.
#if defined(__x86_64__)
#define TAI_ADD_BUFFERS(name, target_type, type, unit)                         \
  __attribute__((target(unit))) static void name(                              \
      void *to, char *buffers, int64_t begin, int64_t end, int64_t parts,      \
      int64_t stride, int64_t count) {                                         \
    addBuffers<target_type, type>(to, buffers, begin, end, parts, stride,      \
                                  count);                                      \
  }
TAI_ADD_BUFFERS(addF32Avx2, float, float, "avx2")
TAI_ADD_BUFFERS(addF64Avx2, double, double, "avx2")
TAI_ADD_BUFFERS(addWideAvx2, float, double, "avx2")
TAI_ADD_BUFFERS(addI32Avx2, uint32_t, uint32_t, "avx2")
TAI_ADD_BUFFERS(addI64Avx2, uint64_t, uint64_t, "avx2")
#undef TAI_ADD_BUFFERS
__attribute__((target("avx2"))) static void
addPairsAvx2(void *to, char *buffers, int64_t begin, int64_t end, int64_t parts,
             int64_t stride, int64_t count) {
  addPairs(to, buffers, begin, end, parts, stride, count);
}
#endif

/// Calls `add`, which adds `parts` private buffers to the `count` numbers at
/// addressOf(0), addressOf(1), ..., and adds the shadows of the buffers to the
/// numbers' shadows.
template <typename Target, typename T, typename AddressOf, typename Add>
static void addWithShadows(int64_t count, int64_t parts, char *buffers,
                           int64_t stride, AddressOf addressOf, Add add) {
  std::vector<long double> sums(static_cast<size_t>(count));
  for (int64_t e = 0; e < count; ++e) {
    auto *target = reinterpret_cast<Target *>(addressOf(e));
    long double sum = shadow::read(target, *target);
    for (int64_t p = 0; p < parts; ++p) {
      const T *from = reinterpret_cast<const T *>(buffers + p * stride) + e;
      sum += shadow::read(from, *from);
    }
    sums[static_cast<size_t>(e)] = sum;
  }
  add();
  for (int64_t e = 0; e < count; ++e) {
    auto *target = reinterpret_cast<Target *>(addressOf(e));
    shadow::write(target, *target, sums[static_cast<size_t>(e)]);
  }
}

/// Calls `add`; if the kernels of the context have shadows, through
/// addWithShadows with the types of `kind`.
template <typename AddressOf, typename Add>
static void addBuffersOf(Launch &launch, int32_t kind, int64_t count,
                         int64_t parts, char *buffers, int64_t stride,
                         AddressOf addressOf, Add add) {
  // Compensated sums have no shadows in memory, because they are two numbers
  // each; nor have fields of 16 bits and of integers.
  if (__builtin_expect(!launch.owner().options().instruments.shadow, true) ||
      kind == kSumsPairs || sizeOfTarget(kind) == 2 || kind == kSumsI32 ||
      kind == kSumsI64)
    return add();
  if (kind == kSumsF32)
    return addWithShadows<float, float>(count, parts, buffers, stride,
                                        addressOf, add);
  if (kind == kSumsF64)
    return addWithShadows<double, double>(count, parts, buffers, stride,
                                          addressOf, add);
  addWithShadows<float, double>(count, parts, buffers, stride, addressOf, add);
}

static AddBuffers chooseAdd(int32_t kind) {
  if (kind == kSumsF16)
    return addBuffers<Half, double>;
  if (kind == kSumsBF16)
    return addBuffers<Bfloat, double>;
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2"))
    return kind == kSumsF32     ? addF32Avx2
           : kind == kSumsF64   ? addF64Avx2
           : kind == kSumsPairs ? addPairsAvx2
           : kind == kSumsI32   ? addI32Avx2
           : kind == kSumsI64   ? addI64Avx2
                                : addWideAvx2;
#endif
  return kind == kSumsF32     ? addBuffers<float, float>
         : kind == kSumsF64   ? addBuffers<double, double>
         : kind == kSumsPairs ? addPairs
         : kind == kSumsI32   ? addBuffers<uint32_t, uint32_t>
         : kind == kSumsI64   ? addBuffers<uint64_t, uint64_t>
                              : addBuffers<float, double>;
}

/// Marks buffers that moveBlock has filled with zeros, so that the next launch
/// need not zero them. With shadows, the buffers stay dirty: allocating dirty
/// memory also discards its shadows.
static void left(Launch &launch, const void *buffers, int64_t bytes) {
  if (!launch.owner().options().instruments.shadow && !areFew(bytes))
    launch.arena.markZero(static_cast<const char *>(buffers), bytes);
}

extern "C" void tai_rt_combine(TaiFrame *frame, void *target, void *buffers,
                               int64_t count, int64_t parts, int32_t kind) {
  Launch &launch = launchOf(frame);
  // After a failure of the launch, `buffers` may be memory without meaning: see
  // Launch::sink.
  if (count <= 0 || parts <= 0 || launch.hasFailed())
    return;
  int64_t size = sizeOfSums(kind);
  int64_t targetBytes = sizeOfTarget(kind);
  int64_t stride = (count * size + 63) / 64 * 64;
  // The number of bytes that one worker thread must read to be worth the cost
  // of the fork.
  constexpr int64_t cutBytes = 64 << 10;
  int64_t cuts = std::clamp<int64_t>(count * size / cutBytes * parts, 1,
                                     launch.owner().threads());
  Combining combining{
      target,         static_cast<char *>(buffers), count, parts, stride, cuts,
      chooseAdd(kind)};
  auto run = [](void *context, int64_t cut) {
    Combining &c = *static_cast<Combining *>(context);
    c.add(c.target, c.buffers, boundOf(c.count, cut, c.cuts),
          boundOf(c.count, cut + 1, c.cuts), c.parts, c.stride, c.count);
  };
  orFail(frame, [&] {
    addBuffersOf(
        launch, kind, count, parts, combining.buffers, stride,
        [&](int64_t e) {
          return static_cast<char *>(target) + e * targetBytes;
        },
        [&] {
          if (cuts == 1)
            run(&combining, 0);
          else
            launch.owner().workers().parallel(cuts, run, &combining);
        });
  });
  left(launch, buffers, stride * parts);
}

namespace {
struct StridedCombining {
  char *target;
  char *buffers;
  int64_t cells, components, targetStride, parts, bufferStride, cuts;
};
} // namespace

/// Adds the private buffers to the cells of partition `cut`, in the order of
/// the buffers.
template <typename Target, typename T>
static void addStrided(void *context, int64_t cut) {
  const auto &c = *static_cast<StridedCombining *>(context);
  int64_t begin = boundOf(c.cells, cut, c.cuts);
  int64_t end = boundOf(c.cells, cut + 1, c.cuts);
  constexpr int64_t block = 1024;
  T sums[block];
  // A block of this loop holds whole cells, or a part of one cell that has more
  // components than the block has elements.
  int64_t cellsInBlock = std::max<int64_t>(block / c.components, 1);
  for (int64_t at = begin; at < end; at += cellsInBlock) {
    int64_t cells = std::min(cellsInBlock, end - at);
    for (int64_t first = 0; first < c.components; first += block) {
      int64_t width = std::min(c.components - first, block);
      int64_t count = cells * width;
      bool isAny = false;
      for (int64_t p = 0; p < c.parts; ++p)
        isAny |=
            moveBlock(reinterpret_cast<T *>(c.buffers + p * c.bufferStride) +
                          at * c.components + first,
                      count, sums, !isAny);
      for (int64_t cell = 0; isAny && cell < cells; ++cell) {
        Target *to = reinterpret_cast<Target *>(c.target +
                                                (at + cell) * c.targetStride) +
                     first;
        for (int64_t e = 0; e < width; ++e)
          to[e] = added(to[e], sums[cell * width + e]);
      }
    }
  }
}

static void addStridedPairs(void *context, int64_t cut) {
  const auto &c = *static_cast<StridedCombining *>(context);
  int64_t end = boundOf(c.cells, cut + 1, c.cuts);
  for (int64_t cell = boundOf(c.cells, cut, c.cuts); cell < end; ++cell)
    addPairs(c.target + cell * c.targetStride,
             c.buffers + cell * c.components * sizeof(double), 0, c.components,
             c.parts, c.bufferStride, c.cells * c.components);
}

extern "C" void tai_rt_combine_strided(TaiFrame *frame, void *target,
                                       void *buffers, int64_t cells,
                                       int64_t components, int64_t stride,
                                       int64_t parts, int32_t kind) {
  Launch &launch = launchOf(frame);
  if (cells <= 0 || components <= 0 || parts <= 0 || launch.hasFailed())
    return;
  int64_t bytes = cells * components * sizeOfSums(kind);
  constexpr int64_t cutBytes = 64 << 10;
  int64_t cuts = std::clamp<int64_t>(bytes / cutBytes * parts, 1,
                                     launch.owner().threads());
  StridedCombining combining{static_cast<char *>(target),
                             static_cast<char *>(buffers),
                             cells,
                             components,
                             stride,
                             parts,
                             (bytes + 63) / 64 * 64,
                             cuts};
  auto run = kind == kSumsF32     ? addStrided<float, float>
             : kind == kSumsF64   ? addStrided<double, double>
             : kind == kSumsPairs ? addStridedPairs
             : kind == kSumsF16   ? addStrided<Half, double>
             : kind == kSumsBF16  ? addStrided<Bfloat, double>
             : kind == kSumsI32   ? addStrided<uint32_t, uint32_t>
             : kind == kSumsI64   ? addStrided<uint64_t, uint64_t>
                                  : addStrided<float, double>;
  int64_t targetBytes = sizeOfTarget(kind);
  orFail(frame, [&] {
    addBuffersOf(
        launch, kind, cells * components, parts, combining.buffers,
        combining.bufferStride,
        [&](int64_t e) {
          return combining.target + e / components * stride +
                 e % components * targetBytes;
        },
        [&] {
          if (cuts == 1)
            run(&combining, 0);
          else
            launch.owner().workers().parallel(cuts, run, &combining);
        });
  });
  left(launch, buffers, combining.bufferStride * parts);
}
