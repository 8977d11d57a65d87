//===- Abi.h - ABI of kernels and runtime -----------------------*- C++ -*-===//
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

#define TAI_ABI_VERSION 11

#ifdef __cplusplus
extern "C" {
#endif

typedef struct TaiRuntime TaiRuntime;

/// The context of one launch: memory, arguments, results. Offsets are part of
/// the interface: compiled code reads the members by position.
typedef struct TaiFrame {
  /// Base address of each tree that the module of the kernel declares, in the
  /// order of its `tai.tree` ops.
  void **trees;
  /// Arguments in slots of eight bytes: a scalar takes one slot (stored in its
  /// own type at the start of the slot, i1 as one byte, index as int64), a
  /// vector or matrix one slot for each component (row-major), a memref one
  /// pointer slot followed by one int64 slot for each dimension (row-major,
  /// contiguous).
  const uint64_t *args;
  /// The returned value, in slots of eight bytes laid out like those of
  /// arguments.
  uint64_t *results;
  TaiRuntime *runtime;
  /// Two keys of the random numbers of `tai.random`: the seed of the context,
  /// and the number of this launch.
  uint64_t seed;
  uint64_t launch;
  /// The last tick of the safepoint clock that this launch has seen; see
  /// tai_rt_safepoint.
  uint64_t tick;
  /// Bit n is set if the n-th adjoint field that the kernel can store without
  /// reading it counts as zero, whatever its memory holds: see
  /// `tai_rt.starts_at_zero`.
  uint64_t zeroAdjoints;
} TaiFrame;

/// The float types of a field and of the private buffers that are added to it:
/// both f32, both f64, or f32 for the field and f64 for the buffers.
enum { kSumsF32 = 0, kSumsF64 = 1, kSumsWide = 2 };

/// The type of a compiled kernel. The function returns 0, or non-zero if the
/// launch failed (the runtime holds the message).
typedef int32_t (*TaiKernelFn)(TaiFrame *frame);

/// The body of a parallel loop: runs the iterations [begin, end) of the
/// linearised index space. `part` in [0, parts) names the partition, for
/// partial sums and private buffers.
typedef void (*TaiLoopBody)(TaiFrame *frame, void *closure, int64_t begin,
                            int64_t end, int64_t part);

/// A stack of scalars in slots of eight bytes. The first TAI_STACK_SLOTS slots
/// are stored inline, in memory directly after the structure.
#define TAI_STACK_SLOTS 13
typedef struct TaiStack {
  char *slots;
  int64_t size;
  int64_t capacity;
} TaiStack;

/// Types of the values in printed lines and in failure messages.
enum TaiValueKind {
  TAI_VALUE_I64 = 0, // int64_t slot (all integers are sign-extended)
  TAI_VALUE_F64 = 1, // double slot (all floats are extended)
  TAI_VALUE_U64 = 2,
  TAI_VALUE_BOOL = 3
};

/// A printed format that ends in this character (ETX) gets no newline.
#define TAI_SAME_LINE '\3'

/// Kinds of failures; see tai_rt_fail.
enum TaiFailure {
  TAI_FAIL_ASSERT = 1,
  TAI_FAIL_INDEX = 2,
  TAI_FAIL_MEMORY = 3,
  TAI_FAIL_CHECK = 4
};

/// An operation that shadow execution observes. The structure is followed in
/// memory by the text "operation\nkernel\nplace".
typedef struct TaiShadowSite {
  uint64_t log; // the log in which the site is registered, or 0
  void *site;   // the log's entry for the site
} TaiShadowSite;

/// The counts of one observed operation (TaiShadowSite) in one run of a
/// function.
typedef struct TaiShadowCount {
  int64_t lost;
  int64_t cancellations;
  /// A result whose error is below this fraction of its shadow is not the worst
  /// result of the site. 0 until the run has reported a result.
  double reach;
  void *site; // set by the first report
} TaiShadowCount;

/// Followed in memory by a TaiShadowCount for each site of the function.
typedef struct TaiShadowCounts {
  int64_t any; // not 0 if the run has reported a result
} TaiShadowCounts;

/// Kinds of atomic updates that shadow execution observes; see
/// tai_rt_shadow_atomic.
enum TaiShadowUpdate {
  TAI_SHADOW_ADD = 0,
  TAI_SHADOW_SUB = 1,
  TAI_SHADOW_MIN = 2,
  TAI_SHADOW_MAX = 3,
  TAI_SHADOW_XCHG = 4
};
/// The table of shadows is indexed by these low bits of an address: the shadow
/// is at twice their value, because it is twice as wide as the float.
#define TAI_SHADOW_MASK ((UINT64_C(1) << 34) - 1)

#define TAI_ENTRY(result, name, parameters) result tai_rt_##name parameters;
#include "tai/ABI/Abi.def"

#ifdef __cplusplus
}
#endif

#endif // TAI_ABI_ABI_H
