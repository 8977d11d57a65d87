//===- LoopMemory.h - What a loop does in memory ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Finds the values of a parallel loop that another iteration may compute again,
// and the stores that may happen after all iterations.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_ACCUMULATIONS_LOOPMEMORY_H
#define TAI_LIB_TRANSFORMS_ACCUMULATIONS_LOOPMEMORY_H

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Analysis/IterationOrder.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// An access of the loop to an element of a field.
struct LoopAccess {
  Operation *op;
  ElementPlace place;

  static LoopAccess get(Operation *op);
};

/// The reads and writes of a loop, by storage. After a limited number of
/// comparisons, all pairs count as conflicts, so that the time stays linear in
/// the size of the program.
class LoopMemory {
public:
  explicit LoopMemory(ParallelForOp loop);

  /// True if `load` reads the same value when it is repeated at any time, in
  /// any iteration. Additions to the storage `added` are ignored, because the
  /// caller checks them. Stores in `later` are ignored as well; `needsLater` is
  /// set if the result depends on that.
  bool isStable(LoadOp load, const void *added,
                const llvm::SmallPtrSetImpl<Operation *> &later,
                bool &needsLater);

  /// The stores of constants that may move to a loop after this one.
  llvm::SmallPtrSet<Operation *, 4> findMovableStores(LoopBox &box);

private:
  bool areApart(const LoopAccess &first, const LoopAccess &second);
  bool isMovable(StoreOp store, LoopBox &box);

  static constexpr unsigned kMaxComparisons = 4096;

  ParallelForOp loop;
  llvm::DenseMap<const void *, SmallVector<LoopAccess>> accesses;
  llvm::DenseMap<std::pair<Operation *, Operation *>, bool> compared;
  bool isKnown = true;
};

/// True if `value` can be computed again in another iteration: it is made of
/// operations without effects, and of reads of fields and arrays that
/// `isStable` allows. Adds the operations to `seen`.
bool canRecompute(Value value, LoopBox &box,
                  llvm::function_ref<bool(Operation *)> isStable,
                  llvm::SmallDenseSet<Operation *> &seen);

/// The `scf.if` ops between an operation and the loop, outermost first; nullopt
/// if an op of another kind is between them.
std::optional<SmallVector<scf::IfOp>> getConditions(Operation *op,
                                                    LoopBox &box);

/// Replaces an exclusive addition by an addition in registers, if the same
/// block reads and then overwrites the element, so that nothing else depends on
/// it. This occurs in the adjoint of a step that computes one result from
/// another.
void forwardAddition(AtomicOp addition);

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_ACCUMULATIONS_LOOPMEMORY_H
