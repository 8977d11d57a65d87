//===- DeviceSparse.h - Sparse levels in the memory of a device -*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What device code must know of the sparse levels of a tree to change which
// cells are active and to list them, in C. The host writes it when the tree
// gets its memory on the device; the address of a TaiDeviceTree stands in the
// eight bytes in front of the base of the tree. All addresses are of the
// device.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ABI_DEVICESPARSE_H
#define TAI_ABI_DEVICESPARSE_H

#include <stdint.h>

/// Bytes in front of the base of a sparse tree.
#define TAI_DEVICE_TREE_HEADER 256

#ifdef __cplusplus
extern "C" {
#endif

/// A level from the root to a sparse one: its cells below one cell of the level
/// above, and the distance between them in bytes.
typedef struct TaiDeviceStep {
  int64_t cells;
  int64_t stride;
} TaiDeviceStep;

/// Bits of TaiDeviceActivity::changes.
#define TAI_DEVICE_ACTIVITY_CHANGED 1u
#define TAI_DEVICE_CELLS_REMOVED 2u

/// What happens to the activity of a level.
typedef struct TaiDeviceActivity {
  /// Since the host looked.
  uint32_t changes;
  /// Non-zero if the activity is another one than that of `version`.
  uint32_t isNew;
  /// A number for the activity for which a list was last asked for, from 1 on.
  uint64_t version;
} TaiDeviceActivity;

/// In front of the numbers of the cells of a list, ascending.
typedef struct TaiDeviceListHeader {
  /// Non-zero while the list is being made.
  uint64_t isOld;
  /// TaiDeviceActivity::version of what it shows; 0 for nothing yet.
  uint64_t version;
  uint64_t reserved;
  /// The word in front of the first cell: loops read it there.
  int64_t count;
} TaiDeviceListHeader;

/// Where a field has its elements in the cells of the innermost sparse level
/// above it.
typedef struct TaiDeviceCellMove {
  int32_t node;
  int32_t scalarBytes;
  /// In one cell, and how far each is from the first component of the first
  /// element, which is `place` bytes from the base of the tree in cell 0.
  int64_t scalars;
  int64_t place;
  const int64_t *offsets;
} TaiDeviceCellMove;

/// What tai_dev_move_cells does to the elements: copies them to a dense array,
/// from one, both, or makes each scalar the same.
#define TAI_CELLS_LOAD 0
#define TAI_CELLS_STORE 1
#define TAI_CELLS_EXCHANGE 2
#define TAI_CELLS_FILL 3

/// Words of bits, or lengths of lists, that a block takes at a time when it
/// makes a list.
#define TAI_DEVICE_LIST_TILE 1024

/// What active cells of a tree take, and may take, in bytes.
typedef struct TaiDeviceAccount {
  int64_t used;
  int64_t limit;
  /// Of a tree whose memory takes room where it is touched, else null: a bit
  /// for each piece of `pieceBytes` from `origin` on that has cells which have
  /// been active, and the bytes that those take, and may take.
  uint64_t *pieces;
  uint64_t origin;
  int64_t pieceBytes;
  int64_t inPieces;
  int64_t mostInPieces;
} TaiDeviceAccount;

typedef struct TaiDeviceNode {
  /// Non-zero for a `dynamic` level: a length for each list; else a bit for
  /// each cell.
  int32_t isList;
  /// The nearest sparse level above, or -1.
  int32_t parent;
  /// Of the steps of the tree.
  int32_t firstStep, steps;
  int64_t cells;
  /// Cells of this level below one cell of `parent`.
  int64_t cellsBelow;
  /// The most cells of a list.
  int64_t capacity;
  int64_t cellBytes;
  /// Of cell 0, and of the bits or lengths, in the tree.
  int64_t offset, activityOffset;
  TaiDeviceActivity *activity;
  /// What was made inactive since the host looked, laid out as the bits or
  /// lengths are.
  void *removed;
  /// A bit for each word of bits, or for each list, that is not zero; it may be
  /// zero again.
  uint64_t *marks;
  /// For failures: a number that no cell has, a list that is full, and no room
  /// for one more cell; the last is null where cells hold other cells and are
  /// not counted.
  const char *rangeMessage, *fullMessage, *memoryMessage;
  /// For no room for one more piece; null like the one before.
  const char *pieceMessage;
  /// Non-zero if a cell consists of cells of the levels next below: where those
  /// that are active are zeroed, it is all zero.
  int32_t holdsCellsAlone;
} TaiDeviceNode;

typedef struct TaiDeviceTree {
  /// Levels above before levels below.
  int64_t numNodes;
  const TaiDeviceNode *nodes;
  const TaiDeviceStep *steps;
  TaiDeviceAccount *account;
} TaiDeviceTree;

//===----------------------------------------------------------------------===//
// Kernels of the device library
//===----------------------------------------------------------------------===//
//
// The runtime itself launches these. `tree` is the base of a sparse tree,
// `node` the number of a level, `list` the address of a TaiDeviceListHeader
// with room for all cells that may be active behind it.

/// Makes the list of the active cells unless it is that already. By one block,
/// or, where there are many cells, by three launches one after another, of
/// which the second is one of one block. `sums` has a word for each tile.
void tai_dev_list_cells(uint64_t tree, uint64_t node, uint64_t list);
void tai_dev_list_count(uint64_t tree, uint64_t node, uint64_t list,
                        uint64_t sums);
void tai_dev_list_scan(uint64_t tree, uint64_t node, uint64_t list,
                       uint64_t sums);
void tai_dev_list_write(uint64_t tree, uint64_t node, uint64_t list,
                        uint64_t sums);

/// Copies or fills the elements of a field in `count` cells, of which `cells`
/// is the address of the numbers; a negative count is the word in front of
/// them. `move` is the address of a TaiDeviceCellMove, `other` that of a dense
/// array, or a scalar.
void tai_dev_move_cells(uint64_t tree, uint64_t move, uint64_t cells,
                        uint64_t count, uint64_t other, uint64_t what);
/// Copies what has happened to activity since the host looked, and forgets that
/// it has: at `to`, TaiDeviceActivity::changes of each level in a word, then
/// for each level its bits or lengths, and what was removed, each in whole
/// words; without those where nothing has happened. By one block.
void tai_dev_keep_activity(uint64_t tree, uint64_t to);
/// Makes the cells of a list inactive, and zeroes them unless they hold cells
/// of other levels alone: those must be zero.
void tai_dev_deactivate_list(uint64_t tree, uint64_t node, uint64_t list);

#ifdef __cplusplus
} // extern "C"
#endif

#endif // TAI_ABI_DEVICESPARSE_H
