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
#include "tai/ABI/DeviceAbi.h"
#include "tai/ABI/SumModes.h"
#include "tai/Runtime/Device/Device.h"
#include "tai/Runtime/Device/DeviceHeap.h"
#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Launch/Mesh.h"
#include "tai/Runtime/Launch/ShadowLog.h"
#include "tai/Runtime/Math/VectorSymbols.h"
#include "tai/Runtime/Storage/Scalars.h"
#include "tai/Runtime/Text/Format.h"
#include "tai/Runtime/Threads/FixedParts.h"
#include "tai/Runtime/Threads/Safepoint.h"
#include "tai/Support/Philox.h"
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <cstring>

using namespace mlir::tai::runtime;

static_assert(sizeof(TaiFrame) == 64, "compiled code reads frames by position");

//===----------------------------------------------------------------------===//
// Parallel loops
//===----------------------------------------------------------------------===//

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
  // The results of a failed launch are discarded, so its other loop partitions
  // need not run.
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
  orFail(frame, [&] {
    launch.owner().workers().parallel(
        loop.parts, runPart, &loop, [](void *context) {
          (void)static_cast<Loop *>(context)->launch->look();
        });
  });
}

extern "C" int32_t tai_rt_safepoint(TaiFrame *frame) {
  return orFail(frame, 1, [&] { return int32_t(!launchOf(frame).look()); });
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

/// Zeroes memory; if it is large, its pages are divided among the worker
/// threads.
static void zero(Launch &launch, char *address, int64_t bytes) {
  constexpr int64_t partBytes = 128 << 10;
  int64_t parts =
      std::clamp<int64_t>(bytes / partBytes, 1, launch.owner().threads());
  if (parts == 1) {
    std::memset(address, 0, static_cast<size_t>(bytes));
    return;
  }
  Zeroing zeroing{address, bytes, parts};
  launch.owner().workers().parallel(
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

/// Allocates scratch memory for a launch; without memory, fails the launch and
/// returns null.
static void *tryScratch(Launch &launch, int64_t bytes, const char *purpose) {
  int64_t limit = std::min(launch.owner().memory().limit(), largestScratch);
  if (bytes >= 0 && bytes <= limit) {
    int64_t dirty = 0;
    int64_t rounded = std::max<int64_t>((bytes + 63) / 64 * 64, 64);
    if (char *address = launch.arena.allocate(rounded, dirty)) {
      zero(launch, address, dirty);
      if (__builtin_expect(launch.owner().options().instruments.shadow, false))
        shadow::forget(address, dirty);
      return address;
    }
  }
  launch.fail(Status::failure(
      StatusCode::Memory,
      bytes < 0 ? std::string("a kernel asked for memory of negative size")
                : "out of memory: a kernel needs " + formatBytes(bytes) +
                      " of " + purpose + ", of " + formatBytes(limit)));
  return nullptr;
}

static void *scratch(TaiFrame *frame, int64_t bytes, const char *purpose) {
  Launch &launch = launchOf(frame);
  void *none = nullptr;
  void *memory =
      orFail(frame, none, [&] { return tryScratch(launch, bytes, purpose); });
  return memory ? memory
                : launch.sink(std::clamp<int64_t>(bytes, 0, largestScratch));
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
  if (bytes <= launch.owner().memory().limit() / 2)
    larger = std::realloc(grown, static_cast<size_t>(2 * bytes));
  if (!larger) {
    orFail(frame, [&] {
      launch.fail(Status::failure(
          StatusCode::Memory, "out of memory: a gradient records more than " +
                                  formatBytes(bytes) +
                                  " of values in one iteration"));
    });
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
// Counters
//===----------------------------------------------------------------------===//

extern "C" void tai_rt_count_cells(TaiFrame *frame, int64_t visited,
                                   int64_t skipped) {
  mlir::tai::SkipCounters &counters = launchOf(frame).owner().skipCounters();
  counters.add(mlir::tai::SkipCount::FlaggedVisited, visited);
  counters.add(mlir::tai::SkipCount::FlaggedSkipped, skipped);
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
  orFail(frame, [&] {
    launchOf(frame).owner().print(
        endPrinted(formatValues(format, count, kinds, shapes, slots)));
  });
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
  orFail(frame, [&] {
    launch.fail(Status::failure(
        code, formatValues(message, count, kinds, shapes, slots),
        where ? where : ""));
  });
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
  appendLibraryCalls(symbols);
  appendMeshCalls(symbols);
  for (auto [name, function] : vectorMathSymbols())
    symbols.push_back({name, function});
  return symbols;
}
