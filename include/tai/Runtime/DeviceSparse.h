//===- DeviceSparse.h - Sparse levels in the memory of a device -*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What device code must know of the sparse levels of a tree to change which
// cells are active, in C. The host writes it when the tree gets its memory on
// the device; the address of a TaiDeviceTree stands in the eight bytes in front
// of the base of the tree. All addresses are of the device.
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

/// Bits of TaiDeviceNode::changes.
#define TAI_DEVICE_ACTIVITY_CHANGED 1u
#define TAI_DEVICE_CELLS_REMOVED 2u

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
  /// What has happened since the host looked. In `removed`, laid out as the
  /// bits or lengths are, what was made inactive.
  uint32_t *changes;
  void *removed;
  /// For failures: a number that no cell has, and a list that is full.
  const char *rangeMessage, *fullMessage;
} TaiDeviceNode;

typedef struct TaiDeviceTree {
  /// Levels above before levels below.
  int64_t numNodes;
  const TaiDeviceNode *nodes;
  const TaiDeviceStep *steps;
} TaiDeviceTree;

#ifdef __cplusplus
} // extern "C"
#endif

#endif // TAI_RUNTIME_DEVICESPARSE_H
