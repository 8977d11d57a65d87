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

/// The reads and writes of a loop, by storage. Pairs beyond a number are taken
/// to meet, so that the time stays linear in the size of the program.
class LoopMemory {
public:
  explicit LoopMemory(ParallelForOp loop);

  /// True if `load` finds the same value whenever, and in whichever iteration,
  /// it is done again. Additions to `added` do not count: the caller compares
  /// them. Stores of `later` do not count either; `needsLater` is set if that
  /// matters.
  bool isStable(LoadOp load, const void *added,
                const llvm::SmallPtrSetImpl<Operation *> &later,
                bool &needsLater);

  /// The stores of constants that may be done in a loop behind this one.
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
/// operations without effects, and of reads that `isStable` allows. Adds the
/// operations to `seen`.
bool canRecompute(Value value, LoopBox &box,
                  llvm::function_ref<bool(LoadOp)> isStable,
                  llvm::SmallDenseSet<Operation *> &seen);

/// The `scf.if` ops between an operation and the loop, outermost first; none if
/// there is another op around it.
std::optional<SmallVector<scf::IfOp>> getConditions(Operation *op,
                                                    LoopBox &box);

/// Keeps the element of an exclusive addition in a value if the same block
/// overwrites it afterwards: one result of a step is made of another, whose
/// adjoint is added to before it is taken. Nothing else depends on the element.
void forwardAddition(AtomicOp addition);

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_ACCUMULATIONS_LOOPMEMORY_H
