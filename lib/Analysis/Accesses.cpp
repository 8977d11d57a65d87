//===- Accesses.cpp - Elements that a kernel touches ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Accesses.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
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
// Linear forms
//===----------------------------------------------------------------------===//

int64_t LinearIndex::getCoefficient(Value value) const {
  for (auto [term, coefficient] : terms)
    if (term == value)
      return coefficient;
  return 0;
}

static void addScaled(LinearIndex &sum, const LinearIndex &other,
                      int64_t scale) {
  sum.constant += scale * other.constant;
  sum.mayWrap |= other.mayWrap;
  for (const auto &added : other.terms) {
    auto *it = llvm::find_if(
        sum.terms, [&](auto &term) { return term.first == added.first; });
    if (it == sum.terms.end())
      sum.terms.emplace_back(added.first, scale * added.second);
    else
      it->second += scale * added.second;
  }
}

/// True for integers of 8 or 16 bits: unlike in 32 bits, a result is likely to
/// wrap around, and then is no sum of its operands.
static bool isNarrow(Value value) {
  auto type = dyn_cast<IntegerType>(value.getType());
  return type && type.getWidth() < 32;
}

static LinearIndex getSum(Value value, unsigned depth) {
  LinearIndex sum;
  auto addTerm = [&](Value term) { sum.terms.emplace_back(term, 1); };
  APInt constant;
  if (matchPattern(value, m_ConstantInt(&constant))) {
    if (constant.getSignificantBits() <= 64)
      sum.constant = constant.getSExtValue();
    else
      addTerm(value);
    return sum;
  }
  Operation *op = value.getDefiningOp();
  if (!op || depth == 0 || (isNarrow(value) && !isa<arith::ExtSIOp>(op))) {
    addTerm(value);
    return sum;
  }
  auto combine = [&](Value lhs, Value rhs, int64_t sign) {
    addScaled(sum, getSum(lhs, depth - 1), 1);
    addScaled(sum, getSum(rhs, depth - 1), sign);
  };
  if (auto add = dyn_cast<arith::AddIOp>(op)) {
    combine(add.getLhs(), add.getRhs(), 1);
  } else if (auto sub = dyn_cast<arith::SubIOp>(op)) {
    combine(sub.getLhs(), sub.getRhs(), -1);
  } else if (auto cast = dyn_cast<arith::IndexCastOp>(op)) {
    addScaled(sum, getSum(cast.getIn(), depth - 1), 1);
  } else if (auto extend = dyn_cast<arith::ExtSIOp>(op)) {
    addScaled(sum, getSum(extend.getIn(), depth - 1), 1);
  } else if (auto mul = dyn_cast<arith::MulIOp>(op)) {
    LinearIndex lhs = getSum(mul.getLhs(), depth - 1);
    LinearIndex rhs = getSum(mul.getRhs(), depth - 1);
    if (!lhs.terms.empty() && !rhs.terms.empty()) {
      addTerm(value);
      return sum;
    }
    const LinearIndex &form = lhs.terms.empty() ? rhs : lhs;
    int64_t factor = lhs.terms.empty() ? lhs.constant : rhs.constant;
    addScaled(sum, form, factor);
    sum.mayWrap |= std::abs(factor) > 1 && !value.getType().isIndex() &&
                   !value.getType().isInteger(64);
  } else {
    addTerm(value);
  }
  return sum;
}

LinearIndex mlir::tai::getLinearIndex(Value value) {
  // Deep chains are unrolled sums; a form of more terms is of no use.
  LinearIndex sum = getSum(value, /*depth=*/16);
  llvm::erase_if(sum.terms, [](auto &term) { return term.second == 0; });
  llvm::sort(sum.terms, [](auto &lhs, auto &rhs) {
    return lhs.first.getAsOpaquePointer() < rhs.first.getAsOpaquePointer();
  });
  return sum;
}

SmallVector<LinearIndex> mlir::tai::getLinearIndices(ValueRange values) {
  return llvm::map_to_vector(values, getLinearIndex);
}

bool mlir::tai::areProvablyEqual(ValueRange lhs, ValueRange rhs) {
  return lhs.size() == rhs.size() &&
         llvm::all_of(llvm::zip(lhs, rhs), [](auto pair) {
           auto [a, b] = pair;
           return a == b || getLinearIndex(a) == getLinearIndex(b);
         });
}

bool mlir::tai::areProvablyDistinct(ValueRange lhs, ValueRange rhs) {
  return lhs.size() == rhs.size() &&
         llvm::any_of(llvm::zip(lhs, rhs), [](auto pair) {
           auto [a, b] = pair;
           LinearIndex x = getLinearIndex(a), y = getLinearIndex(b);
           return x.terms == y.terms && x.constant != y.constant;
         });
}

// Solves for one induction variable at a time: an index in which only one of
// them is still unknown determines it.
bool mlir::tai::isInjectiveOver(ArrayRef<LinearIndex> indices, ValueRange ivs) {
  SmallVector<Value> unknown(ivs);
  bool changed = true;
  while (changed && !unknown.empty()) {
    changed = false;
    for (const LinearIndex &index : indices) {
      if (index.mayWrap)
        continue;
      Value only;
      unsigned count = 0;
      for (Value iv : unknown)
        if (index.getCoefficient(iv) != 0) {
          only = iv;
          ++count;
        }
      // Other terms must be the same in all iterations.
      bool isOpaque = llvm::any_of(index.terms, [&](auto &term) {
        Value value = term.first;
        if (llvm::is_contained(ivs, value))
          return false;
        Operation *loop = getLoopOf(ivs.front());
        return loop && loop->isAncestor(value.getParentBlock()->getParentOp());
      });
      if (count != 1 || isOpaque)
        continue;
      llvm::erase(unknown, only);
      changed = true;
    }
  }
  return unknown.empty();
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
    LinearIndex form = getLinearIndex(index);
    AffineExpr expr = getAffineConstantExpr(0, context);
    size_t used = 0;
    for (auto [value, unit] : exprs)
      if (int64_t coefficient = form.getCoefficient(value)) {
        expr = expr + unit * coefficient;
        ++used;
      }
    if (used != form.terms.size() || form.mayWrap)
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
                            ArrayRef<SmallVector<LinearIndex>> writes) {
  SmallVector<LinearIndex> common;
  for (auto [i, first] : llvm::enumerate(writes.front())) {
    size_t position = i;
    const LinearIndex &index = first;
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
  SmallVector<SmallVector<LinearIndex>> indices;
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
      writes.indices.push_back(getLinearIndices(atomic.getIndices()));
    } else {
      writes.indices.push_back(
          getLinearIndices(cast<StoreOp>(op).getIndices()));
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
