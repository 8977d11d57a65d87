//===- ChosenExtremum.h - A minimum under conditions ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A program writes a minimum as `x = v if c and v < x else x`, as `if not (d or
// v >= x): x = v` or in a similar way. Each is an update of x to min(x, v)
// under a condition that does not depend on x.
//
// A truth table recognises the update. Its rows are the combinations of
// conditions that are computed without x, with v less or greater than x. If x
// becomes v where v is less, and stays where v is greater, x is updated under
// these conditions; if x stays in both cases, it is not. Any other table is no
// minimum. Maxima are recognised in the same way.
//
// The condition of the update is obtained by replacing the comparisons of v and
// x by their results where v is less.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_ACCUMULATIONS_CHOSENEXTREMUM_H
#define TAI_LIB_TRANSFORMS_ACCUMULATIONS_CHOSENEXTREMUM_H

#include "OldValue.h"
#include "SafeReads.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "llvm/ADT/SetVector.h"

namespace mlir::tai {

/// True for atomic kinds that are minima or maxima.
bool isExtremum(AtomicKind kind);

/// Returns the width in bits of a type of numbers; an index has 64.
unsigned getNumberWidth(Type type);

/// True if no op nested in `op`, other than `but`, has an effect other than a
/// read.
bool hasNoEffectBut(Operation *op, Operation *but = nullptr);

/// A branch around an op, and the side of the branch that the op is on.
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
  /// The number that the program compares with the element of the update.
  Value getGiven() const { return given; }
  /// Returns the value with which the program compares the given number: the
  /// element, or an earlier update of the element.
  Value getFormer() const { return former; }
  /// The op by which the program extends the element to a wider type, if any.
  std::optional<OperationName> getExtension() const { return extension; }
  ArrayRef<DifferentiableAccessInterface> getLoads() const { return loads; }
  /// The ops between the loads of the element and the store.
  ArrayRef<Operation *> getPath() const { return path.getArrayRef(); }
  /// Results of branches between the loads of the element and the store.
  ArrayRef<OpResult> getBranches() const { return branches; }

  /// Calls `emit` wherever the element becomes the minimum of itself and a
  /// value, and erases the store. Removes erased ops from `path` and
  /// `formerLoads`, and ops that stay from `path`.
  void rewrite(llvm::SetVector<Operation *> &path,
               SmallVectorImpl<DifferentiableAccessInterface> &formerLoads,
               function_ref<void(OpBuilder &, Value)> emit);

private:
  enum class Order { Less, Greater, FormerIsNaN };
  /// A row of the truth table: how the given number compares with the former
  /// one, and which conditions hold.
  struct Row {
    Order order;
    unsigned holding;
  };
  /// A value that is the extremum of the former value of the element and the
  /// given number.
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
  /// True if the number that is compared with the element dominates the store.
  bool isGivenKnown = false;
  std::optional<OperationName> extension;
  /// Tells whether the comparisons found so far interpret integers as signed or
  /// unsigned.
  enum class Signs { None, Signed, Unsigned, Both };
  Signs signs = Signs::None;
  bool asksForNaN = false;
  unsigned visited = 0;
  SmallVector<SideOfBranch, 1> guards;
  /// The conditions that do not depend on the element. `numbers` has the
  /// position of each condition in `atoms`; equal conditions share a position.
  SmallVector<Value, 4> atoms;
  llvm::DenseMap<Value, unsigned> numbers;
  SmallVector<Operation *, 1> comparisons;
  /// The values that the store may store: given numbers, the former value of
  /// the element, and extrema of both.
  SmallVector<Value, 2> givenValues;
  llvm::DenseSet<Value> formerValues;
  llvm::DenseMap<Value, Extremum> extrema;
  SmallVector<DifferentiableAccessInterface> loads;
  llvm::SetVector<Operation *> path;
  SmallVector<OpResult> branches;
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_ACCUMULATIONS_CHOSENEXTREMUM_H
