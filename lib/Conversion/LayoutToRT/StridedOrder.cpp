//===- StridedOrder.cpp - Iterations whose accesses keep their order ------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "StridedOrder.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"
#include <cstdlib>

using namespace mlir;
using namespace mlir::tai;

namespace {
struct ElementAccess {
  Operation *op;
  /// The field of the access; null for an access to an array, since any two
  /// arrays may alias.
  const FieldInfo *field;
  ValueRange indices, components;
  bool stores;
  /// Returns the innermost serial loop around `op` that is inside the parallel
  /// loop.
  Operation *loop = nullptr;
  bool isStrided = true;
};

/// True if elements with neighbouring last indices lie side by side in memory.
bool isPacked(const FieldInfo &field) {
  if (field.numComponents != 1)
    return false;
  unsigned last = field.layout.shape.size() - 1;
  return field.layout.shape.empty() ||
         llvm::any_of(field.storage.digits, [&](const IndexDigit &digit) {
           return digit.dimension == last && digit.divisor == 1 &&
                  digit.stride == static_cast<uint64_t>(field.scalarSize);
         });
}

/// True if the address of an access may go up by more than one element, or
/// down, from one iteration to the next.
bool isStrided(const ElementAccess &access, Value iv) {
  if (!access.components.empty())
    return true;
  for (auto [number, index] : llvm::enumerate(access.indices)) {
    bool isLast = number + 1 == access.indices.size();
    for (const auto &[atom, factor] : getIndexExpr(index).terms) {
      // A value computed from `iv` need not be linear in it. Induction
      // variables of the other dimensions are constant in the innermost loop.
      bool isIndex = atom.getValue() == iv;
      bool isOther = !atom.allOf([&](Value value) {
        auto argument = dyn_cast<BlockArgument>(value);
        bool isOuter = argument && argument.getOwner() == iv.getParentBlock();
        return (isOuter && (isIndex || value != iv)) ||
               value.getParentRegion() != iv.getParentRegion();
      });
      if (isOther || (isIndex && (!isLast || factor != 1)))
        return true;
    }
  }
  return false;
}

/// True if two accesses may reach the same element of the same storage.
bool mayAlias(const ElementAccess &a, const ElementAccess &b) {
  if ((a.field ? a.field->scope : nullptr) !=
      (b.field ? b.field->scope : nullptr))
    return false;
  if (a.field && areProvablyDistinct(a.indices, b.indices))
    return false;
  if (a.components.size() != b.components.size())
    return true;
  for (auto [x, y] : llvm::zip(a.components, b.components)) {
    std::optional<int64_t> first = getConstantIntValue(x);
    std::optional<int64_t> second = getConstantIntValue(y);
    if (first && second && *first != *second)
      return false;
  }
  return true;
}

/// True if each iteration of the serial loop around the access reaches another
/// element, because the induction variable of this loop is a term of an index.
bool variesWithRounds(const ElementAccess &access) {
  return llvm::any_of(access.indices, [&](Value index) {
    return llvm::any_of(getIndexExpr(index).terms, [&](const auto &term) {
      auto argument = dyn_cast_if_present<BlockArgument>(term.first.getValue());
      return argument && argument.getArgNumber() == 0 &&
             isa<scf::ForOp>(access.loop) &&
             argument.getOwner()->getParentOp() == access.loop;
    });
  });
}

/// True if a later iteration of the serial loop may access through `other` the
/// element that `store` writes.
bool mayAliasAcrossIterations(const ElementAccess &store,
                              const ElementAccess &other) {
  if (!store.loop || !other.loop)
    return false;
  return store.loop != other.loop || !variesWithRounds(store) ||
         !areProvablyEqual(store.indices, other.indices);
}

/// True if an iteration of `loop` executes at most one of the two accesses:
/// they are in different arms of a branch that each iteration executes once,
/// such as the branch between interior and border.
bool excludeEachOther(const ElementAccess &a, const ElementAccess &b,
                      ParallelForOp loop) {
  for (Operation *op = a.op; op != loop; op = op->getParentOp()) {
    Operation *parent = op->getParentOp();
    if (isa<scf::IfOp>(parent) && parent->isProperAncestor(b.op))
      return !op->getParentRegion()->isAncestor(b.op->getParentRegion()) &&
             parent->getParentOfType<LoopLikeOpInterface>().getOperation() ==
                 loop.getOperation();
  }
  return false;
}

SmallVector<ElementAccess> collectAccesses(ParallelForOp loop,
                                           FieldTable &fields) {
  SmallVector<ElementAccess> accesses;
  auto add = [&](Operation *op, FlatSymbolRefAttr name, ValueRange indices,
                 ValueRange components, bool stores) {
    const FieldInfo *field = nullptr;
    if (name)
      if (auto found = fields.lookup(op, name); succeeded(found))
        field = *found;
    accesses.push_back({op, field, indices, components, stores});
  };
  loop.getBody().walk<WalkOrder::PreOrder>([&](Operation *op) {
    if (auto load = dyn_cast<LoadOp>(op))
      add(op, load.getFieldAttr(), load.getIndices(), load.getComponents(),
          false);
    else if (auto store = dyn_cast<StoreOp>(op))
      add(op, store.getFieldAttr(), store.getIndices(), store.getComponents(),
          true);
    else if (auto atomic = dyn_cast<AtomicOp>(op); atomic && !isDoneByLoop(op))
      // Updates for which the loop keeps a sum are skipped, since they
      // accumulate to private partial sums.
      add(op, atomic.getFieldAttr(), atomic.getIndices(),
          atomic.getComponents(), true);
    else if (auto load = dyn_cast<memref::LoadOp>(op))
      add(op, {}, load.getIndices(), {}, false);
    else if (auto store = dyn_cast<memref::StoreOp>(op))
      add(op, {}, store.getIndices(), {}, true);
    else if (auto atomic = dyn_cast<memref::AtomicRMWOp>(op))
      add(op, {}, atomic.getIndices(), {}, true);
  });
  Value iv = loop.getBody().front().getArguments().back();
  for (ElementAccess &access : accesses) {
    auto inner = access.op->getParentOfType<LoopLikeOpInterface>();
    if (inner && inner != loop.getOperation() && loop->isAncestor(inner))
      access.loop = inner;
    access.isStrided =
        (access.field && !isPacked(*access.field)) || isStrided(access, iv);
  }
  return accesses;
}
} // namespace

bool tai::needsOrderWithin(ParallelForOp loop, FieldTable &fields) {
  if (loop.getBody().front().getNumArguments() == 0)
    return false;
  SmallVector<ElementAccess> accesses = collectAccesses(loop, fields);
  for (size_t i = 0; i < accesses.size(); ++i) {
    const ElementAccess &store = accesses[i];
    if (!store.stores)
      continue;
    for (size_t j = 0; j < accesses.size(); ++j) {
      const ElementAccess &other = accesses[j];
      // Inner loops may be unrolled: an access of a later iteration then
      // follows the store, even if it precedes the store in the body.
      bool isAfter = j > i || mayAliasAcrossIterations(store, other);
      if (isAfter && j != i && (store.isStrided || other.isStrided) &&
          mayAlias(store, other) && !excludeEachOther(store, other, loop))
        return true;
    }
    if (store.isStrided && mayAliasAcrossIterations(store, store))
      return true;
  }
  return false;
}
