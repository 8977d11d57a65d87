//===- Threads.cpp - Thread numbers and barriers --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Target.h"
#include "tai/ABI/DeviceAbi.h"

#ifdef __NVPTX__

int32_t tai_dev_thread_id() { return __nvvm_read_ptx_sreg_tid_x(); }
int32_t tai_dev_block_id() { return __nvvm_read_ptx_sreg_ctaid_x(); }
int32_t tai_dev_block_dim() { return __nvvm_read_ptx_sreg_ntid_x(); }
int32_t tai_dev_grid_dim() { return __nvvm_read_ptx_sreg_nctaid_x(); }

void tai_dev_block_barrier() { __syncthreads(); }

// The memory orderings are written as assembly, because LLVM's code generator
// for NVPTX leaves them out of atomic additions.
static uint32_t arrive(uint32_t *state, uint32_t amount) {
  uint32_t before;
  asm volatile("fence.acq_rel.gpu;\n\tatom.relaxed.gpu.add.u32 %0, [%1], %2;"
               : "=r"(before)
               : "l"(state), "r"(amount)
               : "memory");
  return before;
}

static uint32_t look(const uint32_t *state) {
  uint32_t now;
  asm volatile("ld.acquire.gpu.u32 %0, [%1];"
               : "=r"(now)
               : "l"(state)
               : "memory");
  return now;
}

static void relax() {}

#else // the CPU

int32_t tai_dev_thread_id() { return tai_emu_thread_id(); }
int32_t tai_dev_block_id() { return tai_emu_block_id(); }
int32_t tai_dev_block_dim() { return tai_emu_block_dim(); }
int32_t tai_dev_grid_dim() { return tai_emu_grid_dim(); }

void tai_dev_block_barrier() { tai_emu_block_barrier(); }

static uint32_t arrive(uint32_t *state, uint32_t amount) {
  return __atomic_fetch_add(state, amount, __ATOMIC_ACQ_REL);
}

static uint32_t look(const uint32_t *state) {
  return __atomic_load_n(state, __ATOMIC_ACQUIRE);
}

static void relax() { sched_yield(); }

#endif

// The highest bit of the word flips when all blocks have arrived: each block
// but the first adds one, and the first block adds the difference. The word
// need not be reset for the next barrier.
static constexpr uint32_t turn = uint32_t(1) << 31;

uint32_t tai_dev_grid_arrive(uint32_t *state, uint32_t blocks) {
  tai_dev_block_barrier();
  if (tai_dev_thread_id() != 0)
    return 0;
  return arrive(state, tai_dev_block_id() == 0 ? turn - (blocks - 1) : 1);
}

void tai_dev_grid_await(uint32_t *state, uint32_t before) {
  if (tai_dev_thread_id() == 0)
    while (((look(state) ^ before) & turn) == 0)
      relax();
  tai_dev_block_barrier();
}

void tai_dev_grid_barrier(uint32_t *state, uint32_t blocks) {
  tai_dev_grid_await(state, tai_dev_grid_arrive(state, blocks));
}
