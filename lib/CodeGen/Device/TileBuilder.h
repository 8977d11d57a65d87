//===- TileBuilder.h - Launches that share tiles, as code -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_DEVICE_TILEBUILDER_H
#define TAI_LIB_CODEGEN_DEVICE_TILEBUILDER_H

#include "mlir/Support/LLVM.h"
#include "tai/Runtime/Queue/ProgramTiles.h"
#include "llvm/IR/IRBuilder.h"

namespace mlir::tai {

/// Keeps the loop of this branch back from being unrolled.
void disableUnrolling(llvm::Instruction *back);

/// Emits what a block does for a chain of launches, which is one tile; nothing
/// for a block that has none. Its threads go through the cells together.
class TileBuilder {
public:
  /// `bodies` do one iteration each, by the numbers of their parts. `overlay`
  /// is the memory of the block, which has so many threads.
  TileBuilder(llvm::IRBuilder<> &builder, const runtime::TileChain &chain,
              ArrayRef<llvm::Function *> bodies, llvm::Value *overlay,
              unsigned threads, bool isCuda);

  /// Each of them takes the parameters of all launches.
  /// Fills the overlay, as far as it starts with what is in memory. All threads
  /// must meet afterwards.
  void emitLoads(ArrayRef<llvm::Value *> slots);
  /// Runs all launches in the overlay. No other thread has written what one of
  /// them then stores.
  void emitStages(ArrayRef<llvm::Value *> slots);
  /// Writes the tile's own part of the overlay.
  void emitStores(ArrayRef<llvm::Value *> slots);

private:
  /// A cell of the window that overlays have: how far it is from the first cell
  /// of the tile, the indices of its iteration, and its place in the window.
  struct Cell {
    SmallVector<llvm::Value *> distance, index;
    llvm::Value *place = nullptr;
  };
  using CellEmitter = llvm::function_ref<void(const Cell &cell)>;

  Cell getCell(llvm::Value *number);
  void forEachCell(const runtime::TileHalo &halo, CellEmitter emit);
  llvm::Value *isWithin(const Cell &cell, const runtime::TileHalo &halo);
  llvm::Value *isInBox(const Cell &cell);
  void emitIf(llvm::Value *condition, llvm::function_ref<void()> emit);
  llvm::Value *getPlace(StringRef function);
  llvm::Value *getOverlay(llvm::IRBuilder<> &at, const runtime::TileRow &row,
                          llvm::Value *base, llvm::Value *place,
                          const runtime::TileSite *site);
  llvm::Value *getMemory(const runtime::TileRow &row, llvm::Value *origin,
                         ArrayRef<llvm::Value *> indices);
  llvm::Value *getOrigin(const runtime::TileRow &row,
                         ArrayRef<llvm::Value *> slots);
  llvm::Function *makeStage(const runtime::TileStage &stage);
  llvm::Type *getType(const runtime::TileRow &row) {
    return builder.getIntNTy(static_cast<unsigned>(row.site.access.size * 8));
  }
  llvm::Value *number(int64_t value) {
    return builder.getInt32(static_cast<uint32_t>(value));
  }

  llvm::IRBuilder<> &builder;
  const runtime::TileChain &chain;
  ArrayRef<llvm::Function *> bodies;
  llvm::Value *overlay;
  bool isCuda;
  size_t rank;
  /// That of all overlays, and its cells.
  const runtime::TileHalo &window;
  int64_t numCells = 1;
  SmallVector<int64_t> extents;
  /// Whether the block has a tile; the first index of that along each
  /// dimension.
  llvm::Value *hasTile;
  SmallVector<llvm::Value *> first;
  /// Of the thread, where there is a thread for each.
  std::optional<Cell> own;
  llvm::Value *hasOwn = nullptr;
};

/// Eight bytes as a parameter of this type, which is at the start of them.
llvm::Value *convertSlot(llvm::IRBuilder<> &builder, llvm::Value *word,
                         llvm::Type *type, bool isCuda);

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_DEVICE_TILEBUILDER_H
