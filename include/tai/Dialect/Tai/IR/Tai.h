//===- Tai.h - The tai dialect ----------------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Types, attributes, ops and interfaces of the dialect tai.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAI_H
#define TAI_DIALECT_TAI_IR_TAI_H

#include "mlir/Bytecode/BytecodeOpInterface.h"
#include "mlir/IR/BuiltinAttributes.h"
#include "mlir/IR/BuiltinTypes.h"
#include "mlir/IR/Dialect.h"
#include "mlir/IR/OpDefinition.h"
#include "mlir/IR/OpImplementation.h"
#include "mlir/IR/SymbolTable.h"
#include "mlir/Interfaces/CallInterfaces.h"
#include "mlir/Interfaces/ControlFlowInterfaces.h"
#include "mlir/Interfaces/DataLayoutInterfaces.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "mlir/Interfaces/InferTypeOpInterface.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Dialect/Tai/IR/Traits.h"
#include "tai/Interfaces/FieldAccess.h"

namespace mlir::tai {
/// The size in bytes of a cell that holds `children`, padded to its alignment.
uint64_t computeCellSize(ArrayRef<Type> children, const DataLayout &layout);
/// The alignment in bytes of a cell that holds `children`.
uint64_t computeCellAlignment(ArrayRef<Type> children,
                              const DataLayout &layout);
/// The strides, in bytes, of contiguous cells of the given size in a row-major
/// array.
SmallVector<uint64_t> computeRowMajorStrides(ArrayRef<int64_t> shape,
                                             uint64_t cellSize);

/// The ways in which a level of a layout records which of its cells are active.
enum class CellActivity {
  All,    ///< every cell is always active
  Bits,   ///< a bit for each cell
  Length, ///< cells form lists; cells below the length of a list are active
};

/// Refers to a cell of a sparse level, in IR that is being built.
struct CellRef {
  /// The address of the tree of the cell, and the number of the cell's level
  /// among the sparse levels of the tree.
  Value tree;
  unsigned node;
  /// The offset of the level's activity bits or list lengths, in bytes from the
  /// tree.
  uint64_t activityOffset;
  /// The number of cells of this level in one parent cell; for a `dynamic`
  /// level, the capacity of a list.
  int64_t capacity;
  /// The number of the cell among all cells of its level in the tree, a value
  /// of type index.
  Value cell;
};

/// The address of an array with the numbers of the active cells of a level, and
/// the length of the array.
struct CellList {
  Value cells, count;
};

// Default implementations of SNodeTypeInterface, for level types that record
// activity in one of the ways of CellActivity.
Value emitIsActive(OpBuilder &builder, Location loc, CellActivity activity,
                   const CellRef &cell);
Value emitActivate(OpBuilder &builder, Location loc, const CellRef &cell);
void emitDeactivate(OpBuilder &builder, Location loc, const CellRef &cell);
/// Emits the length of list number `list`, a value of type index, of the
/// `dynamic` level of `at`. The cell of `at` is ignored.
Value emitListLength(OpBuilder &builder, Location loc, const CellRef &at,
                     Value list);
CellList emitActiveCells(OpBuilder &builder, Location loc, Value tree,
                         unsigned node);
} // namespace mlir::tai

#include "tai/Dialect/Tai/IR/TaiDialect.h.inc"
#include "tai/Dialect/Tai/IR/TaiEnums.h.inc"

#include "tai/Dialect/Tai/IR/TaiTypeInterfaces.h.inc"

#define GET_TYPEDEF_CLASSES
#include "tai/Dialect/Tai/IR/TaiTypes.h.inc"

#define GET_ATTRDEF_CLASSES
#include "tai/Dialect/Tai/IR/TaiAttrs.h.inc"

namespace mlir::tai {
/// The name that a kernel attribute has on `op`: `name` itself on a kernel; on
/// a function of another dialect, where it is discardable, `tai.` + `name`.
StringAttr getFunctionAttrName(Operation *op, StringRef name);
} // namespace mlir::tai

#define GET_OP_CLASSES
#include "tai/Dialect/Tai/IR/TaiOps.h.inc"

#endif // TAI_DIALECT_TAI_IR_TAI_H
