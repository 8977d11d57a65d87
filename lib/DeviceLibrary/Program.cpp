//===- Program.cpp - Executes the steps of a program ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// All threads execute a table of steps together. A row holds the number of a
// part, which is the body of a kernel, and its parameters. The row of the next
// step is prefetched while a step runs.
//
//===----------------------------------------------------------------------===//

#include "Target.h"
#include "tai/ABI/DeviceAbi.h"

using namespace tai::device;

// Calls the part with the number `part`. The compiler makes this function for
// each program.
extern "C" void tai_program_dispatch(uint64_t part, const uint64_t *slots);

static uint64_t globalThread() {
  return static_cast<uint64_t>(tai_dev_block_id()) *
             static_cast<uint64_t>(tai_dev_block_dim()) +
         static_cast<uint64_t>(tai_dev_thread_id());
}

static uint64_t globalThreads() {
  return static_cast<uint64_t>(tai_dev_grid_dim()) *
         static_cast<uint64_t>(tai_dev_block_dim());
}

template <typename T>
static void fillAs(uint64_t address, uint64_t word, uint64_t count) {
  auto *to = reinterpret_cast<T *>(address);
  for (uint64_t i = globalThread(); i < count; i += globalThreads())
    to[i] = static_cast<T>(word);
}

/// Runs a fill. `slots`: the address, eight bytes of the pattern, the size of
/// the pattern, and the number of times that it is stored.
static void fill(const uint64_t *slots) {
  uint64_t address = slots[0], word = slots[1], size = slots[2],
           count = slots[3];
  if (size == 8)
    fillAs<uint64_t>(address, word, count);
  else if (size == 4)
    fillAs<uint32_t>(address, word, count);
  else if (size == 2)
    fillAs<uint16_t>(address, word, count);
  else if (address % 8 || count % 8)
    fillAs<uint8_t>(address, word, count);
  else
    fillAs<uint64_t>(address, word, count / 8);
}

template <typename T>
static void copyAs(uint64_t to, uint64_t from, uint64_t bytes) {
  auto *target = reinterpret_cast<T *>(to);
  auto *source = reinterpret_cast<const T *>(from);
  for (uint64_t i = globalThread(); i < bytes / sizeof(T); i += globalThreads())
    target[i] = source[i];
}

/// Runs a copy. `slots`: the target, the source and the number of bytes.
static void copy(const uint64_t *slots) {
  if ((slots[0] | slots[1] | slots[2]) % 8)
    copyAs<uint8_t>(slots[0], slots[1], slots[2]);
  else
    copyAs<uint64_t>(slots[0], slots[1], slots[2]);
}

/// Divides rows into units of type T, and calls move(offset of the row on one
/// side, offset on the other side, byte in the row) for each unit of this
/// thread.
template <typename T, typename Move>
static void forEachUnit(const uint64_t *slots, uint64_t otherStep,
                        const Move &move) {
  uint64_t units = slots[2] / sizeof(T), rows = slots[3] * slots[7];
  for (uint64_t i = globalThread(); i < units * rows; i += globalThreads()) {
    // Use a 32-bit division where possible: a 64-bit division takes as long as
    // a read from memory.
    uint64_t row = (i | units) >> 32 ? i / units
                                     : static_cast<uint32_t>(i) /
                                           static_cast<uint32_t>(units);
    move(row * slots[1], row * otherStep, (i - row * units) * sizeof(T));
  }
}

template <typename T>
static void runRowsAs(uint64_t part, const uint64_t *slots) {
  auto at = [](uint64_t address) { return reinterpret_cast<T *>(address); };
  uint64_t here = slots[0], there = slots[4];
  if (part == TAI_PART_FILL_ROWS)
    forEachUnit<T>(slots, 1, [&](uint64_t, uint64_t row, uint64_t byte) {
      uint64_t group = slots[7] == 1 ? 0 : row / slots[3];
      uint64_t offset = group * slots[6] + (row - group * slots[3]) * slots[1];
      // The number of bytes of the pattern is a power of two.
      *at(here + offset + byte) =
          static_cast<T>(there >> (byte & (slots[5] - 1)) * 8);
    });
  else if (part == TAI_PART_COPY_ROWS)
    forEachUnit<T>(slots, slots[5],
                   [&](uint64_t row, uint64_t other, uint64_t byte) {
                     *at(here + row + byte) = *at(there + other + byte);
                   });
  else
    forEachUnit<T>(slots, slots[5],
                   [&](uint64_t row, uint64_t other, uint64_t byte) {
                     T before = *at(here + row + byte);
                     *at(here + row + byte) = *at(there + other + byte);
                     *at(there + other + byte) = before;
                   });
}

static void runRows(uint64_t part, const uint64_t *slots) {
  uint64_t other = part == TAI_PART_FILL_ROWS ? 0 : slots[4];
  if ((slots[0] | slots[1] | slots[2] | other | slots[5] | slots[6]) % 4)
    runRowsAs<uint8_t>(part, slots);
  else
    runRowsAs<uint32_t>(part, slots);
}

void tai_dev_program_part(uint64_t part, const uint64_t *slots) {
  if (part == TAI_PART_FILL)
    fill(slots);
  else if (part == TAI_PART_COPY)
    copy(slots);
  else
    runRows(part, slots);
}

static void runPart(uint64_t part, const uint64_t *slots) {
  if (part < TAI_FIRST_PART)
    tai_dev_program_part(part, slots);
  else
    tai_program_dispatch(part, slots);
}

#ifdef __NVPTX__

__attribute__((
    address_space(3),
    loader_uninitialized)) static uint64_t rows[2][TAI_PROGRAM_STRIDE];

/// The array of time stamps, which gets the clock after each step; null if
/// steps are not timed.
static uint64_t *getClocks(const uint32_t *header) {
  return *reinterpret_cast<uint64_t *const *>(
      reinterpret_cast<const char *>(header) + TAI_PROGRAM_CLOCKS);
}

void tai_dev_program_clock(const uint32_t *header, uint64_t steps) {
  uint64_t *clocks = getClocks(header);
  if (clocks && globalThread() == 0)
    clocks[steps] = __nvvm_read_ptx_sreg_clock64();
}

template <typename Barrier>
static inline void runProgram(const uint64_t *table, uint64_t steps,
                              uint64_t stride, uint32_t *header, uint64_t first,
                              Barrier barrier) {
  auto thread = static_cast<uint64_t>(tai_dev_thread_id());
  auto threads = static_cast<uint64_t>(tai_dev_block_dim());
  bool isTimed = getClocks(header) != nullptr;
  for (uint64_t i = thread; i < stride; i += threads)
    rows[0][i] = table[i];
  __syncthreads();
  for (uint64_t step = 0; step < steps; ++step) {
    auto *row = (const uint64_t *)rows[step & 1];
    const uint64_t *next = table + (step + 1) * stride;
    bool more = step + 1 < steps;
    // The next row of the step table is loaded before the current step runs,
    // which hides the latency of the load, and is stored after the step.
    uint64_t word = more && thread < stride ? next[thread] : 0;
    uint64_t part = row[0];
    runPart(part & (TAI_PART_APART - 1), row + 1);
    if (more) {
      if (thread < stride)
        rows[(step + 1) & 1][thread] = word;
      for (uint64_t i = thread + threads; i < stride; i += threads)
        rows[(step + 1) & 1][i] = next[i];
    }
    if (part & TAI_PART_APART)
      __syncthreads();
    else
      barrier(header);
    if (isTimed)
      tai_dev_program_clock(header, first + step + 1);
  }
}

void tai_dev_program_wait_block(uint32_t *) { __syncthreads(); }

void tai_dev_program_wait_cluster(uint32_t *) {
  asm volatile("barrier.cluster.arrive.release.aligned;\n\t"
               "barrier.cluster.wait.acquire.aligned;" ::
                   : "memory");
}

void tai_dev_program_wait_grid(uint32_t *header) {
  tai_dev_grid_barrier(header, static_cast<uint32_t>(tai_dev_grid_dim()));
}

static uint32_t *getArrivals(uint32_t *header) {
  return header + TAI_PROGRAM_ARRIVALS / sizeof(uint32_t);
}

uint32_t tai_dev_program_arrive(uint32_t *header) {
  return tai_dev_grid_arrive(getArrivals(header),
                             static_cast<uint32_t>(tai_dev_grid_dim()));
}

void tai_dev_program_await(uint32_t *header, uint32_t before) {
  tai_dev_grid_await(getArrivals(header), before);
}

void tai_dev_program_block(const uint64_t *table, uint64_t steps,
                           uint64_t stride, uint32_t *header, uint64_t first) {
  runProgram(table, steps, stride, header, first, tai_dev_program_wait_block);
}

void tai_dev_program_cluster(const uint64_t *table, uint64_t steps,
                             uint64_t stride, uint32_t *header,
                             uint64_t first) {
  runProgram(table, steps, stride, header, first, tai_dev_program_wait_cluster);
}

void tai_dev_program_grid(const uint64_t *table, uint64_t steps,
                          uint64_t stride, uint32_t *header, uint64_t first) {
  runProgram(table, steps, stride, header, first, tai_dev_program_wait_grid);
}

#else // the CPU, where threads run one after another

/// Between barriers, each thread runs all steps before the next thread begins:
/// a missing barrier between dependent steps changes the results.
void tai_dev_program_block(const uint64_t *table, uint64_t steps,
                           uint64_t stride, uint32_t *, uint64_t) {
  for (uint64_t step = 0, end = 0; step < steps; step = end) {
    do {
      ++end;
    } while (end < steps && (table[(end - 1) * stride] & TAI_PART_APART));
    int32_t threads = tai_emu_begin_group();
    for (int32_t thread = 0; thread < threads; ++thread) {
      tai_emu_next_in_group();
      for (uint64_t at = step; at < end; ++at)
        runPart(table[at * stride] & (TAI_PART_APART - 1),
                table + at * stride + 1);
    }
    tai_emu_end_group();
  }
}

void tai_dev_program_wait_block(uint32_t *) {}
void tai_dev_program_clock(const uint32_t *, uint64_t) {}

#endif
