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
  /// In the mirror of a primal block, recomputed ops are inserted between these
  /// two marker ops. Both are null in a frame that only recomputes primal
  /// values: its ops go to the end of the mirror.
  Operation *recomputeBegin = nullptr;
  Operation *sweepBegin = nullptr;
  /// Maps the values of the primal block to their values in its mirror.
  IRMapping values;
  /// For each recomputed primal op, the first op of its copy in the mirror.
  std::map<Operation *, Operation *, ProgramOrder> recomputed;
  /// The adjoints known in this frame: of values that the primal block defines,
  /// and of values captured from outside of the block.
  llvm::MapVector<Value, PartialAdjoint> adjoints;
  /// In the reverse of a serial loop: the number of the primal iteration, from
  /// 0, and the history that recovers the values with which it began.
  Value iteration;
  LoopHistory *history = nullptr;
  /// The values of the primal block of `parent` that are forwarded to the
  /// arguments of this block; empty if the arguments come from elsewhere.
  SmallVector<Value> argumentValues;
  /// The recorded primal values that have been popped from their stack in this
  /// frame.
  DenseSet<Value> popped;
  /// Buffers allocated in the mirror block, which are freed at its end.
  SmallVector<Value> buffers;
};

class AdjointBuilder : public DerivativeBuilder {
public:
  /// Builds the operations of `plan` into the body of `adjoint`, whose
  /// arguments begin with the arguments of the primal.
  AdjointBuilder(FunctionOpInterface adjoint, const AdjointPlan &plan);
  ~AdjointBuilder();

  /// Builds the adjoint function, except its terminator, which the caller adds.
  /// Fails after an error at an op that cannot be differentiated.
  LogicalResult build();
  /// The primal values and versions of memory that the adjoint needs. The plan
  /// possibly lacks some of them: the planner compares these demands with it
  /// (`AdjointPlanner::settle`).
  const PrimalDemands &getDemands() const { return demands; }

  //===--------------------------------------------------------------------===//
  // For rules
  //===--------------------------------------------------------------------===//

  /// True if a primal value is active: its adjoint can reach the result.
  bool isActive(Value value) const { return plan.activity.isActive(value); }
  /// The primal value, recomputed in the adjoint kernel if necessary.
  Value getPrimal(Value value) override;
  SmallVector<Value> getPrimals(ValueRange values);
  /// The adjoint of a primal value, or null where the adjoint is zero.
  Value getAdjoint(Value value);
  /// The adjoint of a primal value, as a constant zero where it is zero.
  Value getAdjointOrZero(Value value);
  /// Row-major components of the adjoint of a vector; components that are zero
  /// are null.
  SmallVector<Value> getAdjointComponents(Value value);
  /// Adds `contribution` to the adjoint of a primal value. Emits nothing if the
  /// value is not active or the contribution is null (zero).
  void addAdjoint(Value value, Value contribution);
  /// Adds a contribution to one component (row-major) of the adjoint of a
  /// vector.
  void addAdjointComponent(Value value, int64_t component, Value contribution);
  /// True if the reverse sweep emits operations for an access to memory.
  bool isReversed(Operation *access) const {
    return plan.activity.isActiveAccess(access) || zeroesAdjoint(access);
  }
  /// True if the reverse of the store zeroes the adjoint of the stored element,
  /// which from then on is the adjoint of the element's value before the store.
  bool zeroesAdjoint(Operation *store) const {
    return plan.zeroing.isZeroedBy(store);
  }
  /// True if a write of the primal kernel may run after `read` and reach the
  /// same element.
  bool mayBeOverwritten(DifferentiableAccessInterface read) const {
    return static_cast<bool>(plan.accesses.findLaterWrite(read));
  }

  //===--------------------------------------------------------------------===//
  // For loops and branches
  //===--------------------------------------------------------------------===//

  const AdjointPlan &getPlan() const { return plan; }
  const Activity &getActivity() const { return plan.activity; }
  Frame &getFrame() { return *current; }
  /// Makes `frame` the current frame for the lifetime of the result.
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
  /// Mirrors a primal block in the adjoint kernel for its primal values alone:
  /// emits the operands of the terminator, and the terminator itself, but no
  /// reverse sweep.
  void recomputeBlock(Block *primal, Block *mirror);
  /// The adjoints, known in `frame`, of values defined outside of the block of
  /// the frame.
  llvm::MapVector<Value, Value> takeCaptured(Frame &frame);
  /// Continues the sweep, in the current frame, through the ops of the
  /// enclosing block that define captured values, up to the reads from which
  /// the values come. Captured values whose definitions are long, or hold
  /// regions, are left to the caller.
  void sweepCaptured();
  /// The number of iterations of a serial loop, as an index.
  Value createTripCount(scf::ForOp loop);
  /// True if values that a serial loop carries are recorded by forward
  /// re-execution, because they cannot be recomputed from single iterations.
  bool isRecordedLoop(Operation *loop) const {
    return plan.reexecution.holdsRecorded(loop);
  }
  /// The number of times that the second region of `loop`, its body, ran.
  Value fetchCount(scf::WhileOp loop);

  /// Before and after the reverse of a parallel loop: emit the derivatives of
  /// atomic products and extrema whose element several iterations update; see
  /// ContendedAtomics.h.
  LogicalResult beginContended(ParallelForOp loop);
  void endContended();
  /// Notes that the adjoint reads the field of the access as it was before the
  /// launch of the primal kernel.
  void requireBefore(Operation *access) { demands.before.insert(access); }
  /// Notes that splitting the kernel into one kernel for each loop would avoid
  /// the failure.
  void requestSplit() { demands.parts = true; }
  /// True if the adjoint re-executes stores to the storage of the access.
  bool isReexecuted(Operation *access) const;
  /// Checks that a memory read returns in the adjoint the value that it
  /// returned in the primal; notes a demand or reports an error otherwise.
  bool checkReadable(DifferentiableAccessInterface read);

  /// Counts the values that a reversed loop carries, and the recorded values
  /// among them.
  void countCarried(int64_t values, int64_t recorded) {
    demands.carriedValues += values;
    demands.recordedValues += recorded;
  }

  /// Notes that the adjoint of `value` may be infinite even where all primal
  /// values are finite.
  void markInfinite(Value value);
  /// Notes that the adjoint of `value` may be NaN, for a derivative that does
  /// not exist, even where all primal values are finite.
  void markUndefined(Value value);
  /// True if an incoming adjoint of the derivative rule being applied may be
  /// NaN.
  bool isSeedUndefined() const;

  /// Reports that `op` cannot be differentiated; building the adjoint then
  /// fails.
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
