//===- MadeArrays.cpp - Arrays that loops and branches make ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A loop may carry an array that each iteration makes anew, and a branch may
// yield an array of its own: bufferized tensors look so. Here one array is made
// before the loop or branch, and the yielded one is copied to it.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/Interfaces/ViewLikeInterface.h"
#include "tai/AD/Foreign/Foreign.h"

using namespace mlir;
using namespace mlir::tai;

/// The array that `value` is, or is a view of.
static Value getArray(Value value) {
  while (auto view = value.getDefiningOp<ViewLikeOpInterface>())
    value = view.getViewSource();
  return value;
}

/// True if `value` is an array of a known size that is made inside of `op`.
static bool isMadeIn(Operation *op, Value value) {
  auto type = dyn_cast<MemRefType>(value.getType());
  Operation *maker = getArray(value).getDefiningOp();
  return type && type.hasStaticShape() &&
         isa_and_present<memref::AllocOp, memref::AllocaOp>(maker) &&
         op->isProperAncestor(maker);
}

/// True if an op may change the array through `value` or through a view of it.
static bool isWritten(Value value) {
  return llvm::any_of(value.getUsers(), [&](Operation *user) {
    if (isa<ViewLikeOpInterface>(user))
      return isWritten(user->getResult(0));
    if (auto copy = dyn_cast<memref::CopyOp>(user))
      return copy.getTarget() == value;
    return !isa<memref::LoadOp, memref::DimOp, memref::DeallocOp, scf::YieldOp,
                scf::ConditionOp>(user);
  });
}

namespace {
/// Gives the arrays that one loop or branch carries memory of their own.
class Keeper {
public:
  Keeper(Operation *op, bool areTensors)
      : op(op), areTensors(areTensors), b(op->getLoc(), op) {}

  void run();

private:
  void keepLoop(MutableArrayRef<OpOperand> inits, ArrayRef<Value> carried,
                MutableArrayRef<OpOperand> yielded, ArrayRef<Value> results);
  void keepResults(ArrayRef<MutableArrayRef<OpOperand>> yielded,
                   ArrayRef<SmallVector<Value>> results);
  bool mayKeep(ArrayRef<Value> values) {
    return areTensors || llvm::none_of(values, isWritten);
  }

  /// Makes an array of the type `type`.
  Value create(Type type) {
    auto array = cast<MemRefType>(type);
    Value made = memref::AllocOp::create(
        b,
        MemRefType::get(array.getShape(), array.getElementType(),
                        MemRefLayoutAttrInterface(), array.getMemorySpace()));
    return made.getType() == type ? made
                                  : memref::CastOp::create(b, type, made);
  }
  /// Replaces `value` by the array `kept`, which is not freed with it.
  static void replace(Value value, Value kept) {
    for (Operation *user : llvm::make_early_inc_range(value.getUsers()))
      if (isa<memref::DeallocOp>(user))
        user->erase();
    value.replaceAllUsesWith(kept);
  }

  Operation *op;
  bool areTensors;
  ImplicitLocOpBuilder b;
};
} // namespace

/// For a loop that begins with `inits` and goes on with `yielded`; `carried`
/// are the values in its body.
void Keeper::keepLoop(MutableArrayRef<OpOperand> inits, ArrayRef<Value> carried,
                      MutableArrayRef<OpOperand> yielded,
                      ArrayRef<Value> results) {
  SmallVector<bool> keeps;
  for (auto [i, value] : llvm::enumerate(carried)) {
    SmallVector<Value> names{value};
    if (i < results.size())
      names.push_back(results[i]);
    keeps.push_back(isMadeIn(op, yielded[i].get()) && mayKeep(names));
  }
  // An array that moves on from another place of the same loop is copied, too,
  // since the other place will be overwritten.
  bool changed = true, moves = false;
  while (changed) {
    changed = false;
    for (auto [i, use] : llvm::enumerate(yielded)) {
      if (!isa<MemRefType>(use.get().getType()))
        continue;
      for (auto [k, value] : llvm::enumerate(carried)) {
        if (k == i || !keeps[k] || getArray(use.get()) != value)
          continue;
        moves = true;
        auto type = cast<MemRefType>(use.get().getType());
        if (keeps[i])
          continue;
        if (!type.hasStaticShape() || !mayKeep({carried[i]})) {
          keeps[k] = false;
        } else {
          keeps[i] = true;
        }
        changed = true;
      }
    }
  }
  SmallVector<std::pair<Value, Value>> copies;
  for (auto [i, keep] : llvm::enumerate(keeps)) {
    if (!keep)
      continue;
    b.setInsertionPoint(op);
    Value kept = create(carried[i].getType());
    memref::CopyOp::create(b, inits[i].get(), kept);
    inits[i].set(kept);
    Value from = yielded[i].get();
    if (moves) {
      Value between = create(carried[i].getType());
      b.setInsertionPoint(yielded[i].getOwner());
      memref::CopyOp::create(b, from, between);
      from = between;
    }
    copies.emplace_back(from, kept);
    yielded[i].set(kept);
    replace(carried[i], kept);
    if (i < results.size())
      replace(results[i], kept);
  }
  if (copies.empty())
    return;
  b.setInsertionPoint(yielded.front().getOwner());
  for (auto &[from, to] : copies)
    memref::CopyOp::create(b, from, to);
}

/// For values that leave regions: one of `yielded` for each region, and for
/// each value the names that it has afterwards.
void Keeper::keepResults(ArrayRef<MutableArrayRef<OpOperand>> yielded,
                         ArrayRef<SmallVector<Value>> results) {
  for (auto [i, names] : llvm::enumerate(results)) {
    if (llvm::none_of(yielded, [&, i = i](MutableArrayRef<OpOperand> values) {
          return isMadeIn(op, values[i].get());
        }))
      continue;
    auto type = dyn_cast<MemRefType>(names.front().getType());
    if (!type || !type.hasStaticShape() || !mayKeep(names))
      continue;
    b.setInsertionPoint(op);
    Value kept = create(type);
    for (MutableArrayRef<OpOperand> values : yielded) {
      b.setInsertionPoint(values[i].getOwner());
      memref::CopyOp::create(b, values[i].get(), kept);
      values[i].set(kept);
    }
    for (Value name : names)
      replace(name, kept);
  }
}

void Keeper::run() {
  if (auto loop = dyn_cast<scf::ForOp>(op)) {
    keepLoop(
        loop.getInitArgsMutable(), SmallVector<Value>(loop.getRegionIterArgs()),
        *loop.getYieldedValuesMutable(), SmallVector<Value>(loop.getResults()));
  } else if (auto loop = dyn_cast<scf::WhileOp>(op)) {
    keepLoop(loop.getInitsMutable(),
             SmallVector<Value>(loop.getBeforeArguments()),
             loop.getYieldOp().getResultsMutable(), {});
    SmallVector<SmallVector<Value>> names;
    for (auto [inner, result] :
         llvm::zip(loop.getAfterArguments(), loop.getResults()))
      names.push_back({inner, result});
    keepResults({loop.getConditionOp().getArgsMutable()}, names);
  } else if (auto branch = dyn_cast<scf::IfOp>(op)) {
    if (branch.getNumResults() == 0)
      return;
    SmallVector<SmallVector<Value>> names;
    for (Value result : branch.getResults())
      names.push_back({result});
    keepResults({branch.thenYield().getResultsMutable(),
                 branch.elseYield().getResultsMutable()},
                names);
  }
}

void mlir::tai::keepMadeArrays(func::FuncOp function, bool areTensors) {
  SmallVector<Operation *> ops;
  function.walk([&](Operation *op) {
    if (isa<scf::ForOp, scf::WhileOp, scf::IfOp>(op))
      ops.push_back(op);
  });
  for (Operation *op : ops)
    Keeper(op, areTensors).run();
}
