//===- Rows.cu - Copies of evenly spaced rows, and fills, on the GPU ------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// For copies that the driver does not support, or does slowly: rows of a few
// bytes, such as the elements of a field whose cells hold other fields too.
// Compiled to PTX while the project is built. Rows and the distances between
// them are in units: of 16 bytes, or the largest of eight, four and one that
// fits. Compiled a second time for devices whose launches overlap, with
// TAI_OVERLAPS.
//
//===----------------------------------------------------------------------===//

#include "FillTable.h"

using Byte = unsigned char;
using Word = unsigned;
using Pair = unsigned long long;
using Quad = unsigned long long __attribute__((ext_vector_type(2)));
using Size = unsigned long long;

/// A kernel that may be made ready while the one before it runs waits by
/// itself, and lets the next one be made ready.
static inline void begin() {
#ifdef TAI_OVERLAPS
  asm volatile("griddepcontrol.launch_dependents;" ::: "memory");
  asm volatile("griddepcontrol.wait;" ::: "memory");
#endif
}

/// Calls move(row, place in the row) for the units of this thread.
template <typename Move>
static inline void forEachUnit(Size rowUnits, Size rows, const Move &move) {
  begin();
  Size all = rowUnits * rows;
  Size threads = (Size)__nvvm_read_ptx_sreg_nctaid_x() *
                 (Size)__nvvm_read_ptx_sreg_ntid_x();
  Size unit = (Size)__nvvm_read_ptx_sreg_ctaid_x() *
                  (Size)__nvvm_read_ptx_sreg_ntid_x() +
              (Size)__nvvm_read_ptx_sreg_tid_x();
  // Divisions of 64 bits take as long as a read from memory.
  if (all + threads < 0x100000000ull) {
    for (unsigned i = (unsigned)unit; i < (unsigned)all;
         i += (unsigned)threads) {
      unsigned row = i / (unsigned)rowUnits;
      move(row, i - row * (unsigned)rowUnits);
    }
    return;
  }
  for (; unit < all; unit += threads) {
    Size row = unit / rowUnits;
    move(row, unit - row * rowUnits);
  }
}

#define KERNEL extern "C" __attribute__((nvptx_kernel)) void

#define ROW_KERNELS(Unit, suffix)                                              \
  KERNEL tai_copy_##suffix(Unit *to, Size toStep, const Unit *from,            \
                           Size fromStep, Size rowUnits, Size rows) {          \
    forEachUnit(rowUnits, rows, [&](Size row, Size at) {                       \
      to[row * toStep + at] = from[row * fromStep + at];                       \
    });                                                                        \
  }                                                                            \
  KERNEL tai_swap_##suffix(Unit *a, Size aStep, Unit *b, Size bStep,           \
                           Size rowUnits, Size rows) {                         \
    forEachUnit(rowUnits, rows, [&](Size row, Size at) {                       \
      Unit before = a[row * aStep + at];                                       \
      a[row * aStep + at] = b[row * bStep + at];                               \
      b[row * bStep + at] = before;                                            \
    });                                                                        \
  }

ROW_KERNELS(Byte, bytes)
ROW_KERNELS(Word, words)
ROW_KERNELS(Pair, pairs)
ROW_KERNELS(Quad, quads)

KERNEL tai_fill_pieces(const TaiFillTable table) {
  begin();
  taiFillAll(&table, (Size)__nvvm_read_ptx_sreg_ctaid_x(),
             (Size)__nvvm_read_ptx_sreg_nctaid_x(),
             (unsigned)__nvvm_read_ptx_sreg_tid_x());
}
