//===- CarriedValues.h - Loop-carried values, in reverse --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Two analyses of the values that `scf.for` and `scf.while` carry: how the
// value at the start of an iteration can be recovered when the iterations run
// backwards, and which of them are live.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_CARRIEDVALUES_H
#define TAI_ANALYSIS_CARRIEDVALUES_H

#include "mlir/IR/Operation.h"
#include "llvm/ADT/APInt.h"
#include "llvm/ADT/DenseSet.h"
#include <optional>

namespace mlir::tai {

/// The ways to recover the value that a loop carries at the start of an
/// iteration, in reverse.
enum class CarriedKind {
  /// The value at the start of an iteration is a closed formula of the
  /// iteration number.
  ClosedForm,
  /// The value at the start of an iteration follows from the value of the next
  /// iteration, by an exact inverse of the loop's update of the value.
  Invertible,
  /// The value cannot be recovered backwards: it must be recorded, or
  /// recomputed by running the loop forward.
  Trajectory,
};

/// One operation of the update that a loop makes to a carried value: operand
/// number `operand` of `op` is the value so far.
struct CarriedStep {
  Operation *op;
  unsigned operand;
  /// If `op` is a multiplication: its constant factor. The factor is odd, so
  /// that it has an inverse modulo a power of two.
  std::optional<llvm::APInt> factor = std::nullopt;
};

struct CarriedValue {
  CarriedKind kind = CarriedKind::Trajectory;
  /// The operations, in program order, by which the loop computes the next
  /// value of carried value number `source` from this value. Empty for kind
  /// Trajectory.
  llvm::SmallVector<CarriedStep> steps;
  unsigned source = 0;
};

/// The values that an `scf.for` or `scf.while` carries; for the latter, the
/// arguments of its first region.
class CarriedValues {
public:
  explicit CarriedValues(Operation *loop);

  const CarriedValue &operator[](unsigned index) const { return values[index]; }
  size_t size() const { return values.size(); }

  /// The number of the carried value that `value`, an argument of any region of
  /// the loop, stands for; none if it is not a carried value.
  std::optional<unsigned> getIndex(Value value) const;

private:
  bool isInvariant(Value value) const;
  bool isComputable(Value value, ArrayRef<bool> known, unsigned budget) const;
  void findClosedForm(unsigned index);
  bool invert(unsigned source, ArrayRef<bool> known);
  Value getNext(unsigned index) const;

  Operation *loop;
  llvm::SmallVector<CarriedValue, 4> values;
};

/// Liveness of the values in a region: a value is live if effects, or
/// terminators of the region's own blocks, need it. Each result of a branch or
/// loop has its own liveness.
class LiveValues {
public:
  explicit LiveValues(Region &region);

  bool isLive(Value value) const { return live.contains(value); }

private:
  void mark(Value value);
  void markOperands(Operation *op);
  void markControl(Operation *inside);
  void visit(Value value);
  void visitResult(OpResult result);
  void visitArgument(BlockArgument argument);

  Region &region;
  llvm::DenseSet<Value> live;
  llvm::SmallVector<Value> worklist;
  llvm::DenseSet<Operation *> controlled;
};

} // namespace mlir::tai

#endif // TAI_ANALYSIS_CARRIEDVALUES_H
