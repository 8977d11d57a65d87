//===- Tai.h - The tai dialect ----------------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Types, attributes, ops and interfaces of the dialect.
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
/// Size in bytes of a cell that holds `children`, padded to its alignment.
uint64_t computeCellSize(ArrayRef<Type> children, const DataLayout &layout);
/// Alignment in bytes of a cell that holds `children`.
uint64_t computeCellAlignment(ArrayRef<Type> children,
                              const DataLayout &layout);
/// Strides of contiguous cells of the given size.
SmallVector<uint64_t> computeRowMajorStrides(ArrayRef<int64_t> shape,
                                             uint64_t cellSize);

/// How a level records which of its cells are active.
enum class CellActivity {
  All,    ///< every cell is always active
  Bits,   ///< a bit for each cell
  Length, ///< cells form lists; cells below the length of a list are active
};

/// A cell of a sparse level, in IR that is being built.
struct CellRef {
  /// The address of the tree, and the number of the level among the sparse
  /// levels of the tree.
  Value tree;
  unsigned node;
  /// The offset of the level's activity bits or list lengths, in bytes from the
  /// tree.
  uint64_t activityOffset;
  /// The number of cells of the level in one parent cell; for a list, the
  /// capacity.
  int64_t capacity;
  /// The number of the cell among all cells of its level, a value of type
  /// index.
  Value cell;
};

/// The address of an array of the numbers of active cells, and its length.
struct CellList {
  Value cells, count;
};

// Default implementations of SNodeTypeInterface.
Value emitIsActive(OpBuilder &builder, Location loc, CellActivity activity,
                   const CellRef &cell);
Value emitActivate(OpBuilder &builder, Location loc, const CellRef &cell);
void emitDeactivate(OpBuilder &builder, Location loc, const CellRef &cell);
/// The length of list number `list`, a value of type index; ignores `at.cell`.
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
