//===- AdjointBuilder.h - Builds the reverse of a kernel --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The state of reverse-mode differentiation, and what rules call to use it.
//
// The adjoint kernel mirrors the blocks of the primal one. Each mirrored block
// is a `Frame` of two parts: first the primal values that the second part asks
// for, recomputed in program order, then the reverse sweep. A primal value is
// recomputed when a rule first asks for it, so that nothing is computed that no
// partial derivative needs. Adjoints are SSA values: no memory is touched but
// the adjoint fields.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_ADJOINTBUILDER_H
#define TAI_AD_ADJOINTBUILDER_H

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/IRMapping.h"
#include "tai/AD/DerivativeBuilder.h"
#include "tai/AD/Signature.h"
#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/Activity.h"
#include "tai/Support/Skips.h"
#include "llvm/ADT/MapVector.h"
#include "llvm/ADT/SetVector.h"
#include <map>

namespace mlir::tai {
class ContendedAtomics;
class ParallelForOp;

class LoopHistory;
class StoredOutputs;

/// The adjoint of one value while it is being summed: a part for the whole
/// value and, for vectors, parts for single components (row-major; null is
/// zero).
struct PartialAdjoint {
  Value whole;
  SmallVector<Value> components;
};

/// What an adjoint cannot compute from memory as it is: see Rerun.cpp.
struct RerunPlan {
  /// Reads whose elements are overwritten, and draws in serial loops.
  llvm::SetVector<Operation *> recorded;
  /// The storages that are written when the primal runs again.
  DenseSet<const void *> storages;
};

class Rerun;

/// A primal block and its mirror in the adjoint kernel.
struct Frame {
  Frame(Frame *parent, Block *primal, Block *mirror)
      : parent(parent), primal(primal), mirror(mirror) {}

  struct ProgramOrder {
    bool operator()(Operation *lhs, Operation *rhs) const {
      return lhs->isBeforeInBlock(rhs);
    }
  };

  Frame *parent;
  Block *primal;
  Block *mirror;
  /// Recomputed ops stand between these two. Both are null in a frame that only
  /// recomputes: it ends where its mirror does.
  Operation *recomputeBegin = nullptr;
  Operation *sweepBegin = nullptr;
  /// What primal values of this block are in the mirror.
  IRMapping values;
  /// For each recomputed op, the first op that stands for it.
  std::map<Operation *, Operation *, ProgramOrder> recomputed;
  /// Adjoints known in this frame, of values of this block and of captured
  /// ones.
  llvm::MapVector<Value, PartialAdjoint> adjoints;
  /// In the reverse of a serial loop: which iteration of the primal loop this
  /// is, counted from 0, and what knows the values that it began with.
  Value iteration;
  LoopHistory *history = nullptr;
  /// Values of the primal block of `parent` that are passed on as the arguments
  /// of this one, if that is where they come from.
  SmallVector<Value> argumentValues;
  /// The recorded values that have been popped here.
  DenseSet<Value> popped;
};

/// Values of a function that have an adjoint, each with the memref that holds
/// it: arguments that are no arrays, and what the function returns.
struct ValueShadows {
  SmallVector<Value> inputs, inputShadows;
  SmallVector<Value> outputs, outputShadows;
};

class AdjointBuilder : public DerivativeBuilder {
public:
  /// Builds into the body of `adjoint`, whose arguments begin with those of
  /// `primal`. `adjointOf` gives the storage of adjoints, or none. With
  /// `takesAll`, all stores take the adjoints of their elements.
  AdjointBuilder(FunctionOpInterface primal, FunctionOpInterface adjoint,
                 std::function<Storage(Storage)> adjointOf, bool takesAll,
                 const RerunPlan &plan, ValueShadows shadows = {},
                 SkipSet skips = SkipSet::all());
  ~AdjointBuilder();

  /// Builds the whole adjoint; the terminator is left to the caller. Fails
  /// after an error at the op that cannot be differentiated.
  LogicalResult build();

  /// To be called before `build`: rules load what the kernel has stored, where
  /// that saves work. `findsStored` says afterwards whether any does, and finds
  /// it.
  void readStored();
  bool findsStored() const;

  /// Counts what the analyses kept out of what was built.
  void countSkips();
  /// True if what was built has to be built again, by a larger plan.
  bool needsMore() const { return wantsMore; }
  const RerunPlan &getLargerPlan() const { return larger; }
  /// True if building failed because several states of a field are needed, and
  /// not all by one loop.
  bool needsParts() const { return wantsParts; }

  //===--------------------------------------------------------------------===//
  // For rules
  //===--------------------------------------------------------------------===//

  /// True if the value carries a derivative that is wanted.
  bool isActive(Value value) const { return activity.isActive(value); }
  /// The primal value, recomputed in the adjoint kernel.
  Value getPrimal(Value value) override;
  SmallVector<Value> getPrimals(ValueRange values);
  /// The adjoint, or null where it is zero.
  Value getAdjoint(Value value);
  /// The adjoint, as a constant zero where it is zero.
  Value getAdjointOrZero(Value value);
  /// Row-major components of the adjoint of a vector; null where zero.
  SmallVector<Value> getAdjointComponents(Value value);
  /// Adds to the adjoint of `value`; nothing happens if it is not active or
  /// the contribution is null.
  void addAdjoint(Value value, Value contribution);
  /// Adds to one component (row-major) of the adjoint of a vector.
  void addAdjointComponent(Value value, int64_t component, Value contribution);
  /// True if the reverse of the access does something.
  bool isReversed(Operation *access) const {
    return activity.isActiveAccess(access) || takes.contains(access);
  }
  /// True if the reverse of the store takes the adjoint of the element: it
  /// leaves zero, for the value before the store.
  bool takesAdjoint(Operation *store) const { return takes.contains(store); }
  /// True if a write may follow on `read` and reach the same element.
  bool mayBeOverwritten(DifferentiableAccessInterface read) const {
    return static_cast<bool>(accesses.findLaterWrite(read));
  }

  //===--------------------------------------------------------------------===//
  // For loops and branches
  //===--------------------------------------------------------------------===//

  const Activity &getActivity() const { return activity; }
  Frame &getFrame() { return *current; }
  Storage getAdjointStorage(Storage storage) { return adjointOf(storage); }

  /// Reverses `primal` into `mirror`, whose terminator is left to the caller.
  /// `begin` maps the arguments of the block and seeds the adjoints of what the
  /// terminator passes on; it cannot ask for primal values. `beforeSweep`,
  /// where given, and `end` run at the two ends of the sweep.
  LogicalResult reverseBlock(Block *primal, Block *mirror,
                             llvm::function_ref<void(Frame &)> begin,
                             llvm::function_ref<void(Frame &)> end,
                             llvm::function_ref<void()> beforeSweep = {});
  /// Mirrors a block for its primal values alone: those that its terminator
  /// passes on, and the terminator itself.
  void recomputeBlock(Block *primal, Block *mirror);
  /// The adjoints in `frame` of values defined outside of its block.
  llvm::MapVector<Value, Value> takeCaptured(Frame &frame);
  /// Carries the sweep on, from the current frame, into the ops of the block
  /// around it that made captured values, down to the reads they come from;
  /// leaves the captured values for which these ops are many or hold regions.
  void sweepCaptured();
  /// The number of iterations of a serial loop, as an index.
  Value createTripCount(scf::ForOp loop);
  /// The bytes that a loop may record at once; it is recorded in chunks where
  /// it takes more.
  int64_t getHistoryLimit() const { return historyLimit; }
  void setHistoryLimit(int64_t bytes) { historyLimit = bytes; }

  /// True if values of the loop are recorded while the primal runs again: they
  /// cannot be computed again from one iteration or from several.
  bool isRecordedLoop(Operation *loop) const { return holders.contains(loop); }
  /// How often the second region of such a loop has run.
  Value fetchCount(scf::WhileOp loop);

  /// Before and after the reverse of a parallel loop: what it needs for
  /// elements that its iterations multiply, or compare with their values, at
  /// the same time.
  LogicalResult beginContended(ParallelForOp loop);
  void endContended();
  /// The adjoint reads the field of the access as it was before the launch.
  void requireBefore(Operation *access) { wantsBefore.insert(access); }
  /// A kernel of its own for each loop would do.
  void requestParts() { wantsParts = true; }
  /// True if the adjoint runs stores to the storage of the access again.
  bool runsAgain(Operation *access) const;
  /// Checks that a read gives in the adjoint what it gave in the primal.
  bool checkReadable(DifferentiableAccessInterface read);

  /// Says that what was added to the adjoint of `value` may be infinite.
  void markInfinite(Value value) { mayBeInfinite.insert(value); }
  /// Says that what was added to the adjoint of `value` may be NaN though all
  /// values are finite: a derivative that does not exist.
  void markUndefined(Value value) { mayBeUndefined.insert(value); }
  /// True if an adjoint that the rule at hand starts from may be so.
  bool isSeedUndefined() const { return seedIsUndefined; }

  /// Reports that `op` cannot be differentiated; building then fails.
  InFlightDiagnostic emitError(Operation *op, const Twine &message);

private:
  friend class LoopHistory;

  Value materialize(Frame &frame, Value value);
  void materializeArgument(Frame &frame, BlockArgument argument);
  void recompute(Frame &frame, Operation *op);
  void recomputeRegions(Operation *op, Operation *copy);
  bool checkRecomputable(Operation *op);
  LogicalResult checkAccesses();
  void checkActivityChanges();
  void findTakes();
  LogicalResult chooseStates();
  LogicalResult chooseState(ArrayRef<DifferentiableAccessInterface> reads,
                            SmallVectorImpl<Attribute> &before);
  bool planRerun(DifferentiableAccessInterface lost,
                 ArrayRef<DifferentiableAccessInterface> reads);
  bool isRecorded(Value value) const;
  bool needsOperands(Frame &frame, Operation *op,
                     SmallVectorImpl<Operation *> &missing);
  Value fetchStored(Frame &frame, Value value);
  void beginRerun(Frame &frame);
  void endRerun(Frame &frame);
  void leaveMirror(Frame &frame);
  Value fetchRecorded(Frame &frame, Value value);
  void collectRerunReads();
  LogicalResult reverseOp(Operation *op);
  LogicalResult reverseAccess(Operation *op);
  Value sumUp(Value value, PartialAdjoint &entry);
  Value createInfinityTest(Operation *op);
  Value createFinite(Value value, Value contribution);
  Value createUnitContribution(Value contribution);
  void seedOutputs();
  void accumulateInputs();

  FunctionOpInterface primal, adjoint;
  std::function<Storage(Storage)> adjointOf;
  ValueShadows shadows;
  Activity activity;
  AccessTable accesses;
  bool takesAll;
  /// What analyses may leave out: whether all values that loops carry are
  /// recorded, and adjoint code kept that reaches no memory.
  bool recordsAll, keepsDead;
  /// Of the loops that are reversed.
  int64_t carriedValues = 0, recordedValues = 0;
  /// The stores that take, and the ops around them.
  DenseSet<Operation *> takes, takeHolders;
  /// The reads that the adjoint repeats.
  llvm::SetVector<Operation *> needed;
  const RerunPlan &plan;
  /// The plan for the next attempt, if this one turns out to lack something.
  RerunPlan larger;
  bool wantsMore = false, wantsParts = false;
  /// The ops with regions around recorded ones, and the blocks to run again.
  DenseSet<Operation *> holders;
  DenseSet<Block *> units;
  /// The innermost block that is being run again.
  std::unique_ptr<Rerun> rerun;
  /// The reads for which those marked with kRerunReadAttrName stand.
  SmallVector<Operation *> rerunReads;
  Frame *current = nullptr;
  bool hasErrors = false;
  int64_t historyLimit = kDefaultHistoryBytes;
  /// Values whose adjoint may be infinite, and whether one of those is that the
  /// rule at hand starts from (null: no).
  DenseSet<Value> mayBeInfinite;
  Value seedIsInfinite;
  /// The same for adjoints that may be NaN.
  DenseSet<Value> mayBeUndefined;
  bool seedIsUndefined = false;
  /// The adjoints that it starts from.
  llvm::SmallSetVector<Value, 2> ruleSeeds;
  DenseSet<Operation *> recomputedDraws, refused;
  /// The storages that the adjoint accumulates into.
  DenseSet<const void *> accumulated;
  /// Accesses whose fields the adjoint reads as they were before the launch.
  llvm::SetVector<Operation *> wantsBefore;
  std::unique_ptr<ContendedAtomics> contended;
  /// What rules may load, if anything, and whether one of them asks.
  std::unique_ptr<StoredOutputs> stored;
  bool inRule = false;
};

/// Fills the empty adjoint `shell` of `function`, which has the arguments that
/// `signature` asks for. `takes` is as the option of `tai-make-adjoint`;
/// `needsParts` is told whether a failure can be helped by splitting the
/// kernel. Values that only lack of `activity-analysis` among the skips gives
/// an adjoint need not have one that can be made. With `stored`, the adjoint
/// loads what the kernel has stored; fails if there is nothing to gain.
LogicalResult fillAdjoint(FunctionOpInterface function,
                          FunctionOpInterface shell,
                          const AdjointSignature &signature,
                          int64_t historyBytes, bool takes,
                          bool *needsParts = nullptr,
                          SkipSet skips = SkipSet::all(), bool stored = false);

/// Zeroes what parallel loops of an adjoint take in loops of their own, where
/// that lets the additions of the others be gathered.
void separateTakes(FunctionOpInterface adjoint);

/// Removes from the serial loops in `region` the carried values that neither
/// the results in use nor an effect in the body need.
void dropDeadCarried(Region &region);

} // namespace mlir::tai

#endif // TAI_AD_ADJOINTBUILDER_H
