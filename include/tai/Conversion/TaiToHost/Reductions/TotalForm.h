//===- TotalForm.h - Forms of sums over all iterations ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A form defines how a partition accumulates a sum over all iterations, and how
// the kernel combines the sums of the partitions. Each form has a source file
// here; forms with more digits have an entry in
// tai/Analysis/Reductions/Forms.def. A form depends on the reduction that the
// plan wrote to the update, and on no mode.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CONVERSION_TAITOHOST_REDUCTIONS_TOTALFORM_H
#define TAI_CONVERSION_TAITOHOST_REDUCTIONS_TOTALFORM_H

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Analysis/Reductions/Accumulation.h"
#include <memory>

namespace mlir::tai {

/// The updates of one element, and how the loop accumulates them.
struct TotalUpdates {
  explicit TotalUpdates(const Total &updates);

  size_t count;
  ReductionAttr reduction;
  /// The kind of operation that combines two partial sums.
  AtomicKind kind;
  Type termType;
};

class TotalForm {
public:
  /// Creates the code generator for the form that the plan has chosen for a
  /// sum.
  static std::unique_ptr<TotalForm> create(const TotalUpdates &sum);

  explicit TotalForm(const TotalUpdates &sum) : sum(sum) {}
  virtual ~TotalForm() = default;

  /// The maximum number of iterations in a block of the sum, or 0. With
  /// `storesTerms`, that limit is strict and cuts rows of iterations as well.
  int64_t getBlockLength() const { return sum.reduction.getBlock(); }
  virtual bool storesTerms() const { return false; }

  // Emits code of the sum in the kernel before the loop.
  virtual void emitBefore(OpBuilder &builder, Location loc) {}

  // Emit code of the sum in the loop's function: at its entry, at an update,
  // after a block of iterations of `loop`, and at its end.
  virtual void emitEntry(OpBuilder &builder, Location loc) = 0;
  /// The innermost loop around an update, and the iteration of it that belongs
  /// to the first lane.
  struct Place {
    scf::ForOp loop;
    Value firstLane;
  };
  /// Emits an update of the sum. `number`: its position among the updates of
  /// the element. `update`: its kind, such as Add or Sub.
  virtual void emitTerm(OpBuilder &builder, Location loc, size_t number,
                        AtomicKind update, Value term, Place place) = 0;
  virtual void emitBlockEnd(OpBuilder &builder, Location loc, scf::ForOp loop) {
  }
  /// Returns the partial sums of the partition, as values. A sum in chunks has
  /// none, because its chunks store their sums in memory.
  virtual SmallVector<Value> emitPartial(OpBuilder &builder, Location loc) {
    return {};
  }

  // Emit code around the iterations of a chunk, for sums in the order of all
  // targets.
  virtual void emitChunkStart(OpBuilder &builder, Location loc) {}
  virtual void emitChunkEnd(OpBuilder &builder, Location loc, Value chunk) {}

  // Emitted in the kernel after the loop: the partial sum of no terms.
  /// The partial sum of no terms.
  virtual SmallVector<Value> emitNone(OpBuilder &builder, Location loc) {
    return {};
  }
  /// Combines two partial sums.
  virtual SmallVector<Value> emitCombined(OpBuilder &builder, Location loc,
                                          ValueRange sums, ValueRange partial) {
    return {};
  }
  /// Emits the total of the sums over all chunks of iterations.
  virtual Value emitChunksTotal(OpBuilder &builder, Location loc,
                                Value chunks) {
    return {};
  }
  /// Emits the addition of the total over all iterations to the element at
  /// `address`.
  virtual void emitUpdate(OpBuilder &builder, Location loc, ValueRange total,
                          Value address, AliasScopes scopes) = 0;

  /// The number of 8-byte slots that a partial sum takes.
  virtual unsigned getNumSlots() const { return 1; }

protected:
  TotalUpdates sum;
};

/// Emits the number, extended to the float type `type` if this type is wider.
Value emitWidened(OpBuilder &builder, Location loc, Value value, Type type);
/// Emits a sum computed in a wider type, rounded to the type of the field.
Value emitNarrowed(OpBuilder &builder, Location loc, Value sum, Type type);

// The forms.
std::unique_ptr<TotalForm> createLaneTotal(const TotalUpdates &sum);
std::unique_ptr<TotalForm> createRegisterTotal(const TotalUpdates &sum);
#define TAI_PRECISE_TOTAL(kind, terms, digits, form)                           \
  std::unique_ptr<TotalForm> create##form(const TotalUpdates &sum);
#include "tai/Analysis/Reductions/Forms.def"

} // namespace mlir::tai

#endif // TAI_CONVERSION_TAITOHOST_REDUCTIONS_TOTALFORM_H
