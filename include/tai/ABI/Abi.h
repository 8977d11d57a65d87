//===- Abi.h - What compiled kernels and the runtime share ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The binary interface between compiled kernels and the runtime, in C. A
// compiled kernel holds no address of its own: all it needs comes through the
// frame, so that object code can be cached on disk and shared by contexts.
// `TAI_ABI_VERSION` is part of the key of every cache entry; raise it with any
// change here.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ABI_ABI_H
#define TAI_ABI_ABI_H

#include <stdint.h>

#define TAI_ABI_VERSION 6

#ifdef __cplusplus
extern "C" {
#endif

typedef struct TaiRuntime TaiRuntime;

/// What one launch of a kernel is given. Offsets are part of the interface:
/// compiled code reads the fields by position.
typedef struct TaiFrame {
  /// Base address of each tree that the module of the kernel declares, in the
  /// order of its `tai.tree` ops.
  void **trees;
  /// Arguments in slots of eight bytes: a scalar takes one (stored in its own
  /// type at the start of the slot, i1 as one byte, index as int64), a vector
  /// or matrix one slot for each component (row-major), a memref one pointer
  /// slot followed by one int64 slot for each dimension (row-major,
  /// contiguous).
  const uint64_t *args;
  /// The returned value, in slots as above.
  uint64_t *results;
  TaiRuntime *runtime;
  /// Seed of the context and number of this launch, for `tai.random`.
  uint64_t seed;
  uint64_t launch;
  /// The last tick that this launch has seen; see tai_rt_safepoint.
  uint64_t tick;
} TaiFrame;

/// A compiled kernel. Returns 0, or non-zero if the launch failed (the runtime
/// holds the message).
typedef int32_t (*TaiKernelFn)(TaiFrame *frame);

/// The body of a parallel loop: runs the iterations [begin, end) of the
/// linearised index space. `part` in [0, parts) names the partition, for
/// partial sums and private buffers.
typedef void (*TaiLoopBody)(TaiFrame *frame, void *closure, int64_t begin,
                            int64_t end, int64_t part);

/// How a loop of `n` iterations will be cut. `cost` estimates the nanoseconds
/// of one iteration. With `fixed` the answer depends on n and cost alone
/// (deterministic mode, or whenever partial results are combined in order and
/// must not depend on the number of threads); else it follows the threads. Is
/// at least 1 for n >= 1.
int64_t tai_rt_parts(TaiFrame *frame, int64_t n, int64_t cost, int32_t reduces);

/// Runs `body` over [0, n) cut into `parts` contiguous partitions, partition p
/// covering [n*p/parts, n*(p+1)/parts). Inline on the calling thread where
/// parts is 1.
void tai_rt_parallel_for(TaiFrame *frame, TaiLoopBody body, void *closure,
                         int64_t n, int64_t parts);

/// Called by loops that may run long once `tai_rt_tick` (a symbol that holds 64
/// bits) is not what the frame has seen. Non-zero if the launch is to end: the
/// function that called then returns at once, with 1 if it is a kernel.
int32_t tai_rt_safepoint(TaiFrame *frame);

/// A stack of scalars in slots of eight bytes. The first TAI_STACK_SLOTS have
/// their place behind the structure.
#define TAI_STACK_SLOTS 13
typedef struct TaiStack {
  char *slots;
  int64_t size;
  int64_t capacity;
} TaiStack;

/// Makes room for more. Out of memory fails the launch, and what was on the
/// stack is overwritten.
void tai_rt_stack_grow(TaiFrame *frame, TaiStack *stack);
/// Frees the slots of a stack that has grown.
void tai_rt_stack_free(TaiStack *stack);

/// Zeroed scratch memory of this launch, aligned to 64 bytes; valid until the
/// kernel returns. Null never comes back: out of memory fails the launch and
/// yields a pointer to a shared sink that is never read.
void *tai_rt_scratch(TaiFrame *frame, int64_t bytes);

/// Zeroed private accumulation buffers: `parts` blocks of `bytes` bytes each
/// (rounded up to 64), one after another.
void *tai_rt_private(TaiFrame *frame, int64_t bytes, int64_t parts);

/// Adds the private buffers into `target` in partition order, in parallel over
/// elements: target[e] += sum over p of buffer[p][e]. kind: 0 f32, 1 f64.
void tai_rt_combine(TaiFrame *frame, void *target, const void *buffers,
                    int64_t count, int64_t parts, int32_t kind);

/// The same for a part of a field that shares its cells with other fields: the
/// target holds `cells` records of `components` numbers each, `stride` bytes
/// from one to the next, the buffers the numbers alone.
void tai_rt_combine_strided(TaiFrame *frame, void *target, const void *buffers,
                            int64_t cells, int64_t components, int64_t stride,
                            int64_t parts, int32_t kind);

//===----------------------------------------------------------------------===//
// Sparse levels
//===----------------------------------------------------------------------===//
//
// `tree` is a base address from the frame, `node` the number of a sparse level
// in the tree, those above before those below. Cells are numbered row-major,
// level below level. Whether a cell is active is read from the tree. `where` is
// as for tai_rt_fail; a number that no cell has fails the launch.

/// Makes a cell and those above it active. Returns 0, and fails the launch, if
/// there is no memory for it: the caller then must not write to it.
int32_t tai_rt_activate(TaiFrame *frame, void *tree, int32_t node, int64_t cell,
                        const char *where);
/// Makes a cell (the whole list, for a `dynamic` level) inactive and zeroes it,
/// with all that lies below.
void tai_rt_deactivate(TaiFrame *frame, void *tree, int32_t node, int64_t cell,
                       const char *where);
/// Appends a cell to list number `list` of a `dynamic` level. Returns its
/// number in the list, or -1 and fails the launch if the list is full.
int64_t tai_rt_append(TaiFrame *frame, void *tree, int32_t node, int64_t list,
                      const char *where);
/// The active cells of a level, ascending. The array stays as it is until the
/// kernel returns. Returns their number. For code on a device, the number is
/// the word in front of the array, which the device may still have to count,
/// and what comes back is a guess.
int64_t tai_rt_active_cells(TaiFrame *frame, void *tree, int32_t node,
                            const int64_t **cells);
/// Those of them that have, or have within `reach` cells in each direction, an
/// adjoint that is not zero; all for a negative reach. May yield more.
int64_t tai_rt_gathered_cells(TaiFrame *frame, void *tree, int32_t node,
                              int64_t reach, const int64_t **cells);
/// Whether those are the cells that are active now: the reverse of a loop gets
/// the cells that the loop went over.
int32_t tai_rt_list_is_current(TaiFrame *frame, void *tree, int32_t node);

/// Random bits: Philox 4x32-10 keyed by seed, counted by (launch, iteration,
/// stream, sequence).
uint32_t tai_rt_random_u32(uint64_t seed, uint64_t launch, uint64_t iteration,
                           uint32_t stream, uint32_t sequence);

/// Kinds of printed and reported values.
enum TaiValueKind {
  TAI_VALUE_I64 = 0, // int64_t slot (all integers are sign-extended)
  TAI_VALUE_F64 = 1, // double slot (all floats are extended)
  TAI_VALUE_U64 = 2,
  TAI_VALUE_BOOL = 3
};

/// Prints `format` with `{}` replaced by the values in turn, and a newline.
/// `shapes[k]` components belong to value k (1 for a scalar), with the slots
/// one after another.
void tai_rt_print(TaiFrame *frame, const char *format, int32_t count,
                  const int32_t *kinds, const int32_t *shapes,
                  const uint64_t *slots);

/// Records the first failure of a launch. `where` is "file:line:col" or empty.
enum TaiFailure {
  TAI_FAIL_ASSERT = 1,
  TAI_FAIL_INDEX = 2,
  TAI_FAIL_MEMORY = 3,
  TAI_FAIL_CHECK = 4
};
void tai_rt_fail(TaiFrame *frame, int32_t failure, const char *message,
                 const char *where, int32_t count, const int32_t *kinds,
                 const int32_t *shapes, const uint64_t *slots);

/// Non-zero if this launch has failed.
int32_t tai_rt_failed(TaiFrame *frame);

//===----------------------------------------------------------------------===//
// Devices
//===----------------------------------------------------------------------===//
//
// The host's part of a kernel that was compiled for a GPU calls these. In its
// frame, `trees` holds addresses in the memory of the device. Each fails the
// launch where it cannot do its work; the calls after it then do nothing.

/// Queues device function number `function` of this kernel. `iterations` is
/// the number of iterations of the loop, which decides how many threads run
/// it, or -1 where only the device knows it. `slots` holds the `count`
/// parameters, each in its own type at the start of eight bytes.
void tai_rt_device_launch(TaiFrame *frame, int32_t function, int64_t iterations,
                          const uint64_t *slots, int32_t count);

/// Zeroed device memory for values that one part of the kernel hands on to
/// another, aligned to 256 bytes; valid for the work of this launch.
void *tai_rt_device_scratch(TaiFrame *frame, int64_t bytes);

/// Waits, and copies `bytes` bytes from the device.
void tai_rt_device_fetch(TaiFrame *frame, void *to, const void *from,
                         int64_t bytes);

/// To be called after a launch of device code that makes cells of this tree
/// active, or (`removes`) inactive. For tai_rt_active_cells and the like,
/// `tree` is the base in the memory of the device too, and so is the list that
/// they yield.
void tai_rt_device_activates(TaiFrame *frame, void *tree, int32_t removes);

/// The address by which the device can use an array of the caller: itself where
/// it is device memory, else that of a copy. With `written`, the copy is
/// brought back when the kernel returns.
void *tai_rt_device_array(TaiFrame *frame, void *array, int64_t bytes,
                          int32_t written);

/// The state of the device that services of device code use (failures, output,
/// random numbers, memory): what they know as their frame.
void *tai_rt_device_state(TaiFrame *frame);

//===----------------------------------------------------------------------===//
// Host programs (`func.func` run by tai-run)
//===----------------------------------------------------------------------===//

/// Launches a kernel of the same module by name, with argument slots as above.
int32_t tai_rt_host_launch(TaiFrame *frame, const char *kernel,
                           const uint64_t *args, int64_t slots,
                           uint64_t *results, int64_t result_slots);
/// Begins recording; ends it and runs the reverse sweep for the named loss.
int32_t tai_rt_host_tape_begin(TaiFrame *frame, const char *loss);
int32_t tai_rt_host_tape_end(TaiFrame *frame);
/// Runs `region(frame, closure)` under a tape and compares the gradient with
/// central differences; `wrt` are `count` field names.
int32_t tai_rt_host_check_gradient(TaiFrame *frame, const char *loss,
                                   const char **wrt, int64_t count,
                                   double tolerance,
                                   int32_t (*region)(TaiFrame *, void *),
                                   void *closure, const char *where);

#ifdef __cplusplus
}
#endif

#endif // TAI_ABI_ABI_H
