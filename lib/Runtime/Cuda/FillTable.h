//===- FillTable.h - Several fills as one kernel ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A table of fills is the parameter of a kernel, so that a graph holds it and
// it changes as parameters do. Each fill is cut into tiles, which all blocks
// take in turn. In C, for the kernel itself, for the host that makes the table,
// and for tests, where the driver without a GPU runs the same code.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_CUDA_FILLTABLE_H
#define TAI_LIB_RUNTIME_CUDA_FILLTABLE_H

// What stands in front of functions.
#ifndef TAI_FILL_FUNCTION
#define TAI_FILL_FUNCTION static inline
#endif

typedef unsigned long long TaiFillSize;

/// The threads of a block, and how many units each of them stores of a tile.
enum { taiFillEntries = 16, taiFillThreads = 256, taiFillEach = 4 };

/// Units of rows are counted in 32 bits.
static const TaiFillSize taiFillMostBytes = 0xf0000000;

/// Rows of units, and some bytes in front of and behind them.
typedef struct {
  /// Of the first unit, a multiple of its size.
  TaiFillSize address;
  /// What rows start with, again and again.
  TaiFillSize pattern;
  /// All units, and those of a row.
  TaiFillSize units, rowUnits;
  /// Of a group of rows; from one row to the next, and from one group to the
  /// next, in units.
  TaiFillSize rows, step, outerStep;
  /// The tiles of this entry and of those before it.
  TaiFillSize end;
  /// The bytes of a unit: 1, 4, 8 or 16. Less than 16 bytes before the first
  /// unit, and behind the last, where there is one row.
  unsigned char unitBytes, head, tail;
} TaiFillEntry;

typedef struct {
  TaiFillSize count;
  TaiFillEntry entries[taiFillEntries];
} TaiFillTable;

/// Adds a fill of `outer` times `rows` rows, for which there is room. Each
/// starts with the pattern, of eight bytes. Of several rows there are less than
/// taiFillMostBytes bytes.
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
  // Some bytes are worth a tile, too.
  if (entry.units == 0)
    entry.end = before + 1;
  table->entries[table->count++] = entry;
}

/// Where unit i lies, in units behind the first, and in its row.
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

// The memory of the device, where that is one of several.
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

/// What one thread of a block does of a tile.
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

/// What one thread of a block does of all.
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
