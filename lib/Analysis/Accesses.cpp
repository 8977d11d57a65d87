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

Operation *mlir::tai::getOutermostParallelLoop(Operation *op) {
  Operation *outermost = nullptr;
  while ((op = getEnclosingParallelLoop(op)))
    outermost = op;
  return outermost;
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
  // Loop indices and arguments are listed in a fixed order, because the terms
  // of an IndexExpr are sorted by pointers.
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
    // A sum of two numbers may wrap: if it does not fit 32 bits, it is no valid
    // index of a field.
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
    // Only one field of a tree has a given place, so tree and place identify
    // the storage.
    if (FieldOp field = lookupField(op, name))
      return getFieldStorageKey(field);
    return name.getAsOpaquePointer();
  }
  if (auto access = dyn_cast<DifferentiableAccessInterface>(op))
    return access.getAccessedStorage().getOpaque();
  return nullptr;
}

static SmallVector<IndexExpr> getIndices(Operation *access) {
  if (auto field = dyn_cast<FieldAccessOpInterface>(access))
    return getIndexExprs(field.getIndices());
  return getIndexExprs(
      cast<DifferentiableAccessInterface>(access).getAccessIndices());
}

/// Returns the induction variables of the parallel loops around `op`, the
/// outermost first, without those of loops that run on one thread.
static SmallVector<Value> getConcurrentInductionVars(Operation *op) {
  SmallVector<Value> ivs;
  while ((op = getEnclosingParallelLoop(op))) {
    auto loop = dyn_cast<ParallelForOp>(op);
    ValueRange own = getParallelInductionVars(op);
    if (!loop || !loop.getSerialize())
      ivs.insert(ivs.begin(), own.begin(), own.end());
  }
  return ivs;
}

// The index expressions that are the same in all accesses must differ between
// any two iterations.
bool mlir::tai::isExclusive(ArrayRef<Operation *> accesses) {
  auto all = llvm::map_to_vector(accesses, getIndices);
  SmallVector<IndexExpr> common;
  for (auto [i, index] : llvm::enumerate(all.front()))
    if (llvm::all_of(all, [&, i = i, &index = index](auto &indices) {
          return indices[i] == index;
        }))
      common.push_back(index);
  // Most accesses are in the same loop, so the answer is computed once for each
  // loop.
  llvm::SmallDenseMap<Operation *, bool> byLoop;
  return llvm::all_of(accesses, [&](Operation *access) {
    auto [it, isNew] =
        byLoop.try_emplace(getEnclosingParallelLoop(access), false);
    if (isNew)
      it->second = isInjectiveOver(common, getConcurrentInductionVars(access));
    return it->second;
  });
}

void mlir::tai::markExclusiveAtomics(FunctionOpInterface function) {
  llvm::MapVector<std::pair<Operation *, const void *>,
                  SmallVector<Operation *>>
      groups;
  function.walk([&](Operation *op) {
    if (isa<AtomicOp, StoreOp>(op))
      groups[{getOutermostParallelLoop(op), getStorageKey(op)}].push_back(op);
  });
  for (auto &[key, writes] : groups) {
    bool exclusive = isExclusive(writes);
    for (Operation *write : writes)
      if (auto atomic = dyn_cast<AtomicOp>(write))
        atomic.setExclusive(exclusive);
  }
}
