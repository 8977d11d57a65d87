//===- FillTable.h - Several fills as one kernel ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A table of fills is the parameter of a kernel, so that a graph holds it and
// it can be updated like other parameters. Each fill is divided into tiles,
// which are distributed to blocks in turn. In C, for the kernel itself, for the
// host that builds the table, and for tests, where the fake driver runs the
// same code.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_CUDA_FILLTABLE_H
#define TAI_LIB_RUNTIME_CUDA_FILLTABLE_H

// Qualifiers of the functions below, which host and device code compile.
#ifndef TAI_FILL_FUNCTION
#define TAI_FILL_FUNCTION static inline
#endif

typedef unsigned long long TaiFillSize;

/// The number of entries of a fill table, of threads in a block of the fill
/// kernel, and of units of a tile that each thread stores.
enum { taiFillEntries = 16, taiFillThreads = 256, taiFillEach = 4 };

/// The maximum number of bytes of a fill of several rows: its units are counted
/// in 32 bits.
static const TaiFillSize taiFillMostBytes = 0xf0000000;

/// An entry of a fill table: rows of whole units, and for a single row also
/// some bytes before and after the units.
typedef struct {
  /// The address of the first unit of the fill, a multiple of the unit's size.
  TaiFillSize address;
  /// The pattern that each row of the fill starts with and repeats.
  TaiFillSize pattern;
  /// The number of units of the fill in total, and in each row.
  TaiFillSize units, rowUnits;
  /// The number of rows of strided memory in a group; the strides of rows and
  /// of groups, in units.
  TaiFillSize rows, step, outerStep;
  /// The number of tiles of this entry and all entries before it in the table.
  TaiFillSize end;
  /// The bytes of a unit: 1, 4, 8 or 16. For a single row, the number of bytes
  /// (below 16) before the first unit and after the last.
  unsigned char unitBytes, head, tail;
} TaiFillEntry;

typedef struct {
  TaiFillSize count;
  TaiFillEntry entries[taiFillEntries];
} TaiFillTable;

/// Adds a fill of `outer` groups of `rows` rows; the table must not be full.
/// Each row starts with the pattern of eight bytes. Several rows must be
/// smaller than taiFillMostBytes in total.
TAI_FILL_FUNCTION void taiFillAdd(TaiFillTable *table, TaiFillSize address,
                                  TaiFillSize step, TaiFillSize rowBytes,
                                  TaiFillSize rows, TaiFillSize outerStep,
                                  TaiFillSize outer, TaiFillSize pattern) {
  TaiFillSize tileUnits = taiFillThreads * taiFillEach;
  TaiFillEntry entry = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0};
  TaiFillSize before = table->count ? table->entries[table->count - 1].end : 0;
  if (rows == 1 && outer == 1) {
    TaiFillSize head = -address % 16, turn;
    if (head > rowBytes)
      head = rowBytes;
    turn = head % 8 * 8;
    entry.unitBytes = 16;
    entry.head = (unsigned char)head;
    entry.tail = (unsigned char)((rowBytes - head) % 16);
    entry.address = address + head;
    entry.pattern = turn ? pattern >> turn | pattern << (64 - turn) : pattern;
    entry.units = entry.rowUnits = (rowBytes - head) / 16;
    entry.rows = 1;
  } else {
    TaiFillSize all = address | rowBytes | (rows > 1 ? step : 0) |
                      (outer > 1 ? outerStep : 0);
    TaiFillSize unit = all % 16 == 0  ? 16
                       : all % 8 == 0 ? 8
                       : all % 4 == 0 ? 4
                                      : 1;
    entry.unitBytes = (unsigned char)unit;
    entry.address = address;
    entry.pattern = pattern;
    entry.rowUnits = rowBytes / unit;
    entry.units = entry.rowUnits * rows * outer;
    entry.rows = rows;
    entry.step = rows > 1 ? step / unit : 0;
    entry.outerStep = outer > 1 ? outerStep / unit : 0;
  }
  if (entry.units == 0 && entry.head == 0 && entry.tail == 0)
    return;
  entry.end = before + (entry.units + tileUnits - 1) / tileUnits;
  // A fill without whole units still needs a tile, for its single bytes.
  if (entry.units == 0)
    entry.end = before + 1;
  table->entries[table->count++] = entry;
}

/// Returns the position in memory of unit i of a fill, in units from the first
/// unit; sets `*at` to its position in its row.
TAI_FILL_FUNCTION TaiFillSize taiFillPlace(const TaiFillEntry *entry,
                                           TaiFillSize i, TaiFillSize *at) {
  *at = i;
  if (entry->rowUnits == entry->units)
    return i;
  // Divisions of 64 bits take as long as a read from memory.
  unsigned rowUnits = (unsigned)entry->rowUnits, row = (unsigned)i, group = 0;
  if (rowUnits != 1)
    row /= rowUnits;
  *at = (unsigned)i - row * rowUnits;
  if (entry->outerStep) {
    group = row / (unsigned)entry->rows;
    row -= group * (unsigned)entry->rows;
  }
  return group * entry->outerStep + row * entry->step + *at;
}

typedef unsigned char TaiFillByte;
typedef unsigned TaiFillWord __attribute__((may_alias));
typedef unsigned long long TaiFillPair __attribute__((may_alias));
typedef unsigned long long TaiFillQuad
    __attribute__((may_alias, vector_size(16)));

// The global address space of the device.
#ifdef __NVPTX__
#define TAI_FILL_GLOBAL __attribute__((address_space(1)))
#else
#define TAI_FILL_GLOBAL
#endif

#define TAI_FILL_UNITS(Unit, value)                                            \
  for (int k = 0; k < taiFillEach; ++k, i += taiFillThreads)                   \
    if (i < entry->units) {                                                    \
      TaiFillSize place = taiFillPlace(entry, i, &at);                         \
      *(TAI_FILL_GLOBAL Unit *)(entry->address + place * sizeof(Unit)) =       \
          (value);                                                             \
    }

/// Stores the part of a tile that belongs to one thread of a block.
TAI_FILL_FUNCTION void taiFillTile(const TaiFillEntry *entry, TaiFillSize tile,
                                   unsigned thread) {
  TaiFillSize i = tile * (taiFillThreads * taiFillEach) + thread, at = 0;
  TaiFillSize pattern = entry->pattern;
  if (entry->unitBytes == 16) {
    TaiFillQuad both = {pattern, pattern};
    TAI_FILL_UNITS(TaiFillQuad, both)
    if (tile > 0)
      return;
    TaiFillSize end = entry->address + entry->units * 16;
    if (thread < entry->head)
      *(TAI_FILL_GLOBAL TaiFillByte *)(entry->address - 1 - thread) =
          (TaiFillByte)(pattern >> (7 - thread % 8) * 8);
    if (thread < entry->tail)
      *(TAI_FILL_GLOBAL TaiFillByte *)(end + thread) =
          (TaiFillByte)(pattern >> thread % 8 * 8);
  } else if (entry->unitBytes == 8) {
    TAI_FILL_UNITS(TaiFillPair, pattern)
  } else if (entry->unitBytes == 4) {
    TAI_FILL_UNITS(TaiFillWord, (TaiFillWord)(pattern >> at % 2 * 32))
  } else {
    TAI_FILL_UNITS(TaiFillByte, (TaiFillByte)(pattern >> at % 8 * 8))
  }
}

/// Stores the part of all fills that belongs to one thread of a block.
TAI_FILL_FUNCTION void taiFillAll(const TaiFillTable *table, TaiFillSize block,
                                  TaiFillSize blocks, unsigned thread) {
  TaiFillSize all = table->entries[table->count - 1].end, first = 0;
  unsigned number = 0;
  for (TaiFillSize tile = block; tile < all; tile += blocks) {
    while (tile >= table->entries[number].end)
      first = table->entries[number++].end;
    taiFillTile(&table->entries[number], tile - first, thread);
  }
}

#endif // TAI_LIB_RUNTIME_CUDA_FILLTABLE_H
