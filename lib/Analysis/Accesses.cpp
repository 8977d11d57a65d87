//===- Accesses.cpp - Elements that a kernel touches ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Accesses.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/AffineExpr.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/ADT/MapVector.h"

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Equality
//===----------------------------------------------------------------------===//

bool mlir::tai::areProvablyEqual(ValueRange lhs, ValueRange rhs) {
  return lhs.size() == rhs.size() &&
         llvm::all_of(llvm::zip(lhs, rhs), [](auto pair) {
           auto [a, b] = pair;
           return a == b || getIndexExpr(a) == getIndexExpr(b);
         });
}

bool mlir::tai::areProvablyDistinct(ValueRange lhs, ValueRange rhs) {
  return lhs.size() == rhs.size() &&
         llvm::any_of(llvm::zip(lhs, rhs), [](auto pair) {
           auto [a, b] = pair;
           return areDistinct(getIndexExpr(a), getIndexExpr(b));
         });
}

//===----------------------------------------------------------------------===//
// Loops
//===----------------------------------------------------------------------===//

ValueRange mlir::tai::getParallelInductionVars(Operation *op) {
  if (auto loop = dyn_cast<ParallelForOp>(op))
    return loop.getInductionVars();
  if (auto loop = dyn_cast<scf::ParallelOp>(op))
    return loop.getBody()->getArguments();
  return {};
}

Operation *mlir::tai::getEnclosingParallelLoop(Operation *op) {
  for (Operation *parent = op->getParentOp();
       parent && !isa<FunctionOpInterface>(parent);
       parent = parent->getParentOp())
    if (isa<ParallelForOp, scf::ParallelOp>(parent))
      return parent;
  return nullptr;
}

SmallVector<Value> mlir::tai::getEnclosingInductionVars(Operation *op) {
  SmallVector<SmallVector<Value>> levels;
  for (Operation *parent = op->getParentOp();
       parent && !isa<FunctionOpInterface>(parent);
       parent = parent->getParentOp()) {
    auto loop = dyn_cast<LoopLikeOpInterface>(parent);
    if (!loop)
      continue;
    if (std::optional<SmallVector<Value>> ivs = loop.getLoopInductionVars())
      levels.push_back(*ivs);
  }
  SmallVector<Value> all;
  for (auto &level : llvm::reverse(levels))
    llvm::append_range(all, level);
  return all;
}

Operation *mlir::tai::getLoopOf(Value iv) {
  auto argument = dyn_cast<BlockArgument>(iv);
  return argument ? argument.getOwner()->getParentOp() : nullptr;
}

AffineMap mlir::tai::getAffineMap(Operation *access, ValueRange indices) {
  auto function = access->getParentOfType<FunctionOpInterface>();
  if (!function || function.isExternal())
    return {};
  MLIRContext *context = access->getContext();
  // In a fixed order: terms are sorted by address.
  SmallVector<std::pair<Value, AffineExpr>> exprs;
  SmallVector<Value> dims = getEnclosingInductionVars(access);
  for (auto [i, iv] : llvm::enumerate(dims))
    exprs.emplace_back(iv, getAffineDimExpr(i, context));
  unsigned symbols = 0;
  for (BlockArgument argument : function.getArguments())
    if (argument.getType().isIntOrIndex())
      exprs.emplace_back(argument, getAffineSymbolExpr(symbols++, context));
  SmallVector<AffineExpr> results;
  for (Value index : indices) {
    IndexExpr form = getIndexExpr(index);
    AffineExpr expr = getAffineConstantExpr(0, context);
    size_t used = 0;
    for (auto [value, unit] : exprs)
      if (int64_t coefficient = form.getCoefficient(value)) {
        expr = expr + unit * coefficient;
        ++used;
      }
    // Two numbers whose sum leaves 32 bits are no indices of a field.
    bool isSum = form.width >= 32 && llvm::all_of(form.terms, [](auto &term) {
                   return std::abs(term.second) == 1;
                 });
    if (used != form.terms.size() || !(form.isExact() || isSum))
      return {};
    results.push_back(expr + form.constant);
  }
  return AffineMap::get(dims.size(), symbols, results, context);
}

//===----------------------------------------------------------------------===//
// Exclusive accumulation
//===----------------------------------------------------------------------===//

const void *mlir::tai::getFieldStorageKey(FieldOp field) {
  return ArrayAttr::get(field.getContext(),
                        {field.getTreeAttr(), field.getPlaceAttr()})
      .getAsOpaquePointer();
}

const void *mlir::tai::getStorageKey(Operation *op) {
  if (auto access = dyn_cast<FieldAccessOpInterface>(op)) {
    FlatSymbolRefAttr name = access.getFieldAttr();
    // A place is named once in its tree, so tree and place name the storage.
    if (FieldOp field = lookupField(op, name))
      return getFieldStorageKey(field);
    return name.getAsOpaquePointer();
  }
  if (auto access = dyn_cast<DifferentiableAccessInterface>(op))
    return access.getAccessedStorage().getOpaque();
  return nullptr;
}

// The positions in which all writes agree must tell iterations apart.
bool mlir::tai::isExclusive(Operation *loop,
                            ArrayRef<SmallVector<IndexExpr>> writes) {
  SmallVector<IndexExpr> common;
  for (auto [i, first] : llvm::enumerate(writes.front())) {
    size_t position = i;
    const IndexExpr &index = first;
    if (llvm::all_of(writes,
                     [&](auto &indices) { return indices[position] == index; }))
      common.push_back(index);
  }
  return isInjectiveOver(common, getParallelInductionVars(loop));
}

namespace {
/// All writes to one storage inside one parallel loop.
struct Writes {
  SmallVector<AtomicOp> atomics;
  SmallVector<SmallVector<IndexExpr>> indices;
};
} // namespace

void mlir::tai::markExclusiveAtomics(FunctionOpInterface function) {
  llvm::MapVector<std::pair<Operation *, const void *>, Writes> groups;
  function.walk([&](Operation *op) {
    if (!isa<AtomicOp, StoreOp>(op))
      return;
    Operation *loop = getEnclosingParallelLoop(op);
    Writes &writes = groups[{loop, getStorageKey(op)}];
    if (auto atomic = dyn_cast<AtomicOp>(op)) {
      writes.atomics.push_back(atomic);
      writes.indices.push_back(getIndexExprs(atomic.getIndices()));
    } else {
      writes.indices.push_back(getIndexExprs(cast<StoreOp>(op).getIndices()));
    }
  });
  for (auto &[key, writes] : groups) {
    Operation *loop = key.first;
    // Outside of parallel loops, and in one that runs on one thread, there are
    // no other threads.
    auto parallel = dyn_cast_if_present<ParallelForOp>(loop);
    bool exclusive = !loop || (parallel && parallel.getSerialize());
    if (!exclusive)
      exclusive = isExclusive(loop, writes.indices);
    for (AtomicOp atomic : writes.atomics)
      atomic.setExclusive(exclusive);
  }
}
