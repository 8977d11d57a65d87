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

/// True if the value that `read` loads only decides whether stores run that
/// store the same value in all iterations. Such a read, of a flag that other
/// iterations set, may save work, but does not change a result.
bool decidesOnlyFlags(DifferentiableAccessInterface read, ParallelForOp loop);

/// Returns the kind of atomic that performs the operation of `op`; nullopt if
/// there is none.
std::optional<AtomicKind> getAtomicKind(Operation *op);

/// The conditions under which a part of an expression is taken.
struct Context {
  /// The outermost select around the part of the expression; the conditions are
  /// computed before this select.
  Operation *select = nullptr;
  /// The conditions under which the part is taken, and the truth value of each.
  SmallVector<std::pair<Value, bool>, 1> conditions;
};

/// One step of an update, which becomes one atomic.
struct Step {
  /// The op before which the atomic of the step is emitted.
  Operation *at;
  AtomicKind kind;
  Value value;
  /// The type in which the program combines the terms, which may differ from
  /// the element's type.
  Type type;
  /// The conditions under which the atomic runs, and the truth value that each
  /// of them must have.
  SmallVector<std::pair<Value, bool>, 1> conditions;
  /// An access to the updated element, whose indices are computed before `at`.
  DifferentiableAccessInterface place = {};
};

/// A select that is recognised by its comparison as a minimum or a maximum.
struct Extremum {
  AtomicKind kind;
  /// value: the side of the select that does not depend on the element. old:
  /// the side that does.
  Value value, old;
};

/// A store that may be an update: it stores a value computed from the old value
/// of its element.
class SharedUpdate {
public:
  /// Analyses `store`. `accesses` are all accesses of the loop, `reads` those
  /// of its reads that go to the storage that the store writes.
  SharedUpdate(DifferentiableAccessInterface store, ParallelForOp loop,
               ArrayRef<DifferentiableAccessInterface> accesses,
               ArrayRef<DifferentiableAccessInterface> reads,
               const SameIteration &same)
      : store(store), loop(loop), same(same), old(store, loop, reads, same),
        safeReads(store, loop, same, accesses) {}

  /// True if the stored value, or the condition under which it is stored,
  /// depends on the old value of the element.
  bool readsElement();
  /// Finds the steps of the update; false if the store is not an update of a
  /// supported form.
  bool match();
  /// The kind of operation (addition, product, minimum and so on) that all
  /// steps of the update have in common.
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
  /// The ops between the loads of the element and the store, which must have no
  /// other use.
  llvm::SetVector<Operation *> path;
  /// Results of branches on the path from the loads of the element to the
  /// store.
  SmallVector<OpResult> branches;
  /// Results of serial loops on the path from the loads of the element to the
  /// store.
  SmallVector<OpResult> carried;
  /// Results of the outermost serial loops on the path from the loads to the
  /// store, and the kinds of the totals that these loops will carry.
  SmallVector<std::pair<OpResult, AtomicKind>> totals;
  /// Values of the element before the branches and loops that are being
  /// matched; the steps up to these values have been found already.
  SmallVector<Value> formers;
  /// A minimum or maximum under conditions that replaces the store, in addition
  /// to the steps; and its kind.
  std::optional<ChosenExtremum> chosen;
  AtomicKind chosenKind = AtomicKind::Min;
  /// Results of branches between the loads and the store that stay, or that
  /// `chosen` erases.
  SmallVector<OpResult> choices;
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_ACCUMULATIONS_SHAREDUPDATE_H
