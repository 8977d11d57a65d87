//===- SharedUpdate.h - An update of a shared element -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A store whose value comes from the element itself, followed backwards; see
// RecognizeReductions.cpp.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_ACCUMULATIONS_SHAREDUPDATE_H
#define TAI_LIB_TRANSFORMS_ACCUMULATIONS_SHAREDUPDATE_H

#include "ChosenExtremum.h"
#include "OldValue.h"
#include "mlir/Dialect/Arith/IR/Arith.h"

namespace mlir::tai {

/// True if all iterations that execute `store` store the same value.
bool storesTheSame(DifferentiableAccessInterface store, ParallelForOp loop);

/// The kind of atomic that has the operation of `op`, if there is one.
std::optional<AtomicKind> getAtomicKind(Operation *op);

/// The conditions under which a part of an expression is taken.
struct Context {
  /// The outermost select around the part: the conditions are computed before
  /// it.
  Operation *select = nullptr;
  /// Each condition, and whether it must be true or false.
  SmallVector<std::pair<Value, bool>, 1> conditions;
};

/// One atomic that an update becomes.
struct Step {
  /// The atomic is emitted before this op.
  Operation *at;
  AtomicKind kind;
  Value value;
  /// The type in which the program combines, which may differ from the
  /// element's.
  Type type;
  /// The atomic runs where each condition has the given truth value.
  SmallVector<std::pair<Value, bool>, 1> conditions;
  /// An access whose indices are computed before `at`.
  DifferentiableAccessInterface place = {};
};

/// A select whose comparison says that it is a minimum or a maximum.
struct Extremum {
  AtomicKind kind;
  /// The side that does not depend on the element, and the side that does.
  Value value, old;
};

/// A store that may be an update of its element.
class SharedUpdate {
public:
  /// `accesses` are all accesses of the loop, `reads` its reads of the storage
  /// that the store writes.
  SharedUpdate(DifferentiableAccessInterface store, ParallelForOp loop,
               ArrayRef<DifferentiableAccessInterface> accesses,
               ArrayRef<DifferentiableAccessInterface> reads,
               const SameIteration &same)
      : store(store), loop(loop), same(same), old(store, loop, reads, same),
        safeReads(store, loop, same, accesses) {}

  /// True if the stored value, or whether it is stored, depends on the element.
  bool readsElement();
  /// Finds the steps. False if the store is not an update of a supported form.
  bool match();
  /// The operation that all steps have in common.
  AtomicKind getFamily() const { return *family; }
  void rewrite();

  ArrayRef<DifferentiableAccessInterface> getLoads() const { return loads; }
  DifferentiableAccessInterface getStore() const { return store; }

private:
  void forget();
  bool matchValue(Value value, const Context &context);
  bool matchCombination(Operation *op, AtomicKind kind, const Context &context);
  bool matchSelect(arith::SelectOp select, const Context &context);
  bool matchBranch(OpResult result, const Context &context);
  bool matchLoop(OpResult result, const Context &context);
  std::optional<Value> findFormer(Value value, Operation *scope) const;
  bool matchChosen();
  std::optional<Extremum> getExtremum(Value condition, Value whenTrue,
                                      Value whenFalse);
  bool accepts(Step &step);
  bool addStep(Step step);
  bool isOnlyUsedHere();
  bool isUndisturbed();
  Value convert(OpBuilder &b, Location loc, Value value);
  void emit(OpBuilder &b, Location loc, const Step &step);

  DifferentiableAccessInterface store;
  ParallelForOp loop;
  const SameIteration &same;
  OldValue old;
  SafeReads safeReads;
  SmallVector<DifferentiableAccessInterface> loads;
  std::optional<AtomicKind> family;
  /// The op by which the program extends the element to a wider type, if any.
  std::optional<OperationName> extension;
  SmallVector<Step> steps;
  /// Ops between the loads and the store, which are to have no other use.
  llvm::SetVector<Operation *> path;
  /// Results of branches on the path.
  SmallVector<OpResult> branches;
  /// Results of serial loops on the path.
  SmallVector<OpResult> carried;
  /// Results of the outermost loops on the path, and the kinds of their totals.
  SmallVector<std::pair<OpResult, AtomicKind>> totals;
  /// Updates before the branches and loops that are being matched, whose steps
  /// have been found already.
  SmallVector<Value> formers;
  /// An extremum that replaces the store, in addition to the steps, and its
  /// kind.
  std::optional<ChosenExtremum> chosen;
  AtomicKind chosenKind = AtomicKind::Min;
  /// Results of branches on the path that stay, or that `chosen` erases.
  SmallVector<OpResult> choices;
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_ACCUMULATIONS_SHAREDUPDATE_H
