//===- AdjointPlan.h - The result of planning an adjoint --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The decisions of reverse-mode differentiation before anything is emitted, as
// data: which values are active, which stores zero adjoints, which part of the
// primal is re-executed. AdjointPlanner makes the plan, AdjointBuilder emits
// it.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_REVERSE_ADJOINTPLAN_H
#define TAI_AD_REVERSE_ADJOINTPLAN_H

#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/Activity.h"
#include "tai/Support/Skips.h"
#include "llvm/ADT/SetVector.h"

namespace mlir::tai {

/// Maps a storage to the storage of its adjoint, or to none.
using AdjointOf = std::function<Storage(Storage)>;

/// Values of a function that have an adjoint, each with the memref that holds
/// it: arguments that are not arrays, and results of the function.
struct ValueShadows {
  SmallVector<Value> inputs, inputShadows;
  SmallVector<Value> outputs, outputShadows;
};

struct AdjointOptions {
  /// All stores zero the adjoints of their elements: the option
  /// `zero-overwritten` of `tai-make-adjoint`.
  bool zeroesAll = false;
  /// Rules load values that the kernel has stored instead of recomputing them,
  /// where that saves work.
  bool loadsStored = false;
  /// The bytes of history that a loop may record at once; a longer history is
  /// recorded in chunks.
  int64_t historyBytes = kDefaultHistoryBytes;
  SkipSet skips = SkipSet::all();
};

/// The memory of a function of arrays that is gone when its gradient runs:
/// arrays of its own, and values of elements that it overwrites.
struct LocalMemory {
  /// Tells `adjointOf` that `adjoint` holds the adjoint of `array`, which the
  /// function allocates. Null in kernels, whose own arrays have no adjoints.
  std::function<void(Value array, Value adjoint)> setAdjoint;
  /// The results of reads that are recorded, each with the value of the record.
  DenseMap<Value, Value> recorded;
  /// Arguments of the function that stand for records, and the records.
  SmallVector<std::pair<Value, Value>> records;
  /// If not null, receives the reads that must be recorded.
  llvm::SetVector<Operation *> *toRecord = nullptr;
  /// All reads of memory that the function writes are recorded.
  bool recordsAll = false;

  Value resolve(Value value) const {
    auto it = recorded.find(value);
    return it == recorded.end() ? value : it->second;
  }
};

/// The stores whose reverse zeroes the adjoint of the element, so that it
/// becomes the adjoint of the value before the store. They are the stores to
/// elements that an earlier access of the function may have used, because the
/// reverse of that access must not see the adjoint of the stored value. All
/// stores to arrays belong to them, because a tape does not know which elements
/// another launch has used.
class AdjointZeroing {
public:
  AdjointZeroing(FunctionOpInterface primal, const AccessTable &accesses,
                 const Activity &activity, const AdjointOf &adjointOf,
                 bool zeroesAll);

  bool isZeroedBy(Operation *store) const { return stores.contains(store); }
  /// True if a region of `op` holds a store that zeroes an adjoint.
  bool isHeldBy(Operation *op) const { return holders.contains(op); }

private:
  DenseSet<Operation *> stores, holders;
};

/// The part of the primal that an adjoint re-executes, because its values
/// follow neither from the memory that the launch left nor from the memory
/// before it: see ForwardReexecution.h.
class ReexecutionPlan {
public:
  /// Records the results of `op`: a read of an element that is overwritten, or
  /// a random draw in a serial loop. False if it was planned before.
  bool addRecorded(Operation *op);
  /// Re-executes the writes to a storage. False if it was planned before.
  bool addStorage(const void *storage) {
    return storages.insert(storage).second;
  }

  bool isRecorded(Operation *op) const { return recorded.contains(op); }
  /// True if the value comes from the second execution: the result of a
  /// recorded op, or a value that an op around a recorded op carries.
  bool isRecorded(Value value) const;
  /// True if a region of `op` holds a recorded op.
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

/// The block that is re-executed to recover `op`: the body of the parallel loop
/// around it, or the body of the function. Parallel loops marked as serialized
/// count as serial.
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
  LocalMemory local;

  /// True for an array that a function makes, if such arrays have adjoints.
  bool isOwnArray(Value array) const {
    return local.setAdjoint && array.getDefiningOp() &&
           array.getDefiningOp()->getNumRegions() == 0 &&
           hasSingleEffect<MemoryEffects::Allocate>(array.getDefiningOp());
  }

  /// True if all values that loops carry are recorded.
  bool recordsAll() const { return !options.skips.has(Skip::UnneededRecords); }
  /// True if adjoint code is kept whose result reaches no memory.
  bool keepsDead() const { return !options.skips.has(Skip::InactiveValues); }
};

/// The demands of an adjoint on the primal, as found while it was emitted.
struct PrimalDemands {
  /// The primal reads that the adjoint repeats.
  llvm::SetVector<Operation *> reads;
  /// Random draws that cannot be repeated where the adjoint needs them.
  llvm::SetVector<Operation *> draws;
  /// Accesses to fields that the adjoint reads as they were before the launch.
  llvm::SetVector<Operation *> before;
  /// Stores whose elements the adjoint loads instead of computing their values.
  llvm::SetVector<Operation *> stored;
  /// Splitting the kernel into one for each loop would avoid the failure.
  bool parts = false;
  /// Values that reversed loops carry, and how many of them are recorded.
  int64_t carriedValues = 0, recordedValues = 0;
};

} // namespace mlir::tai

#endif // TAI_AD_REVERSE_ADJOINTPLAN_H
