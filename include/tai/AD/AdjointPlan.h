//===- AdjointPlan.h - The result of planning an adjoint --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What reverse-mode differentiation knows and has decided before anything is
// emitted, as data: which values are active, which stores zero adjoints, which
// part of the primal is executed forward again. AdjointPlanner makes it,
// AdjointBuilder emits what it says.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_ADJOINTPLAN_H
#define TAI_AD_ADJOINTPLAN_H

#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/Activity.h"
#include "tai/Support/Skips.h"
#include "llvm/ADT/SetVector.h"

namespace mlir::tai {

/// The storage of the adjoint of a storage, or none.
using AdjointOf = std::function<Storage(Storage)>;

/// Values of a function that have an adjoint, each with the memref that holds
/// it: arguments that are no arrays, and what the function returns.
struct ValueShadows {
  SmallVector<Value> inputs, inputShadows;
  SmallVector<Value> outputs, outputShadows;
};

struct AdjointOptions {
  /// All stores zero the adjoints of their elements: the option `takes` of
  /// `tai-make-adjoint`.
  bool zeroesAll = false;
  /// Rules load what the kernel has stored, where that saves work.
  bool loadsStored = false;
  /// The bytes that a loop may record at once; it is recorded in chunks where
  /// it takes more.
  int64_t historyBytes = kDefaultHistoryBytes;
  SkipSet skips = SkipSet::all();
};

/// The stores whose reverse zeroes the adjoint of the element, which becomes
/// that of the value before the store: those of elements that an earlier access
/// of the function may have used, for its reverse must not see the adjoint of
/// the stored value. Those of arrays all do, because a tape does not know which
/// elements another launch has used.
class AdjointZeroing {
public:
  AdjointZeroing(FunctionOpInterface primal, const AccessTable &accesses,
                 const Activity &activity, const AdjointOf &adjointOf,
                 bool zeroesAll);

  bool isZeroedBy(Operation *store) const { return stores.contains(store); }
  /// True if a region of `op` holds such a store.
  bool isHeldBy(Operation *op) const { return holders.contains(op); }

private:
  DenseSet<Operation *> stores, holders;
};

/// Which part of the primal an adjoint executes forward again, because it can
/// compute it neither from what a launch left in memory nor from what was there
/// before: see ForwardReexecution.h.
class ReexecutionPlan {
public:
  /// Records the results of `op`: a read of an element that is overwritten, or
  /// a random draw in a serial loop. False if it was planned before.
  bool addRecorded(Operation *op);
  /// Repeats the writes to a storage. False if it was planned before.
  bool addStorage(const void *storage) {
    return storages.insert(storage).second;
  }

  bool isRecorded(Operation *op) const { return recorded.contains(op); }
  /// True if the value comes from the second execution: a recorded one, or one
  /// that an op around a recorded one carries.
  bool isRecorded(Value value) const;
  /// True if a region of `op` holds a recorded one.
  bool holdsRecorded(Operation *op) const { return holders.contains(op); }
  /// True for the blocks whose mirrors begin with a second execution.
  bool isReexecuted(Block *block) const { return blocks.contains(block); }
  bool isRewritten(const void *storage) const {
    return storages.contains(storage);
  }

  bool hasRecorded() const { return !recorded.empty(); }
  bool hasRewritten() const { return !storages.empty(); }

private:
  DenseSet<Operation *> recorded, holders;
  DenseSet<const void *> storages;
  DenseSet<Block *> blocks;
};

/// The block that is executed again for the sake of `op`: the body of the
/// parallel loop around it, or the body of the function. Serialized loops are
/// serial.
Block *getReexecutedBlock(Operation *op);

struct AdjointPlan {
  AdjointPlan(FunctionOpInterface primal, AdjointOf adjointOf,
              ValueShadows shadows = {}, AdjointOptions options = {});

  FunctionOpInterface primal;
  AdjointOf adjointOf;
  ValueShadows shadows;
  AdjointOptions options;
  Activity activity;
  AccessTable accesses;
  AdjointZeroing zeroing;
  /// The storages that the adjoint accumulates into.
  DenseSet<const void *> accumulated;
  ReexecutionPlan reexecution;

  /// True if all values that loops carry are recorded.
  bool recordsAll() const { return !options.skips.has(Skip::UnneededRecords); }
  /// True if adjoint code is kept that reaches no memory.
  bool keepsDead() const { return !options.skips.has(Skip::InactiveValues); }
};

/// What an adjoint turned out to need of the primal, while it was emitted.
struct PrimalDemands {
  /// The reads that it repeats.
  llvm::SetVector<Operation *> reads;
  /// Random draws that cannot be repeated where they are asked for.
  llvm::SetVector<Operation *> draws;
  /// Accesses whose fields it reads as they were before the launch.
  llvm::SetVector<Operation *> before;
  /// Stores whose elements it loads instead of computing what they hold.
  llvm::SetVector<Operation *> stored;
  /// A failure would be helped by a kernel of its own for each loop.
  bool parts = false;
  /// Values that reversed loops carry, and how many of them are recorded.
  int64_t carriedValues = 0, recordedValues = 0;
};

} // namespace mlir::tai

#endif // TAI_AD_ADJOINTPLAN_H
