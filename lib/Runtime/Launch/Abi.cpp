//===- Abi.cpp - The functions that compiled kernels call -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Implements tai/ABI/Abi.h for kernels. The functions for host programs are in
// Tape/HostProgram.cpp.
//
//===----------------------------------------------------------------------===//

#include "tai/ABI/Abi.h"
#include "../Math/VectorMath.h"
#include "../Storage/Scalars.h"
#include "../Text/Format.h"
#include "Launch.h"
#include "tai/ABI/DeviceAbi.h"
#include "tai/ABI/SumModes.h"
#include "tai/Runtime/Device/Device.h"
#include "tai/Runtime/Device/DeviceHeap.h"
#include "tai/Runtime/Launch/ShadowLog.h"
#include "tai/Runtime/Threads/FixedParts.h"
#include "tai/Runtime/Threads/Safepoint.h"
#include "tai/Support/Philox.h"
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <cstring>

using namespace mlir::tai::runtime;

static_assert(sizeof(TaiFrame) == 56, "compiled code reads frames by position");

//===----------------------------------------------------------------------===//
// Parallel loops
//===----------------------------------------------------------------------===//

/// n * part / parts, without overflow.
static int64_t boundOf(int64_t n, int64_t part, int64_t parts) {
  return n / parts * part + n % parts * part / parts;
}

extern "C" int64_t tai_rt_parts(TaiFrame *frame, int64_t n, int64_t cost,
                                int32_t reduces) {
  Launch &launch = launchOf(frame);
  if (reduces == kPartsFixed)
    return n <= 1 ? 1 : fixedParts(n, static_cast<double>(cost));
  return launch.partition(n, cost, reduces != 0);
}

namespace {
struct Loop {
  Launch *launch;
  TaiLoopBody body;
  void *closure;
  int64_t n, parts;
};
} // namespace

static void runPart(void *context, int64_t part) {
  Loop &loop = *static_cast<Loop *>(context);
  // What is left of a launch that has failed would be thrown away.
  if (loop.launch->hasFailed())
    return;
  if (!loop.launch->passSafepoint())
    return;
  loop.body(loop.launch, loop.closure, boundOf(loop.n, part, loop.parts),
            boundOf(loop.n, part + 1, loop.parts), part);
}

static void runMeasured(Launch &launch, TaiLoopBody body, void *closure,
                        int64_t n) {
  using Clock = std::chrono::steady_clock;
  LoopTimes::Entry &entry = *launch.measured;
  launch.measured = nullptr;
  auto start = Clock::now();
  body(&launch, closure, 0, n, 0);
  std::chrono::duration<double, std::nano> taken = Clock::now() - start;
  entry.add(taken.count() / static_cast<double>(n));
}

extern "C" void tai_rt_parallel_for(TaiFrame *frame, TaiLoopBody body,
                                    void *closure, int64_t n, int64_t parts) {
  if (n <= 0)
    return;
  Launch &launch = launchOf(frame);
  if (parts <= 1) {
    if (__builtin_expect(launch.measured != nullptr, false))
      runMeasured(launch, body, closure, n);
    else
      body(frame, closure, 0, n, 0);
    return;
  }
  Loop loop{&launch, body, closure, n, std::min<int64_t>(parts, INT32_MAX)};
  launch.owner().parallel(loop.parts, runPart, &loop, [](void *context) {
    (void)static_cast<Loop *>(context)->launch->look();
  });
}

extern "C" int32_t tai_rt_safepoint(TaiFrame *frame) {
  return !launchOf(frame).look();
}

//===----------------------------------------------------------------------===//
// Scratch memory
//===----------------------------------------------------------------------===//

static constexpr int64_t largestScratch = int64_t(1) << 46;

namespace {
struct Zeroing {
  char *address;
  int64_t bytes, parts;
};
} // namespace

/// Zeroes, on the workers where it is much.
static void zero(Launch &launch, char *address, int64_t bytes) {
  constexpr int64_t partBytes = 128 << 10;
  int64_t parts =
      std::clamp<int64_t>(bytes / partBytes, 1, launch.owner().threads());
  if (parts == 1) {
    std::memset(address, 0, static_cast<size_t>(bytes));
    return;
  }
  Zeroing zeroing{address, bytes, parts};
  launch.owner().parallel(
      parts,
      [](void *context, int64_t part) {
        Zeroing &zeroing = *static_cast<Zeroing *>(context);
        int64_t begin = boundOf(zeroing.bytes, part, zeroing.parts);
        int64_t end = boundOf(zeroing.bytes, part + 1, zeroing.parts);
        std::memset(zeroing.address + begin, 0,
                    static_cast<size_t>(end - begin));
      },
      &zeroing);
}

static void *scratch(TaiFrame *frame, int64_t bytes, const char *purpose) {
  Launch &launch = launchOf(frame);
  int64_t limit = std::min(launch.owner().memoryLimit(), largestScratch);
  if (bytes >= 0 && bytes <= limit) {
    int64_t dirty = 0;
    int64_t rounded = std::max<int64_t>((bytes + 63) / 64 * 64, 64);
    if (char *address = launch.arena.allocate(rounded, dirty)) {
      zero(launch, address, dirty);
      if (__builtin_expect(launch.owner().options().shadow, false))
        shadow::forget(address, dirty);
      return address;
    }
  }
  launch.fail(Status::failure(
      StatusCode::Memory,
      bytes < 0 ? std::string("a kernel asked for memory of negative size")
                : "out of memory: a kernel needs " + formatBytes(bytes) +
                      " of " + purpose + ", of " + formatBytes(limit)));
  return launch.sink(std::clamp<int64_t>(bytes, 0, largestScratch));
}

extern "C" void *tai_rt_scratch(TaiFrame *frame, int64_t bytes) {
  return scratch(frame, bytes, "scratch memory");
}

extern "C" void *tai_rt_private(TaiFrame *frame, int64_t bytes, int64_t parts) {
  int64_t block = bytes < 0 ? 0 : (bytes + 63) / 64 * 64;
  int64_t total;
  if (bytes < 0 || __builtin_mul_overflow(block, parts, &total))
    total = INT64_MAX;
  return scratch(frame, total, "private copies for its partial sums");
}

//===----------------------------------------------------------------------===//
// Stacks
//===----------------------------------------------------------------------===//

static char *inlineSlots(TaiStack *stack) {
  return reinterpret_cast<char *>(stack + 1);
}

extern "C" void tai_rt_stack_grow(TaiFrame *frame, TaiStack *stack) {
  Launch &launch = launchOf(frame);
  char *own = inlineSlots(stack);
  int64_t bytes = stack->capacity * static_cast<int64_t>(sizeof(int64_t));
  char *grown = stack->slots == own ? nullptr : stack->slots;
  void *larger = nullptr;
  if (bytes <= launch.owner().memoryLimit() / 2)
    larger = std::realloc(grown, static_cast<size_t>(2 * bytes));
  if (!larger) {
    launch.fail(Status::failure(StatusCode::Memory,
                                "out of memory: a gradient records more than " +
                                    formatBytes(bytes) +
                                    " of values in one iteration"));
    stack->size = 0;
    return;
  }
  stack->slots = static_cast<char *>(larger);
  if (!grown)
    std::memcpy(larger, own, static_cast<size_t>(bytes));
  stack->capacity *= 2;
}

extern "C" void tai_rt_stack_free(TaiStack *stack) {
  if (stack->slots != inlineSlots(stack))
    std::free(stack->slots);
}

//===----------------------------------------------------------------------===//
// Combining partial sums
//===----------------------------------------------------------------------===//

namespace {
/// `count`: of the elements of a buffer.
using AddBuffers = void (*)(void *target, const char *buffers, int64_t begin,
                            int64_t end, int64_t parts, int64_t stride,
                            int64_t count);

struct Combining {
  void *target;
  const char *buffers;
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

/// Adds elements [begin, end) of all buffers. The sum of the buffers is formed
/// first, in their order, in blocks that stay in the first-level cache.
template <typename Target, typename T>
__attribute__((always_inline)) static inline void
addBuffers(void *targetBytes, const char *buffers, int64_t begin, int64_t end,
           int64_t parts, int64_t stride, int64_t) {
  constexpr int64_t block = 1024;
  T sums[block];
  Target *target = static_cast<Target *>(targetBytes);
  for (int64_t at = begin; at < end; at += block) {
    int64_t count = std::min(block, end - at);
    const T *first = reinterpret_cast<const T *>(buffers) + at;
    std::memcpy(sums, first, static_cast<size_t>(count) * sizeof(T));
    for (int64_t p = 1; p < parts; ++p) {
      const T *from = reinterpret_cast<const T *>(buffers + p * stride) + at;
      for (int64_t e = 0; e < count; ++e)
        sums[e] += from[e];
    }
    for (int64_t e = 0; e < count; ++e)
      target[at + e] = static_cast<Target>(target[at + e] + sums[e]);
  }
}

/// Adds elements [begin, end) of all buffers of pairs, each rounded once. A
/// buffer holds `count` sums, and then what each of them has rounded away.
__attribute__((always_inline)) static inline void
addPairs(void *targetBytes, const char *buffers, int64_t begin, int64_t end,
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
    for (int64_t p = 0; p < parts; ++p) {
      const double *from =
          reinterpret_cast<const double *>(buffers + p * stride) + at;
      for (int64_t e = 0; e < length; ++e)
        if (p == 0) {
          sums[e] = from[e];
          rests[e] = from[count + e];
        } else {
          add(e, from[e], from[count + e]);
        }
    }
    for (int64_t e = 0; e < length; ++e) {
      add(e, target[at + e], 0);
      // Nothing is left of what an infinite sum has rounded away.
      target[at + e] = sums[e] + (std::isnan(rests[e]) ? 0 : rests[e]);
    }
  }
}

/// Bytes of an element of the field.
static int64_t sizeOfTarget(int32_t kind) {
  switch (kind) {
  case kSumsF16:
  case kSumsBF16:
    return 2;
  case kSumsF64:
  case kSumsPairs:
    return sizeof(double);
  default:
    return sizeof(float);
  }
}

/// Bytes of an element of a buffer.
static int64_t sizeOfSums(int32_t kind) {
  switch (kind) {
  case kSumsF32:
    return sizeof(float);
  case kSumsPairs:
    return 2 * sizeof(double);
  default:
    return sizeof(double);
  }
}

// Compiled for the vector units that there may be; the sums are the same.
#if defined(__x86_64__)
#define TAI_ADD_BUFFERS(name, target_type, type, unit)                         \
  __attribute__((target(unit))) static void name(                              \
      void *to, const char *buffers, int64_t begin, int64_t end,               \
      int64_t parts, int64_t stride, int64_t count) {                          \
    addBuffers<target_type, type>(to, buffers, begin, end, parts, stride,      \
                                  count);                                      \
  }
TAI_ADD_BUFFERS(addF32Avx2, float, float, "avx2")
TAI_ADD_BUFFERS(addF64Avx2, double, double, "avx2")
TAI_ADD_BUFFERS(addWideAvx2, float, double, "avx2")
#undef TAI_ADD_BUFFERS
__attribute__((target("avx2"))) static void
addPairsAvx2(void *to, const char *buffers, int64_t begin, int64_t end,
             int64_t parts, int64_t stride, int64_t count) {
  addPairs(to, buffers, begin, end, parts, stride, count);
}
#endif

/// Does `add`, which adds `parts` buffers to `count` numbers, the numbers of
/// the buffers one after another; shadows follow.
template <typename Target, typename T, typename AddressOf, typename Add>
static void addWithShadows(int64_t count, int64_t parts, const char *buffers,
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

/// The same for the types of `kind`, where the kernels of the context have
/// shadows.
template <typename AddressOf, typename Add>
static void addBuffersOf(Launch &launch, int32_t kind, int64_t count,
                         int64_t parts, const char *buffers, int64_t stride,
                         AddressOf addressOf, Add add) {
  // Compensated sums are pairs in memory, and have no shadows there; nor have
  // fields of 16 bits.
  if (__builtin_expect(!launch.owner().options().shadow, true) ||
      kind == kSumsPairs || sizeOfTarget(kind) == 2)
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
                                : addWideAvx2;
#endif
  return kind == kSumsF32     ? addBuffers<float, float>
         : kind == kSumsF64   ? addBuffers<double, double>
         : kind == kSumsPairs ? addPairs
                              : addBuffers<float, double>;
}

extern "C" void tai_rt_combine(TaiFrame *frame, void *target,
                               const void *buffers, int64_t count,
                               int64_t parts, int32_t kind) {
  Launch &launch = launchOf(frame);
  // After a failure the buffers may not be what the code believes.
  if (count <= 0 || parts <= 0 || launch.hasFailed())
    return;
  int64_t size = sizeOfSums(kind);
  int64_t targetBytes = sizeOfTarget(kind);
  int64_t stride = (count * size + 63) / 64 * 64;
  // Bytes read by one worker that repay its fork.
  constexpr int64_t cutBytes = 64 << 10;
  int64_t cuts = std::clamp<int64_t>(count * size / cutBytes * parts, 1,
                                     launch.owner().threads());
  Combining combining{target,         static_cast<const char *>(buffers),
                      count,          parts,
                      stride,         cuts,
                      chooseAdd(kind)};
  auto run = [](void *context, int64_t cut) {
    Combining &c = *static_cast<Combining *>(context);
    c.add(c.target, c.buffers, boundOf(c.count, cut, c.cuts),
          boundOf(c.count, cut + 1, c.cuts), c.parts, c.stride, c.count);
  };
  addBuffersOf(
      launch, kind, count, parts, combining.buffers, stride,
      [&](int64_t e) { return static_cast<char *>(target) + e * targetBytes; },
      [&] {
        if (cuts == 1)
          run(&combining, 0);
        else
          launch.owner().parallel(cuts, run, &combining);
      });
}

namespace {
struct StridedCombining {
  char *target;
  const char *buffers;
  int64_t cells, components, targetStride, parts, bufferStride, cuts;
};
} // namespace

/// Adds cells [begin, end) of all buffers, summed in their order.
template <typename Target, typename T>
static void addStrided(void *context, int64_t cut) {
  const auto &c = *static_cast<StridedCombining *>(context);
  int64_t begin = boundOf(c.cells, cut, c.cuts);
  int64_t end = boundOf(c.cells, cut + 1, c.cuts);
  constexpr int64_t block = 1024;
  T sums[block];
  // Whole cells, as many as fit; a matrix has at most 16 components.
  int64_t cellsInBlock = std::max<int64_t>(block / c.components, 1);
  for (int64_t at = begin; at < end; at += cellsInBlock) {
    int64_t cells = std::min(cellsInBlock, end - at);
    for (int64_t first = 0; first < c.components; first += block) {
      int64_t width = std::min(c.components - first, block);
      int64_t count = cells * width;
      for (int64_t p = 0; p < c.parts; ++p) {
        const T *from =
            reinterpret_cast<const T *>(c.buffers + p * c.bufferStride) +
            at * c.components + first;
        for (int64_t e = 0; e < count; ++e)
          sums[e] = p == 0 ? from[e] : sums[e] + from[e];
      }
      for (int64_t cell = 0; cell < cells; ++cell) {
        Target *to = reinterpret_cast<Target *>(c.target +
                                                (at + cell) * c.targetStride) +
                     first;
        for (int64_t e = 0; e < width; ++e)
          to[e] = static_cast<Target>(to[e] + sums[cell * width + e]);
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
                                       const void *buffers, int64_t cells,
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
                             static_cast<const char *>(buffers),
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
                                  : addStrided<float, double>;
  int64_t targetBytes = sizeOfTarget(kind);
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
          launch.owner().parallel(cuts, run, &combining);
      });
}

//===----------------------------------------------------------------------===//
// Random numbers, messages, failures
//===----------------------------------------------------------------------===//

extern "C" uint32_t tai_rt_random_u32(uint64_t seed, uint64_t launch,
                                      uint64_t iteration, uint32_t stream,
                                      uint32_t sequence) {
  return randomBits(seed, launch, iteration, stream, sequence);
}

extern "C" void tai_rt_print(TaiFrame *frame, const char *format, int32_t count,
                             const int32_t *kinds, const int32_t *shapes,
                             const uint64_t *slots) {
  launchOf(frame).owner().print(
      endPrinted(formatValues(format, count, kinds, shapes, slots)));
}

extern "C" void tai_rt_fail(TaiFrame *frame, int32_t failure,
                            const char *message, const char *where,
                            int32_t count, const int32_t *kinds,
                            const int32_t *shapes, const uint64_t *slots) {
  Launch &launch = launchOf(frame);
  if (launch.hasFailed())
    return;
  StatusCode code = failure >= TAI_FAIL_ASSERT && failure <= TAI_FAIL_CHECK
                        ? static_cast<StatusCode>(failure)
                        : StatusCode::Internal;
  launch.fail(
      Status::failure(code, formatValues(message, count, kinds, shapes, slots),
                      where ? where : ""));
}

extern "C" int32_t tai_rt_failed(TaiFrame *frame) {
  return launchOf(frame).hasFailed();
}

//===----------------------------------------------------------------------===//
// Symbols
//===----------------------------------------------------------------------===//

static std::vector<RuntimeSymbol> getAbiSymbols() {
#define TAI_SYMBOL(name)                                                       \
  {                                                                            \
    #name, reinterpret_cast<void *>(&name)                                     \
  }
  return {
#define TAI_ENTRY(result, name, parameters) TAI_SYMBOL(tai_rt_##name),
#include "tai/ABI/Abi.def"
      {"tai_rt_tick", &tai_rt_tick},     {"tai_rt_shadows", &tai_rt_shadows},
      TAI_SYMBOL(tai_emu_thread_id),     TAI_SYMBOL(tai_emu_block_id),
      TAI_SYMBOL(tai_emu_block_dim),     TAI_SYMBOL(tai_emu_block_barrier),
      TAI_SYMBOL(tai_emu_warp_barrier),  TAI_SYMBOL(tai_emu_exchange),
      TAI_SYMBOL(tai_emu_match),         TAI_SYMBOL(tai_emu_begin_group),
      TAI_SYMBOL(tai_emu_next_in_group), TAI_SYMBOL(tai_emu_end_group),
      TAI_SYMBOL(tai_emu_grid_dim),      TAI_SYMBOL(tai_emu_look),
      TAI_SYMBOL(tai_emu_allocate),      TAI_SYMBOL(tai_emu_free)};
#undef TAI_SYMBOL
}

std::vector<RuntimeSymbol> mlir::tai::runtime::runtimeSymbols() {
  std::vector<RuntimeSymbol> symbols = getAbiSymbols();
  appendHalfCalls(symbols);
  for (auto [name, function] : vectorMathSymbols())
    symbols.push_back({name, function});
  return symbols;
}
