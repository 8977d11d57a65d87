//===- DeviceAbi.h - Functions that device code may call --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The device library in C: functions that are compiled to bitcode for NVPTX and
// for the CPU (for the emulated device), and linked into the device code of a
// kernel before it is optimised. The library also has some functions of Abi.h:
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

/// The position of the calling thread on the device. Blocks and grids have one
/// dimension.
int32_t tai_dev_thread_id(void);
int32_t tai_dev_block_id(void);
int32_t tai_dev_block_dim(void);
int32_t tai_dev_grid_dim(void);

/// A barrier for all threads of the block; writes before it are visible after
/// it.
void tai_dev_block_barrier(void);

/// A barrier for all threads of the grid, which has `blocks` blocks. All blocks
/// must be resident at the same time: see LaunchShape::cooperative. `state` is
/// a word in device memory that was zero before its first use, such as
/// `barrier` of TaiDeviceState.
void tai_dev_grid_barrier(uint32_t *state, uint32_t blocks);
/// The grid barrier in two steps: tai_dev_grid_await waits for the arrivals of
/// all blocks, but not for work that a block does after its arrival. `before`
/// is the result of tai_dev_grid_arrive.
uint32_t tai_dev_grid_arrive(uint32_t *state, uint32_t blocks);
void tai_dev_grid_await(uint32_t *state, uint32_t before);

// Combine the values of all threads of a block, and update the target with the
// result by one atomic operation. Every thread of the block calls such a
// function, at the same place; the block may have any size. The order in which
// values are combined is unspecified. Minima and maxima of floats are NaN if
// any of the values is NaN, and count -0 as less than 0, as on the CPU. A
// thread without a contribution passes the neutral element (0, 1, infinity, all
// bits).
#define TAI_DEVICE_REDUCTION(op, suffix, type)                                 \
  void tai_dev_reduce_##op##_##suffix(type *target, type value);
#include "tai/ABI/DeviceReductions.def"

//===----------------------------------------------------------------------===//
// Additions of one warp in a fixed order
//===----------------------------------------------------------------------===//
//
// Called by the first tai_dev_ordered_lanes() threads of the grid, by all of
// them at the same place, and by no others: a warp, or one thread on the
// emulated device. Each passes an address, or null where it adds nothing.
// Values for one element are summed pairwise in the order of lanes, and the sum
// is added to the element: the result depends on the addresses and values
// alone.

/// The number of threads that must make the calls of ordered additions. Traps
/// if blocks have fewer threads.
uint32_t tai_dev_ordered_lanes(void);

/// A barrier for the threads that make ordered additions; their writes before
/// it are visible to all of them after it.
void tai_dev_ordered_meet(void);

/// Finds the lanes of the warp that pass the same `address`, and encodes the
/// order in which their values are summed. Null for a lane that adds nothing.
uint64_t tai_dev_ordered_plan(const void *address);

/// Adds the values of all lanes in the order of `plan`. In each lane, `target`
/// lies at the same distance from the address that the lane gave to
/// tai_dev_ordered_plan; lanes that gave null ignore it.
void tai_dev_ordered_add_f32(uint64_t plan, float *target, float value);
void tai_dev_ordered_add_f64(uint64_t plan, double *target, double value);

/// Like tai_dev_ordered_plan and tai_dev_ordered_add, but the lanes add their
/// values to memory one after another, as if their iterations followed one
/// another.
uint64_t tai_dev_ordered_turns(const void *address);
void tai_dev_ordered_append_f32(uint64_t turns, float *target, float value);
void tai_dev_ordered_append_f64(uint64_t turns, double *target, double value);

//===----------------------------------------------------------------------===//
// Additions in fixed point, whose result does not depend on their order
//===----------------------------------------------------------------------===//
//
// Three launches: the first finds the largest exponent of the values for each
// element, the second adds up the values as integers in units that follow from
// this exponent, the third adds the sums to the elements. An accumulator, zero
// before the first launch, is a scale and a sum, of one integer for f32 and two
// for f64. See docs/decisions/0044-fixed-point.md.

void tai_dev_fixed_scale_f32(uint32_t *scale, float value);
void tai_dev_fixed_scale_f64(uint32_t *scale, double value);
void tai_dev_fixed_add_f32(const uint32_t *scale, uint64_t *sum, float value);
void tai_dev_fixed_add_f64(const uint32_t *scale, uint64_t *sum, double value);
/// Adds the sum of an accumulator to the element. If several threads make this
/// call with one accumulator, only one of them adds the sum.
void tai_dev_fixed_round_f32(uint32_t *scale, uint64_t *sum, float *element);
void tai_dev_fixed_round_f64(uint32_t *scale, uint64_t *sum, double *element);
/// Returns the sum of an accumulator for f32, for an element of another type.
double tai_dev_fixed_take_f32(uint32_t *scale, uint64_t *sum);

//===----------------------------------------------------------------------===//
// Sums with twice the digits of their terms
//===----------------------------------------------------------------------===//
// Sums start at zero. A sum of terms of f32 or narrower is one f64; a sum of
// f64 is two f64, the second of which holds the rounding errors. See
// docs/decisions/0049-wide-scatters.md.

void tai_dev_wide_add_f32(double *sum, double term);
void tai_dev_wide_add_f64(double *sums, double term);
/// Returns `element` plus the sum in `sums`, rounded once, and sets the sum to
/// zero.
double tai_dev_wide_take_f64(double *sums, double element);

//===----------------------------------------------------------------------===//
// Memory of one thread, from the heap of the device
//===----------------------------------------------------------------------===//

/// Allocates memory for one thread. If the heap is exhausted, reports the
/// failure `text` at `where` and returns null; "{}" in `text` stands for the
/// number of bytes. An allocation of 0 bytes succeeds.
void *tai_rt_local_alloc(TaiFrame *frame, uint64_t bytes, const char *text,
                         const char *where);
void tai_rt_local_free(void *memory);
/// Like tai_rt_stack_grow. If the heap is exhausted, reports the failure `text`
/// at `where`.
void tai_rt_stack_grow_at(TaiFrame *frame, TaiStack *stack, const char *text,
                          const char *where);

//===----------------------------------------------------------------------===//
// Loops that may be long
//===----------------------------------------------------------------------===//

/// A safepoint: returns null if the host asked kernels to stop, and
/// acknowledges the request in the state; the thread must then exit. Compiled
/// loops call it every `every` iterations, a power of two.
void *tai_rt_go_on(TaiFrame *frame, int32_t every);

//===----------------------------------------------------------------------===//
// Programs
//===----------------------------------------------------------------------===//
//
// A program does the work of a sequence of launches in one kernel. Repeated
// subsequences are loops in its code. The remaining steps form a table with a
// row of `stride` words for each step: the number of a part, and the parameters
// of the part. The parameters of the kernel are the table, the stride, a
// header, and the words of the parameters of its loops. See
// docs/decisions/0011-device-programs.md.

/// The name of the one kernel that a program consists of.
#define TAI_PROGRAM_FUNCTION "tai_program"

/// The threads that the barrier after each step of a program covers: those of
/// one block, of a cluster of blocks, or of the grid.
#define TAI_SCOPE_BLOCK 0
#define TAI_SCOPE_CLUSTER 1
#define TAI_SCOPE_GRID 2
/// In place of a scope: not a program, but kernels of functions of the device
/// library.
#define TAI_SCOPE_NONE (-1)
/// In place of a scope: not a program, but a kernel for each part. Such a
/// kernel may start while the kernel before it still runs, and itself waits for
/// the end of that kernel (programmatic dependent launch).
#define TAI_SCOPE_LAUNCHES (-2)

/// The numbers of parts that every program has. Parameters of a fill: address,
/// pattern of eight bytes, its size, number of repetitions; of a copy:
/// destination, source, bytes.
#define TAI_PART_FILL 0
#define TAI_PART_COPY 1
/// Parts that fill, copy and swap rows of memory. Parameters: address of the
/// first row, stride, bytes of a row, number of rows; then a pattern and its
/// size, or address and stride of the rows of the other side; then the stride
/// and the number of groups of rows (1 except for fills).
#define TAI_PART_FILL_ROWS 2
#define TAI_PART_COPY_ROWS 3
#define TAI_PART_SWAP_ROWS 4
/// The number of the first part of a program that is the body of a kernel;
/// smaller numbers are the built-in parts above.
#define TAI_FIRST_PART 5
/// This bit in the part number of a step says that no barrier is needed before
/// the next step: no thread of the next step accesses memory that another
/// thread has written since the last barrier.
#define TAI_PART_APART ((uint64_t)1 << 32)

/// The maximum number of eight-byte words in a row of the step table.
#define TAI_PROGRAM_STRIDE 128
/// The maximum number of words that hold parameters of loops: a kernel has 4096
/// bytes of parameters.
#define TAI_PROGRAM_WORDS 500

/// The byte offset, in the header of a program, of the address of the time
/// stamps, or null: the first thread stores its clock there before the first
/// step and after each step.
#define TAI_PROGRAM_CLOCKS 128
/// The byte offset, in the header of a program, of the word that the barrier in
/// two steps (arrive and await) uses.
#define TAI_PROGRAM_ARRIVALS 64
#define TAI_PROGRAM_HEADER 256

/// Execute the steps of a table with the threads of a block, cluster or grid.
/// `header` starts with the state of tai_dev_grid_barrier; `first` is the
/// number of the first of these steps in the program.
void tai_dev_program_block(const uint64_t *table, uint64_t steps,
                           uint64_t stride, uint32_t *header, uint64_t first);
void tai_dev_program_cluster(const uint64_t *table, uint64_t steps,
                             uint64_t stride, uint32_t *header, uint64_t first);
void tai_dev_program_grid(const uint64_t *table, uint64_t steps,
                          uint64_t stride, uint32_t *header, uint64_t first);

/// A barrier for all threads of a program, which runs in one block, cluster or
/// grid.
void tai_dev_program_wait_block(uint32_t *header);
void tai_dev_program_wait_cluster(uint32_t *header);
void tai_dev_program_wait_grid(uint32_t *header);

/// The barrier of a program's grid in two steps; see tai_dev_grid_arrive.
uint32_t tai_dev_program_arrive(uint32_t *header);
void tai_dev_program_await(uint32_t *header, uint32_t before);

/// Runs one of the built-in parts: fills, copies and swaps.
void tai_dev_program_part(uint64_t part, const uint64_t *slots);

/// Stores a time stamp, if the steps of the program are time-stamped: the first
/// thread stores its clock as the stamp after `steps` steps.
void tai_dev_program_clock(const uint32_t *header, uint64_t steps);

//===----------------------------------------------------------------------===//
// Functions that the library's build for the host calls on the emulated device
//===----------------------------------------------------------------------===//

int32_t tai_emu_thread_id(void);
int32_t tai_emu_block_id(void);
int32_t tai_emu_block_dim(void);
int32_t tai_emu_grid_dim(void);
/// Barriers for the emulated block and the emulated warp.
void tai_emu_block_barrier(void);
void tai_emu_warp_barrier(void);
/// A shuffle: returns the value that lane `from` passes, or `value` if there is
/// no such lane. All lanes of the emulated warp must call it.
uint64_t tai_emu_exchange(uint64_t value, uint32_t from);
/// The mask of lanes that pass the same `value`. All lanes of the emulated warp
/// must call it.
uint32_t tai_emu_match(uint64_t value);
/// Sets `*stop` if the host has asked the kernel to stop.
void tai_emu_look(uint32_t *stop);
void *tai_emu_allocate(uint64_t bytes);
void tai_emu_free(void *memory);

/// A program on the emulated device runs as several threads, in an order that
/// changes after each barrier. Returns the number of threads.
int32_t tai_emu_begin_group(void);
/// Switches the emulated device to the next thread of the group that runs a
/// program.
void tai_emu_next_in_group(void);
void tai_emu_end_group(void);

#ifdef __cplusplus
} // extern "C"
#endif

#endif // TAI_ABI_DEVICEABI_H
