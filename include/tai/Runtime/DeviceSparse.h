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

#ifndef TAI_RUNTIME_DEVICESPARSE_H
#define TAI_RUNTIME_DEVICESPARSE_H

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

/// Words of bits, or lengths of lists, that a block takes at a time when it
/// makes a list.
#define TAI_DEVICE_LIST_TILE 1024

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
  /// For failures: a number that no cell has, and a list that is full.
  const char *rangeMessage, *fullMessage;
} TaiDeviceNode;

typedef struct TaiDeviceTree {
  /// Levels above before levels below.
  int64_t numNodes;
  const TaiDeviceNode *nodes;
  const TaiDeviceStep *steps;
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

/// Makes the cells of a list inactive and zeroes them.
void tai_dev_deactivate_list(uint64_t tree, uint64_t node, uint64_t list);

#ifdef __cplusplus
} // extern "C"
#endif

#endif // TAI_RUNTIME_DEVICESPARSE_H
