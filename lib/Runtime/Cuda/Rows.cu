//===- Rows.cu - Copies of evenly spaced rows, on the GPU -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What the driver's own copies do not do, or do slowly: rows of a few bytes,
// such as the elements of a field whose cells hold other fields too. Compiled
// to PTX while the project is built. Rows and the distances between them are in
// units: of 16 bytes, or the largest of eight, four and one that fits.
//
//===----------------------------------------------------------------------===//

using Byte = unsigned char;
using Word = unsigned;
using Pair = unsigned long long;
using Quad = unsigned long long __attribute__((ext_vector_type(2)));
using Size = unsigned long long;

/// What stands in a unit that starts `at` units after the begin of a row, which
/// begins with the pattern of eight bytes.
template <typename Unit> static inline Unit unitOf(Size pattern, Size at) {
  return (Unit)(pattern >> (at * sizeof(Unit) % 8 * 8));
}
template <> inline Quad unitOf<Quad>(Size pattern, Size) {
  return Quad{pattern, pattern};
}

/// Calls move(row, place in the row) for the units of this thread.
template <typename Move>
static inline void forEachUnit(Size rowUnits, Size rows, const Move &move) {
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
  }                                                                            \
  KERNEL tai_fill_##suffix(Unit *to, Size step, Size rowUnits, Size rows,      \
                           Size pattern, Size outerStep, Size outer) {         \
    forEachUnit(rowUnits, rows * outer, [&](Size row, Size at) {               \
      Size group = outer == 1 ? 0 : row / rows;                                \
      to[group * outerStep + (row - group * rows) * step + at] =               \
          unitOf<Unit>(pattern, at);                                           \
    });                                                                        \
  }

ROW_KERNELS(Byte, bytes)
ROW_KERNELS(Word, words)
ROW_KERNELS(Pair, pairs)
ROW_KERNELS(Quad, quads)
