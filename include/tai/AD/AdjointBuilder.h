//===- AdjointBuilder.h - Emits reverse mode of a kernel --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The reverse sweep, and what rules call to take part in it.
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
#include "tai/AD/AdjointPlan.h"
#include "tai/AD/DerivativeBuilder.h"
#include "tai/AD/Signature.h"
#include "llvm/ADT/MapVector.h"
#include "llvm/Support/SaveAndRestore.h"
#include <map>

namespace mlir::tai {
class ContendedAtomics;
class ForwardReexecution;
class LoopHistory;
class NonFiniteAdjoints;
class ParallelForOp;
class Rematerializer;
class StoredOutputs;

/// The adjoint of one value while it is being summed: a part for the whole
/// value and, for vectors, parts for single components (row-major; null is
/// zero).
struct PartialAdjoint {
  Value whole;
  SmallVector<Value> components;
};

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

class AdjointBuilder : public DerivativeBuilder {
public:
  /// Builds what `plan` says into the body of `adjoint`, whose arguments begin
  /// with those of the primal.
  AdjointBuilder(FunctionOpInterface adjoint, const AdjointPlan &plan);
  ~AdjointBuilder();

  /// Builds the whole adjoint; the terminator is left to the caller. Fails
  /// after an error at the op that cannot be differentiated.
  LogicalResult build();
  /// What was asked of the primal, which the plan may not provide: to be
  /// settled by the planner.
  const PrimalDemands &getDemands() const { return demands; }

  //===--------------------------------------------------------------------===//
  // For rules
  //===--------------------------------------------------------------------===//

  /// True if the value carries a derivative that is wanted.
  bool isActive(Value value) const { return plan.activity.isActive(value); }
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
    return plan.activity.isActiveAccess(access) || takesAdjoint(access);
  }
  /// True if the reverse of the store zeroes the adjoint of the element, for
  /// the value before the store.
  bool takesAdjoint(Operation *store) const {
    return plan.zeroing.isZeroedBy(store);
  }
  /// True if a write may follow on `read` and reach the same element.
  bool mayBeOverwritten(DifferentiableAccessInterface read) const {
    return static_cast<bool>(plan.accesses.findLaterWrite(read));
  }

  //===--------------------------------------------------------------------===//
  // For loops and branches
  //===--------------------------------------------------------------------===//

  const AdjointPlan &getPlan() const { return plan; }
  const Activity &getActivity() const { return plan.activity; }
  Frame &getFrame() { return *current; }
  /// Works in another frame until the result goes.
  [[nodiscard]] llvm::SaveAndRestore<Frame *> enter(Frame &frame) {
    return llvm::SaveAndRestore<Frame *>(current, &frame);
  }
  Storage getAdjointStorage(Storage storage) { return plan.adjointOf(storage); }

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
  /// True if values of the loop are recorded while the primal runs again: they
  /// cannot be computed again from one iteration or from several.
  bool isRecordedLoop(Operation *loop) const {
    return plan.reexecution.holdsRecorded(loop);
  }
  /// How often the second region of such a loop has run.
  Value fetchCount(scf::WhileOp loop);

  /// Before and after the reverse of a parallel loop: what it needs for
  /// elements that its iterations multiply, or compare with their values, at
  /// the same time.
  LogicalResult beginContended(ParallelForOp loop);
  void endContended();
  /// The adjoint reads the field of the access as it was before the launch.
  void requireBefore(Operation *access) { demands.before.insert(access); }
  /// A kernel of its own for each loop would do.
  void requestParts() { demands.parts = true; }
  /// True if the adjoint runs stores to the storage of the access again.
  bool runsAgain(Operation *access) const;
  /// Checks that a read gives in the adjoint what it gave in the primal.
  bool checkReadable(DifferentiableAccessInterface read);

  /// Counts what a reversed loop carries, and how much of it is recorded.
  void countCarried(int64_t values, int64_t recorded) {
    demands.carriedValues += values;
    demands.recordedValues += recorded;
  }

  /// Says that what was added to the adjoint of `value` may be infinite.
  void markInfinite(Value value);
  /// Says that what was added to the adjoint of `value` may be NaN though all
  /// values are finite: a derivative that does not exist.
  void markUndefined(Value value);
  /// True if an adjoint that the rule at hand starts from may be so.
  bool isSeedUndefined() const;

  /// Reports that `op` cannot be differentiated; building then fails.
  InFlightDiagnostic emitError(Operation *op, const Twine &message);

  bool hasFailed() const { return hasErrors; }

private:
  LogicalResult reverseOp(Operation *op);
  LogicalResult reverseAccess(Operation *op);
  Value sumUp(Value value, PartialAdjoint &entry);

  FunctionOpInterface primal, adjoint;
  const AdjointPlan &plan;
  PrimalDemands demands;
  Frame *current = nullptr;
  bool hasErrors = false;
  std::unique_ptr<StoredOutputs> stored;
  std::unique_ptr<ForwardReexecution> reexecution;
  std::unique_ptr<Rematerializer> rematerializer;
  std::unique_ptr<NonFiniteAdjoints> nonFinite;
  std::unique_ptr<ContendedAtomics> contended;
};

/// Fills the empty adjoint `shell` of `function`, which has the arguments that
/// `signature` asks for. `needsParts` is told whether a failure can be helped
/// by splitting the kernel. Values that only lack of `inactive-values` among
/// the skips gives an adjoint need not have one that can be made. With
/// `loadsStored`, fails if there is nothing to gain.
LogicalResult fillAdjoint(FunctionOpInterface function,
                          FunctionOpInterface shell,
                          const AdjointSignature &signature,
                          AdjointOptions options, bool *needsParts = nullptr);

/// Zeroes adjoints in loops of their own, where that lets the additions of the
/// others be gathered.
void splitAdjointZeroing(FunctionOpInterface adjoint);

/// Removes from the serial loops in `region` the carried values that neither
/// the results in use nor an effect in the body need.
void dropDeadCarried(Region &region);

} // namespace mlir::tai

#endif // TAI_AD_ADJOINTBUILDER_H
