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
  /// All stores of the kernel zero the adjoints of the stored elements: the
  /// option `zero-overwritten` of `tai-make-adjoint`.
  bool zeroesAll = false;
  /// Derivative rules load values that the kernel has stored instead of
  /// recomputing these values, where that saves work.
  bool loadsStored = false;
  /// The most bytes of carried values that the reverse of a serial loop may
  /// record at once; longer loops are recorded in chunks.
  int64_t historyBytes = kDefaultHistoryBytes;
  SkipSet skips = SkipSet::all();
};

/// Describes memory that no longer exists when the gradient of a function of
/// arrays runs: arrays that the function allocates, and values of elements that
/// the function overwrites. The gradient gets the values that it needs as
/// recorded copies.
struct LocalMemory {
  /// Tells `adjointOf` that `adjoint` holds the adjoint of `array`, which the
  /// function allocates. Null in kernels, whose own arrays have no adjoints.
  std::function<void(Value array, Value adjoint)> setAdjoint;
  /// Maps results of primal reads that are recorded to the values in the
  /// gradient that hold the recorded copies.
  DenseMap<Value, Value> recorded;
  /// Pairs of a function argument that receives recorded values, and the
  /// recorded values.
  SmallVector<std::pair<Value, Value>> records;
  /// If not null, collects the primal reads whose values must be recorded.
  llvm::SetVector<Operation *> *toRecord = nullptr;
  /// If true, all reads of memory that the function writes are recorded.
  bool recordsAll = false;
  /// If not null, collects the arrays that hold values carried by loops.
  SmallVectorImpl<Value> *histories = nullptr;

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
  /// True if a region of `op` holds a store whose reverse zeroes an adjoint.
  bool isHeldBy(Operation *op) const { return holders.contains(op); }

private:
  DenseSet<Operation *> stores, holders;
};

/// The part of the primal that an adjoint re-executes, because its values
/// follow neither from the memory that the launch left nor from the memory
/// before it: see ForwardReexecution.h.
class ReexecutionPlan {
public:
  /// Plans to record the results of `op` in the second execution of the primal:
  /// a read of an element that is overwritten, or a random draw in a serial
  /// loop. False if this was planned before.
  bool addRecorded(Operation *op);
  /// Plans to re-execute all writes of the primal to a storage. False if this
  /// was planned before.
  bool addStorage(const void *storage) {
    return storages.insert(storage).second;
  }

  bool isRecorded(Operation *op) const { return recorded.contains(op); }
  /// True if the value comes from the second execution: the result of a
  /// recorded op, or a value that an op around a recorded op carries.
  bool isRecorded(Value value) const;
  /// True if a region of `op` holds an op whose results are recorded.
  bool holdsRecorded(Operation *op) const { return holders.contains(op); }
  /// True for primal blocks whose mirrors in the adjoint begin with a second
  /// execution of primal ops.
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

/// The primal block that is re-executed to recover the results of `op`: the
/// body of the parallel loop around `op`, or else the body of the function.
/// Parallel loops marked as serialized count as serial.
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
  /// The adjoint storages to which the adjoint adds contributions.
  DenseSet<const void *> accumulated;
  ReexecutionPlan reexecution;
  LocalMemory local;

  /// True for an array that the differentiated function allocates, if such
  /// arrays have adjoints.
  bool isOwnArray(Value array) const {
    return local.setAdjoint && array.getDefiningOp() &&
           array.getDefiningOp()->getNumRegions() == 0 &&
           hasSingleEffect<MemoryEffects::Allocate>(array.getDefiningOp());
  }

  /// True if all values that serial loops carry are recorded, also values that
  /// the reverse of the loop could do without.
  bool recordsAll() const { return !options.skips.has(Skip::UnneededRecords); }
  /// True if adjoint code is kept even where its result reaches no memory.
  bool keepsDead() const { return !options.skips.has(Skip::InactiveValues); }
};

/// The demands of an adjoint on primal values and memory, as found while the
/// adjoint was emitted.
struct PrimalDemands {
  /// The reads of primal memory that the adjoint repeats.
  llvm::SetVector<Operation *> reads;
  /// Random draws of the primal that cannot be repeated where the adjoint needs
  /// their values.
  llvm::SetVector<Operation *> draws;
  /// Accesses to fields that the adjoint must read as they were before the
  /// launch of the primal.
  llvm::SetVector<Operation *> before;
  /// Primal stores whose elements the adjoint loads instead of computing the
  /// stored values.
  llvm::SetVector<Operation *> stored;
  /// True if the adjoint failed, but would not if the kernel were split into
  /// one kernel for each loop.
  bool parts = false;
  /// Numbers for the statistics: values that reversed loops carry, and how many
  /// of them are recorded.
  int64_t carriedValues = 0, recordedValues = 0;
};

} // namespace mlir::tai

#endif // TAI_AD_REVERSE_ADJOINTPLAN_H
