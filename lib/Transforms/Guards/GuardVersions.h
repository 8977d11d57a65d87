//===- GuardVersions.h - Code with and without guards -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Parts of `tai-version-guards`: the two versions of the rest of a block, and a
// test in front of the first guard that chooses between them.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_GUARDS_GUARDVERSIONS_H
#define TAI_LIB_TRANSFORMS_GUARDS_GUARDVERSIONS_H

#include "FiniteConditions.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"

namespace mlir::tai {

/// True for an op without effects and regions, that may be moved.
inline bool isMovable(Operation *op) {
  return op->getNumRegions() == 0 && mlir::isPure(op);
}

bool hasGuardsInside(Operation &op);

Value markLikely(OpBuilder &builder, Value condition);

/// Makes two versions of the code from `begin` to the end of its block, in the
/// branches of an `scf.if` on `condition`: the then branch gets a copy, whose
/// values `bare` maps to; the else branch gets the original code, with the ops
/// `own` in front of it.
scf::IfOp createVersions(Operation *begin, Value condition, IRMapping &bare,
                         ArrayRef<Operation *> own);

/// Makes two versions of a block, with and without its guards, and selects one
/// by a test of the operands of the partial derivatives.
class EarlyTest {
public:
  explicit EarlyTest(Block &block)
      : block(block), scope(block), begin(block.begin()) {}
  /// Collects the block's own guards from `begin` to the next op with guards in
  /// its regions. `apart` are ops before `begin`, in `scope`, whose results are
  /// tested.
  EarlyTest(Block &block, Block &scope, Block::iterator begin,
            const DenseSet<Operation *> &apart)
      : block(block), scope(scope), begin(begin), isPart(true) {
    conditions.setApart(apart);
  }
  bool run();
  /// The block of the version without guards, after run().
  Block &getBare() { return *bareBlock; }

private:
  bool findGuards();
  bool canComeEarly(Value value);
  void moveEarly(Value value);
  void moveBegin();
  Value createTest();

  Block &block, &scope;
  Block::iterator begin;
  bool isPart = false;
  Block *bareBlock = nullptr;
  /// Guards whose results have other users than conditions of guards.
  SmallVector<arith::SelectOp> guards;
  /// The first op in the block that is a guard or contains one.
  Operation *first = nullptr;
  size_t numOps = 0;
  FiniteConditions conditions;
  /// Ops after the first guard, and whether they can move before it.
  DenseMap<Operation *, bool> isMovedEarly;
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_GUARDS_GUARDVERSIONS_H
