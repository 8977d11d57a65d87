//===- ContendedAtomics.h - Products and extrema over loops -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The derivatives of atomic products, minima and maxima of elements that
// several iterations of a parallel loop update. See ContendedAtomics.cpp for
// the adjoint, and Contention.cpp for the formulas.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_REVERSE_CONTENDEDATOMICS_H
#define TAI_LIB_AD_REVERSE_CONTENDEDATOMICS_H

#include "tai/AD/Reverse/AdjointBuilder.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// One dimension of a loop around an atomic: its induction variable in the
/// primal, and its range in the adjoint. A null step means 1.
struct CountedLoop {
  Value iv;
  Value lower, step, extent;
};

/// Buffers over the executions of an atomic: the value of the atomic, replaced
/// later by the adjoint of that value, and the number of the element, or -1 if
/// the atomic was not executed.
struct KeptValues {
  SmallVector<CountedLoop> loops;
  Value size, values, elements;
};

/// Emits the adjoint of all contended updates of one kind to one field in one
/// parallel loop.
class Contention {
public:
  Contention(AdjointBuilder &b, ParallelForOp loop, AtomicKind kind)
      : b(b), loop(loop), kind(kind) {}

  void add(AtomicOp atomic) { atomics.push_back(atomic); }
  MutableArrayRef<AtomicOp> getAtomics() { return atomics; }

  /// Emits the allocation of the buffers that have an entry for each element of
  /// the field.
  LogicalResult prepare();
  KeptValues createKept(ArrayRef<CountedLoop> loops);
  /// Emits, after `copy` (the atomic in a copy of the loop), stores of its
  /// value and element. `run` is their position in the buffers.
  void keepValue(const KeptValues &kept, AtomicOp copy, Value run);
  /// Emits the loops that replace each kept value by its adjoint, and the
  /// adjoint of each element by the adjoint of the element's value before the
  /// loop.
  void createAdjoints(ArrayRef<KeptValues> kept);

private:
  /// One dimension of the set of elements that a contended atomic updates.
  struct Dimension {
    Value fixed; // null unless all updates have the same index
    int64_t first, extent;
  };
  /// The element at which a loop over all updated elements currently is.
  struct Element {
    Value number;
    SmallVector<Value> indices, components;
  };

  LogicalResult findDimensions();
  Value createBuffer(Value size, Type type, Value init);
  void createLoop(ValueRange sizes,
                  llvm::function_ref<void(ValueRange)> createBody);
  void createElementLoop(llvm::function_ref<void(const Element &)> createBody);
  void createValueLoop(const KeptValues &kept,
                       llvm::function_ref<void(Value, Value, Value)> create);
  Value createFactorAdjoint(Value factor, Value element);
  void startProduct();
  void countDeciding(const KeptValues &kept);
  void createProductWeights();
  void createExtremeWeights();
  void createShares(const KeptValues &kept);

  Value loadElement(Storage storage, const Element &element);
  void storeElement(Value value, Storage storage, const Element &element);
  Storage getStorage() { return atomics.front().getFieldAttr(); }
  Value load(Value buffer, Value at);
  void store(Value value, Value buffer, Value at);
  Value compare(arith::CmpFPredicate predicate, Value lhs, Value rhs);
  Value select(Value condition, Value yes, Value no);
  Value constant(double value) { return b.createConstant(real, value); }
  Value integer(int64_t value);
  Value isInteger(Value value, int64_t expected);
  Value isZero(Value value);
  Value toReal(Value value);

  AdjointBuilder &b;
  ParallelForOp loop;
  AtomicKind kind;
  SmallVector<AtomicOp> atomics;
  /// The float type in which adjoints are computed: that of the field, but at
  /// least f32.
  Type real;
  SmallVector<Dimension> dimensions;
  unsigned rank = 0; // of the field, without its components
  /// Buffers with an entry for each element. `total`: the extreme value, or the
  /// product of the non-zero factors. `count`: the number of values equal to
  /// the extreme, or of factors that are zero. `weight`: the adjoint of each
  /// counted value.
  Value numElements, total, count, weight;
};

class ContendedAtomics {
public:
  explicit ContendedAtomics(AdjointBuilder &builder) : b(builder) {}

  /// Emits the adjoints of the contributions of all contended atomics in
  /// `loop`. Must be called before the reverse of the loop is emitted.
  LogicalResult begin(FunctionOpInterface kernel, ParallelForOp loop);
  /// Returns the adjoint of the value that `atomic` contributes, or null if the
  /// atomic is not contended. Called while the reverse of the loop is emitted.
  Value getAdjoint(AtomicOp atomic);
  /// Frees the buffers of the contended atomics. Must be called after the
  /// reverse of the loop is emitted.
  void end();

private:
  LogicalResult check(FunctionOpInterface kernel, ParallelForOp loop,
                      AtomicOp atomic);
  FailureOr<SmallVector<CountedLoop>> countLoops(ParallelForOp loop,
                                                 AtomicOp atomic);
  LogicalResult keepValues(FunctionOpInterface kernel, ParallelForOp loop,
                           MutableArrayRef<Contention> groups);

  AdjointBuilder &b;
  llvm::MapVector<Operation *, KeptValues> kept;
};

/// True if `value` is computed outside of `loop`, and so has the same value in
/// all iterations.
bool isKnownBefore(Operation *loop, Value value);

/// Returns the position that an atomic updates: the indices of the element,
/// then the indices of the component.
SmallVector<Value> getElementPosition(AtomicOp atomic);

} // namespace mlir::tai

#endif // TAI_LIB_AD_REVERSE_CONTENDEDATOMICS_H
