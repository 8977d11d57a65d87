//===- ChosenExtremum.h - A minimum under conditions ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A program writes `x = v if c and v < x else x`, `if not (d or v >= x): x = v`
// and the like. All are one minimum, under a condition that does not ask for x.
//
// A table of truth finds it. Each condition that is computed without x is true
// or false, and v is less or greater than x. If x becomes v where v is less,
// and stays where v is greater, x becomes the minimum of both, where the
// condition holds; if it stays in both cases, the condition does not hold.
// Anything else is no minimum. Maxima are found in the same way.
//
// The condition is then left by putting the answer of "v is less" in the place
// of the comparisons.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_ACCUMULATIONS_CHOSENEXTREMUM_H
#define TAI_LIB_TRANSFORMS_ACCUMULATIONS_CHOSENEXTREMUM_H

#include "OldValue.h"
#include "SafeReads.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "llvm/ADT/SetVector.h"

namespace mlir::tai {

/// True for minima and maxima.
bool isExtremum(AtomicKind kind);

/// The bits of a number; an index has 64.
unsigned getNumberWidth(Type type);

/// True if no op in `op` has an effect, except for `but`. It may read.
bool hasNoEffectBut(Operation *op, Operation *but = nullptr);

/// The branch that an op is in, and the side.
struct SideOfBranch {
  scf::IfOp branch;
  bool inThen;
};

class ChosenExtremum {
public:
  ChosenExtremum(DifferentiableAccessInterface store, ParallelForOp loop,
                 const SameIteration &same, const OldValue &old,
                 const SafeReads &reads)
      : store(store), stored(store.getAccessedValue()), loop(loop), same(same),
        old(old), reads(reads) {}

  bool match();

  AtomicKind getKind() const { return kind; }
  /// The number that the program compares with the element.
  Value getGiven() const { return given; }
  /// The value that it is compared with: the element, or an update of it.
  Value getFormer() const { return former; }
  /// The extension by which the program has made the element wide.
  std::optional<OperationName> getExtension() const { return extension; }
  ArrayRef<DifferentiableAccessInterface> getLoads() const { return loads; }
  /// Ops between the loads and the store.
  ArrayRef<Operation *> getPath() const { return path.getArrayRef(); }
  /// Results of branches on the path.
  ArrayRef<OpResult> getBranches() const { return branches; }

  /// Calls `emit` where the element is to become the minimum of itself and a
  /// value, and erases the store. Takes from `path` and `formerLoads` the ops
  /// that it erases, and from `path` those that stay.
  void rewrite(llvm::SetVector<Operation *> &path,
               SmallVectorImpl<DifferentiableAccessInterface> &formerLoads,
               function_ref<void(OpBuilder &, Value)> emit);

private:
  enum class Order { Less, Greater, FormerIsNaN };
  /// A row of the table: how the given number compares with the former one, and
  /// which conditions hold.
  struct Row {
    Order order;
    unsigned holding;
  };
  /// A value that is an extremum itself.
  struct Extremum {
    AtomicKind kind;
    Value given;
  };

  Value getNumber(Value value) const;
  bool isFormer(Value number) const;
  bool collectCondition(Value condition);
  bool addAtom(Value condition);
  bool addComparison(Operation *op);
  bool collectValue(Value value, Operation *user);
  bool addConversions(Value value, Value number);
  bool isExtendedAlike(Value number) const;
  bool isGiven(Value value) const;
  bool addExtremum(Value value, Operation *op);
  bool compares(Operation *op, Order order) const;
  bool holds(Value condition, Row row) const;
  bool takes(Value value, Row row) const;
  bool takes(Row row) const;
  bool decide();
  Order getTaken() const {
    bool isMin = kind == AtomicKind::Min || kind == AtomicKind::MinU;
    return isMin ? Order::Less : Order::Greater;
  }
  bool mayRunMore(scf::IfOp branch,
                  const llvm::SetVector<Operation *> &compared);
  bool mayTake(Value value) const;
  void sink(OpBuilder &b, Value value,
            function_ref<void(OpBuilder &, Value)> emit);

  DifferentiableAccessInterface store;
  Value stored;
  ParallelForOp loop;
  const SameIteration &same;
  const OldValue &old;
  const SafeReads &reads;

  AtomicKind kind = AtomicKind::Min;
  Value given, former;
  /// Whether the given number is known at the store.
  bool isGivenKnown = false;
  std::optional<OperationName> extension;
  /// How comparisons take the bits of integers.
  enum class Signs { None, Signed, Unsigned, Both };
  Signs signs = Signs::None;
  bool asksForNaN = false;
  unsigned visited = 0;
  SmallVector<SideOfBranch, 1> guards;
  /// Conditions that do not ask for the element; equal ones have one number.
  SmallVector<Value, 4> atoms;
  llvm::DenseMap<Value, unsigned> numbers;
  SmallVector<Operation *, 1> comparisons;
  /// Values that the store may take: those that are given, the former one, and
  /// extrema of both.
  SmallVector<Value, 2> givenValues;
  llvm::DenseSet<Value> formerValues;
  llvm::DenseMap<Value, Extremum> extrema;
  SmallVector<DifferentiableAccessInterface> loads;
  llvm::SetVector<Operation *> path;
  SmallVector<OpResult> branches;
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_ACCUMULATIONS_CHOSENEXTREMUM_H
