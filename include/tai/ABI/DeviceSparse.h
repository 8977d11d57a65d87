//===- DeviceSparse.h - Sparse levels in the memory of a device -*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The description of a tree's sparse levels from which device code activates,
// deactivates and lists cells, in C. The host writes it when the tree is
// allocated on the device; the eight bytes in front of the base of the tree
// hold the address of its TaiDeviceTree. All addresses are device addresses.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ABI_DEVICESPARSE_H
#define TAI_ABI_DEVICESPARSE_H

#include <stdint.h>

/// Bytes reserved in front of the base address of a sparse tree.
#define TAI_DEVICE_TREE_HEADER 256

#ifdef __cplusplus
extern "C" {
#endif

/// A level on the path from the root to a sparse level: its cells below one
/// cell of the level above, and the distance between them in bytes.
typedef struct TaiDeviceStep {
  int64_t cells;
  int64_t stride;
} TaiDeviceStep;

/// Bits of TaiDeviceActivity::changes.
#define TAI_DEVICE_ACTIVITY_CHANGED 1u
#define TAI_DEVICE_CELLS_REMOVED 2u

/// How the activity of a sparse level has changed on the device.
typedef struct TaiDeviceActivity {
  /// The bits TAI_DEVICE_ACTIVITY_CHANGED and TAI_DEVICE_CELLS_REMOVED, set for
  /// changes since the host last read this member.
  uint32_t changes;
  /// Non-zero if the activity has changed since the version number `version` of
  /// it.
  uint32_t isNew;
  /// Counts, from 1 on, the versions of the activity for which a list was
  /// requested.
  uint64_t version;
} TaiDeviceActivity;

/// Stands in memory in front of a list of active cells, which are given by
/// ascending numbers.
typedef struct TaiDeviceListHeader {
  /// Non-zero while the list of active cells is being recomputed.
  uint64_t isOld;
  /// The TaiDeviceActivity::version from which the list was computed; 0 if it
  /// never was.
  uint64_t version;
  uint64_t reserved;
  /// The number of cells in the list. Loops read it in the word in front of the
  /// first cell.
  int64_t count;
} TaiDeviceListHeader;

/// Describes where a field's elements lie in the cells of the innermost sparse
/// level above the field.
typedef struct TaiDeviceCellMove {
  int32_t node;
  int32_t scalarBytes;
  /// Scalars in one cell, and the `offsets` in bytes of each from the first
  /// component of the first element, which is `place` bytes from the base of
  /// the tree in cell 0.
  int64_t scalars;
  int64_t place;
  const int64_t *offsets;
} TaiDeviceCellMove;

/// The effect of tai_dev_move_cells on the elements: copies them to a dense
/// array, copies them from a dense array, exchanges both, or fills the elements
/// with one scalar.
#define TAI_CELLS_LOAD 0
#define TAI_CELLS_STORE 1
#define TAI_CELLS_EXCHANGE 2
#define TAI_CELLS_FILL 3

/// The number of words of activity (bits of cells, or lengths of lists) that a
/// thread block processes at a time when it computes a list of active cells.
#define TAI_DEVICE_LIST_TILE 1024

/// The bytes that active cells of a tree use, and their limit.
typedef struct TaiDeviceAccount {
  int64_t used;
  int64_t limit;
  /// For a tree whose memory is committed when first touched, a bit for each
  /// piece of `pieceBytes` bytes, from `origin` on, that holds cells which have
  /// been active; otherwise null. `inPieces` and `mostInPieces` are the bytes
  /// of these pieces, and their limit.
  uint64_t *pieces;
  uint64_t origin;
  int64_t pieceBytes;
  int64_t inPieces;
  int64_t mostInPieces;
} TaiDeviceAccount;

typedef struct TaiDeviceNode {
  /// Non-zero for a `dynamic` level, whose activity is a length for each list;
  /// otherwise the activity is a bit for each cell.
  int32_t isList;
  /// The number of the nearest sparse level above, or -1.
  int32_t parent;
  /// The address computation of the level: the index of the first of its steps
  /// in TaiDeviceTree::steps, and the number of steps.
  int32_t firstStep, steps;
  int64_t cells;
  /// The number of cells of this level below one cell of the level `parent`.
  int64_t cellsBelow;
  /// For a `dynamic` level, the maximum length of a list.
  int64_t capacity;
  int64_t cellBytes;
  /// Byte offsets, from the base of the tree, of cell 0 and of the level's
  /// activity.
  int64_t offset, activityOffset;
  TaiDeviceActivity *activity;
  /// The cells deactivated since the host last read this memory, laid out like
  /// the level's activity (bits or lengths).
  void *removed;
  /// Bit i is set if word i of the level's activity has ever been non-zero.
  /// Conservative: the word may have become zero again.
  uint64_t *marks;
  /// Failure messages: a cell number is out of range, a list is full, the
  /// memory limit is exceeded. The last message is null for a level whose cells
  /// only hold cells of other levels, and are not counted.
  const char *rangeMessage, *fullMessage, *memoryMessage;
  /// The failure message if the limit of committed pieces is exceeded; null if
  /// memoryMessage is null.
  const char *pieceMessage;
  /// Non-zero if a cell consists of cells of the next levels alone: such a cell
  /// is zero once its active cells of those levels are zeroed.
  int32_t holdsCellsAlone;
} TaiDeviceNode;

typedef struct TaiDeviceTree {
  /// The number of sparse levels of the tree, stored so that parents come
  /// before children.
  int64_t numNodes;
  const TaiDeviceNode *nodes;
  const TaiDeviceStep *steps;
  TaiDeviceAccount *account;
} TaiDeviceTree;

//===----------------------------------------------------------------------===//
// Kernels of the device library
//===----------------------------------------------------------------------===//
//
// The runtime itself launches these kernels. `tree` is the base of a sparse
// tree, `node` the number of a level, `list` the address of a
// TaiDeviceListHeader followed by room for all cells of the level.

/// Computes the list of active cells unless it is up to date. Launched with one
/// block, or, for many cells, as three launches one after another (count, scan
/// by one block, write). `sums` has a word for each tile.
void tai_dev_list_cells(uint64_t tree, uint64_t node, uint64_t list);
void tai_dev_list_count(uint64_t tree, uint64_t node, uint64_t list,
                        uint64_t sums);
void tai_dev_list_scan(uint64_t tree, uint64_t node, uint64_t list,
                       uint64_t sums);
void tai_dev_list_write(uint64_t tree, uint64_t node, uint64_t list,
                        uint64_t sums);

/// Copies or fills the elements of a field in `count` cells, whose numbers are
/// at the address `cells`; with a negative count, the word in front of the
/// numbers is the count. `move` is the address of a TaiDeviceCellMove, `other`
/// the address of a dense array, or a scalar; `what` is one of TAI_CELLS_*.
void tai_dev_move_cells(uint64_t tree, uint64_t move, uint64_t cells,
                        uint64_t count, uint64_t other, uint64_t what);
/// Copies the changes to activity since the host last read them, and resets
/// them: at `to`, TaiDeviceActivity::changes of each level in a word; then, for
/// each level with changes, its bits or lengths and its removed cells, each in
/// whole words. Launched with one block.
void tai_dev_keep_activity(uint64_t tree, uint64_t to);
/// Deactivates the cells of a list, and zeroes them unless they hold cells of
/// other levels alone, which must have been zeroed before.
void tai_dev_deactivate_list(uint64_t tree, uint64_t node, uint64_t list);

#ifdef __cplusplus
} // extern "C"
#endif

#endif // TAI_ABI_DEVICESPARSE_H
