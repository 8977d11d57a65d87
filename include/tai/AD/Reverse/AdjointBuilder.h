//===- AdjointBuilder.h - Emits reverse mode of a kernel --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Emits the reverse sweep, and offers derivative rules the operations they
// need.
//
// The adjoint kernel mirrors the blocks of the primal one. Each mirrored block
// is a `Frame` of two parts: first the primal values that the second part
// needs, recomputed in program order, then the reverse sweep. A primal value is
// recomputed when a rule first asks for it, so that nothing is computed that no
// partial derivative needs. Adjoints are SSA values: no memory is touched but
// the adjoint fields.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_REVERSE_ADJOINTBUILDER_H
#define TAI_AD_REVERSE_ADJOINTBUILDER_H

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/IRMapping.h"
#include "tai/AD/DerivativeBuilder.h"
#include "tai/AD/Reverse/AdjointPlan.h"
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

/// The adjoint of one value while contributions are summed: a part for the
/// whole value and, for vectors, parts for single components (row-major; null
/// is zero).
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
  /// Recomputed ops are inserted between these two. Both are null in a frame
  /// that only recomputes: its ops go to the end of the mirror.
  Operation *recomputeBegin = nullptr;
  Operation *sweepBegin = nullptr;
  /// Maps primal values of this block to values of the mirror.
  IRMapping values;
  /// For each recomputed op, the first op of its copy.
  std::map<Operation *, Operation *, ProgramOrder> recomputed;
  /// Adjoints known in this frame, of values of this block and of captured
  /// values.
  llvm::MapVector<Value, PartialAdjoint> adjoints;
  /// In the reverse of a serial loop: the number of the primal iteration, from
  /// 0, and the history that recovers the values with which it began.
  Value iteration;
  LoopHistory *history = nullptr;
  /// The values of the primal block of `parent` that are forwarded to the
  /// arguments of this block; empty if the arguments come from elsewhere.
  SmallVector<Value> argumentValues;
  /// The recorded values that have been popped in this frame.
  DenseSet<Value> popped;
  /// Buffers that are freed at the end of the block.
  SmallVector<Value> buffers;
};

class AdjointBuilder : public DerivativeBuilder {
public:
  /// Builds the operations of `plan` into the body of `adjoint`, whose
  /// arguments begin with the arguments of the primal.
  AdjointBuilder(FunctionOpInterface adjoint, const AdjointPlan &plan);
  ~AdjointBuilder();

  /// Builds the whole adjoint; the terminator is left to the caller. Fails
  /// after an error at the op that cannot be differentiated.
  LogicalResult build();
  /// The primal values and versions that the adjoint needs. The plan possibly
  /// lacks some of them: the planner compares these demands with it
  /// (`AdjointPlanner::settle`).
  const PrimalDemands &getDemands() const { return demands; }

  //===--------------------------------------------------------------------===//
  // For rules
  //===--------------------------------------------------------------------===//

  /// True if the value is active.
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
  /// True if the reverse of the access is not empty.
  bool isReversed(Operation *access) const {
    return plan.activity.isActiveAccess(access) || zeroesAdjoint(access);
  }
  /// True if the reverse of the store zeroes the adjoint of the element, for
  /// the value before the store.
  bool zeroesAdjoint(Operation *store) const {
    return plan.zeroing.isZeroedBy(store);
  }
  /// True if a write may run after `read` and reach the same element.
  bool mayBeOverwritten(DifferentiableAccessInterface read) const {
    return static_cast<bool>(plan.accesses.findLaterWrite(read));
  }

  //===--------------------------------------------------------------------===//
  // For loops and branches
  //===--------------------------------------------------------------------===//

  const AdjointPlan &getPlan() const { return plan; }
  const Activity &getActivity() const { return plan.activity; }
  Frame &getFrame() { return *current; }
  /// Makes `frame` the current one for the lifetime of the result.
  [[nodiscard]] llvm::SaveAndRestore<Frame *> enter(Frame &frame) {
    return llvm::SaveAndRestore<Frame *>(current, &frame);
  }
  Storage getAdjointStorage(Storage storage) { return plan.adjointOf(storage); }

  /// Reverses `primal` into `mirror`, whose terminator is left to the caller.
  /// `begin` maps the arguments of the block and seeds the adjoints of the
  /// terminator's operands; it cannot ask for primal values. `beforeSweep`, if
  /// given, runs before the sweep and `end` after it.
  LogicalResult reverseBlock(Block *primal, Block *mirror,
                             llvm::function_ref<void(Frame &)> begin,
                             llvm::function_ref<void(Frame &)> end,
                             llvm::function_ref<void()> beforeSweep = {});
  /// Mirrors a block for its primal values alone: the operands of its
  /// terminator, and the terminator itself.
  void recomputeBlock(Block *primal, Block *mirror);
  /// The adjoints in `frame` of values defined outside of its block.
  llvm::MapVector<Value, Value> takeCaptured(Frame &frame);
  /// Continues the sweep, in the current frame, through the ops of the
  /// enclosing block that define captured values, up to the reads from which
  /// the values come. Captured values whose definitions are long, or hold
  /// regions, are left to the caller.
  void sweepCaptured();
  /// The number of iterations of a serial loop, as an index.
  Value createTripCount(scf::ForOp loop);
  /// True if values of the loop are recorded by forward re-execution, because
  /// they cannot be recomputed from single iterations.
  bool isRecordedLoop(Operation *loop) const {
    return plan.reexecution.holdsRecorded(loop);
  }
  /// The number of times that the second region of `loop` ran.
  Value fetchCount(scf::WhileOp loop);

  /// Before and after the reverse of a parallel loop: emit the derivatives of
  /// atomic products and extrema whose element several iterations update; see
  /// ContendedAtomics.h.
  LogicalResult beginContended(ParallelForOp loop);
  void endContended();
  /// Notes that the adjoint reads the field of the access as it was before the
  /// launch.
  void requireBefore(Operation *access) { demands.before.insert(access); }
  /// Notes that splitting the kernel into one kernel for each loop would avoid
  /// the failure.
  void requestSplit() { demands.parts = true; }
  /// True if the adjoint re-executes stores to the storage of the access.
  bool isReexecuted(Operation *access) const;
  /// Checks that a read returns in the adjoint the value that it returned in
  /// the primal.
  bool checkReadable(DifferentiableAccessInterface read);

  /// Counts the values that a reversed loop carries, and the recorded values
  /// among them.
  void countCarried(int64_t values, int64_t recorded) {
    demands.carriedValues += values;
    demands.recordedValues += recorded;
  }

  /// Notes that the adjoint of `value` may be infinite though primal values are
  /// finite.
  void markInfinite(Value value);
  /// Notes that the adjoint of `value` may be NaN though all values are finite:
  /// a derivative that does not exist.
  void markUndefined(Value value);
  /// True if an incoming adjoint of the current rule may be NaN.
  bool isSeedUndefined() const;

  /// Reports that `op` cannot be differentiated; building then fails.
  InFlightDiagnostic emitError(Operation *op, const Twine &message);

  bool hasFailed() const { return hasErrors; }

private:
  LogicalResult reverseOp(Operation *op);
  void createOwnAdjoints(Frame &frame);
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

/// Fills the empty adjoint `shell` of `function`, which has the arguments of
/// `signature`. Sets `*needsParts` if splitting the kernel would avoid the
/// failure. Without the skip `inactive-values`, adjoints of inactive values are
/// emitted where rules exist. With `loadsStored`, fails if loading stored
/// values saves nothing.
LogicalResult fillAdjoint(FunctionOpInterface function,
                          FunctionOpInterface shell,
                          const AdjointSignature &signature,
                          AdjointOptions options, bool *needsParts = nullptr);

/// Moves adjoint zeroing into separate loops, where the remaining additions can
/// then be turned from scatters into gathers.
void splitAdjointZeroing(FunctionOpInterface adjoint);

/// Removes from the serial loops in `region` the carried values that neither
/// used results nor effects of the body depend on.
void dropDeadCarried(Region &region);

} // namespace mlir::tai

#endif // TAI_AD_REVERSE_ADJOINTBUILDER_H
