//===- DeviceAbi.h - What device code may call ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The device library in C: functions that are compiled to bitcode for NVPTX and
// for the CPU (for the emulated device), and linked into the device code of a
// kernel before it is optimised. Besides these it has, of Abi.h,
// tai_rt_random_u32, tai_rt_print, tai_rt_fail, tai_rt_failed and
// tai_rt_stack_grow/free, which take the address of a TaiDeviceState as their
// frame.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ABI_DEVICEABI_H
#define TAI_ABI_DEVICEABI_H

#include "tai/ABI/Abi.h"
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/// The place of the thread. Blocks and grids have one dimension.
int32_t tai_dev_thread_id(void);
int32_t tai_dev_block_id(void);
int32_t tai_dev_block_dim(void);
int32_t tai_dev_grid_dim(void);

/// All threads of the block wait for each other, and see what the others wrote
/// before.
void tai_dev_block_barrier(void);

/// All threads of the grid, of `blocks` blocks, do. They must run at the same
/// time: see LaunchShape::cooperative. `state` is a word in device memory that
/// was zero before its first use; `barrier` of TaiDeviceState is one.
void tai_dev_grid_barrier(uint32_t *state, uint32_t blocks);
/// The same in two halves: what a block does between them is not waited for.
/// The second takes what the first has yielded.
uint32_t tai_dev_grid_arrive(uint32_t *state, uint32_t blocks);
void tai_dev_grid_await(uint32_t *state, uint32_t before);

// Combine the values of all threads of a block, and update the target with the
// result by one atomic operation. Every thread of the block calls them, at the
// same place; the block may have any size. The order in which values are
// combined is not said. Minima and maxima of floats are NaN if any of the
// values is, and count -0 as less than 0, as on the CPU. A thread that has
// nothing to contribute gives what leaves others as they are (0, 1, infinity,
// all bits).
#define TAI_DEVICE_REDUCTION(op, suffix, type)                                 \
  void tai_dev_reduce_##op##_##suffix(type *target, type value);
#include "tai/ABI/DeviceReductions.def"

//===----------------------------------------------------------------------===//
// Additions of one warp in a fixed order
//===----------------------------------------------------------------------===//
//
// The first so many threads of the grid call these, all of them at the same
// place, and no others: a warp, or one thread on the emulated device. Each
// comes with an address, or null where it adds nothing. Values for one element
// are added up by lanes, in pairs, and their sum is added to what is there: a
// function of the addresses and values alone.

/// How many threads; ends the kernel where blocks have fewer.
uint32_t tai_dev_ordered_lanes(void);

/// They wait for each other, and see what all of them wrote.
void tai_dev_ordered_meet(void);

/// How sums are taken of lanes that have the same address.
uint64_t tai_dev_ordered_plan(const void *address);

/// Does it: `target` is a certain distance from the address in all lanes that
/// had one, and is not looked at in others.
void tai_dev_ordered_add_f32(uint64_t plan, float *target, float value);
void tai_dev_ordered_add_f64(uint64_t plan, double *target, double value);

/// The same, but the values are added to memory one after another, by lanes:
/// as if their iterations followed one another.
uint64_t tai_dev_ordered_turns(const void *address);
void tai_dev_ordered_append_f32(uint64_t turns, float *target, float value);
void tai_dev_ordered_append_f64(uint64_t turns, double *target, double value);

//===----------------------------------------------------------------------===//
// Memory of one thread, out of the heap of the device
//===----------------------------------------------------------------------===//

/// Null where there is none, which has then been said: in `text`, "{}" stands
/// for the bytes. For no bytes there always is an address.
void *tai_rt_local_alloc(TaiFrame *frame, uint64_t bytes, const char *text,
                         const char *where);
void tai_rt_local_free(void *memory);
/// As tai_rt_stack_grow; what it says where there is no memory.
void tai_rt_stack_grow_at(TaiFrame *frame, TaiStack *stack, const char *text,
                          const char *where);

//===----------------------------------------------------------------------===//
// Loops that may be long
//===----------------------------------------------------------------------===//

/// Null where the thread is to end, which has then been noted. The compiler
/// asks every so many iterations of a loop, and says how many: a power of two.
void *tai_rt_go_on(TaiFrame *frame, int32_t every);

//===----------------------------------------------------------------------===//
// Programs
//===----------------------------------------------------------------------===//
//
// A program does the work of a sequence of launches in one kernel. What repeats
// in the sequence is a loop in its code. For the rest it has a table of rows of
// `stride` words: the number of a part, and the parameters of that. The kernel
// takes a table, the stride, a header, and the words of the parameters of its
// loops. See docs/decisions/0011-device-programs.md.

/// Its name.
#define TAI_PROGRAM_FUNCTION "tai_program"

/// Who meets at the barrier after a step: the threads of one block, of a
/// cluster of blocks, or of the grid.
#define TAI_SCOPE_BLOCK 0
#define TAI_SCOPE_CLUSTER 1
#define TAI_SCOPE_GRID 2
/// No program, but kernels of the library itself.
#define TAI_SCOPE_NONE (-1)
/// No program, but a kernel of each part, which may start while the one before
/// still runs and waits for its end by itself.
#define TAI_SCOPE_LAUNCHES (-2)

/// Parts that every program has. Their parameters: an address, eight bytes of a
/// pattern, its size and how often; two addresses, to and from, and a size.
#define TAI_PART_FILL 0
#define TAI_PART_COPY 1
/// The same for rows: the address of the first, from one to the next, the bytes
/// of a row and their number; then a pattern and its size, or the address of
/// the first row of the other side and from one to the next there; and from one
/// group of such rows to the next and their number, which is 1 but for fills.
#define TAI_PART_FILL_ROWS 2
#define TAI_PART_COPY_ROWS 3
#define TAI_PART_SWAP_ROWS 4
/// The number of the first part that is the body of a kernel.
#define TAI_FIRST_PART 5
/// Added to the number of a part where nobody has to wait before the next step:
/// no thread touches there what another one has written since they last met.
#define TAI_PART_APART ((uint64_t)1 << 32)

/// The most words of a row.
#define TAI_PROGRAM_STRIDE 128
/// The most words of parameters of loops: kernels take 4096 bytes.
#define TAI_PROGRAM_WORDS 500

/// In the header of a program, at this byte: the address of one more number
/// than there are steps, for the first thread's clock before the first step and
/// after each; null for none.
#define TAI_PROGRAM_CLOCKS 128
/// A word for the second barrier of a program, in two halves.
#define TAI_PROGRAM_ARRIVALS 64
#define TAI_PROGRAM_HEADER 256

/// `header` starts with a word as tai_dev_grid_barrier wants it. `first` is the
/// number of the first of these steps in the program.
void tai_dev_program_block(const uint64_t *table, uint64_t steps,
                           uint64_t stride, uint32_t *header, uint64_t first);
void tai_dev_program_cluster(const uint64_t *table, uint64_t steps,
                             uint64_t stride, uint32_t *header, uint64_t first);
void tai_dev_program_grid(const uint64_t *table, uint64_t steps,
                          uint64_t stride, uint32_t *header, uint64_t first);

/// All threads of the program meet.
void tai_dev_program_wait_block(uint32_t *header);
void tai_dev_program_wait_cluster(uint32_t *header);
void tai_dev_program_wait_grid(uint32_t *header);

/// Between the two, no block waits for another.
uint32_t tai_dev_program_arrive(uint32_t *header);
void tai_dev_program_await(uint32_t *header, uint32_t before);

/// Runs a part that every program has.
void tai_dev_program_part(uint64_t part, const uint64_t *slots);

/// Notes the clock after so many steps.
void tai_dev_program_clock(const uint32_t *header, uint64_t steps);

//===----------------------------------------------------------------------===//
// What the host's build of the library asks of the emulated device
//===----------------------------------------------------------------------===//

int32_t tai_emu_thread_id(void);
int32_t tai_emu_block_id(void);
int32_t tai_emu_block_dim(void);
int32_t tai_emu_grid_dim(void);
/// All threads of the block or the warp meet.
void tai_emu_block_barrier(void);
void tai_emu_warp_barrier(void);
/// The value of another lane of the warp, all of which call; one's own where
/// there is no such lane.
uint64_t tai_emu_exchange(uint64_t value, uint32_t from);
/// The lanes of the warp that have the same value; all of it call.
uint32_t tai_emu_match(uint64_t value);
/// Looks whether the host wants the kernel to end, and then says so at the
/// address.
void tai_emu_look(uint32_t *stop);
void *tai_emu_allocate(uint64_t bytes);
void tai_emu_free(void *memory);

/// A program on the emulated device runs as several threads, in an order that
/// is another one after each barrier. Yields how many.
int32_t tai_emu_begin_group(void);
/// Whoever runs from now on is the next of them.
void tai_emu_next_in_group(void);
void tai_emu_end_group(void);

#ifdef __cplusplus
} // extern "C"
#endif

#endif // TAI_ABI_DEVICEABI_H
