//===- TileBuilder.h - Emits chains of launches in tiles --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_DEVICE_TILEBUILDER_H
#define TAI_LIB_CODEGEN_DEVICE_TILEBUILDER_H

#include "mlir/Support/LLVM.h"
#include "tai/Runtime/Programs/ProgramTiles.h"
#include "llvm/IR/IRBuilder.h"

namespace mlir::tai {

/// Disables unrolling of the loop whose back edge is the branch `back`.
void disableUnrolling(llvm::Instruction *back);

/// Emits the code of one block for a chain of launches: it computes one tile in
/// shared memory (the overlay). Blocks without a tile do nothing. The threads
/// of the block share the cells of the tile.
class TileBuilder {
public:
  /// Builds the code of a tile chain. `chain`: the launches. `bodies`: for each
  /// part number, the function that runs one iteration. `overlay`: shared
  /// memory of the block, which has `threads` threads.
  TileBuilder(llvm::IRBuilder<> &builder, const runtime::TileChain &chain,
              ArrayRef<llvm::Function *> bodies, llvm::Value *overlay,
              unsigned threads, bool isCuda);

  /// Emits loads of the tile and halo from memory to the overlay, for arrays
  /// whose overlay starts with values from memory. A barrier must follow.
  /// `slots`, here and below, are the parameters of all launches of the chain.
  void emitLoads(ArrayRef<llvm::Value *> slots);
  /// Emits all launches of the chain, which work on the overlay. Each thread
  /// stores only cells that it has computed itself.
  void emitStages(ArrayRef<llvm::Value *> slots);
  /// Emits the stores of the tile, without its halo, from the overlay to global
  /// memory.
  void emitStores(ArrayRef<llvm::Value *> slots);

private:
  /// A cell of the window (tile and halo): its distance from the first cell of
  /// the tile, the indices of its iteration, and its position in the window.
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
  /// The halo of the window (the cells that all overlays cover), and the number
  /// of cells in the window.
  const runtime::TileHalo &window;
  int64_t numCells = 1;
  SmallVector<int64_t> extents;
  /// hasTile: an i1 that is true if the block has a tile. first: the first
  /// index of the block's tile along each dimension.
  llvm::Value *hasTile;
  SmallVector<llvm::Value *> first;
  /// The cell of the current thread, if the thread block has a thread for each
  /// cell.
  std::optional<Cell> own;
  llvm::Value *hasOwn = nullptr;
};

/// Converts a parameter slot of eight bytes to a value of `type`, which is
/// stored at the start of the slot.
llvm::Value *convertSlot(llvm::IRBuilder<> &builder, llvm::Value *word,
                         llvm::Type *type, bool isCuda);

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_DEVICE_TILEBUILDER_H
