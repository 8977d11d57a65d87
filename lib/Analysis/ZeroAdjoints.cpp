//===- ZeroAdjoints.cpp - Zero-adjoint skipping ---------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Finds loops whose iterations can be skipped if their incoming adjoints are
// zero. Every contribution of most adjoint loops is a product with an adjoint
// of the iteration's own cell. This analysis finds, for each loop, the fields
// that must be zero for an iteration to have no effect: the greatest fixed
// point of "this value is zero then", by the effect of each op on zeros.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/ZeroAdjoints.h"
#include "SparseLoops.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/Matchers.h"
#include "tai/Analysis/Reductions/ReductionPlan.h"
#include "llvm/ADT/SetVector.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// Analyses one loop of an adjoint over a sparse field: which fields must be
/// zero in a cell so that its iteration can be skipped.
class LoopAnalysis {
public:
  LoopAnalysis(ParallelForOp loop, FieldLayout layout)
      : loop(loop), layout(std::move(layout)) {}

  /// Collects `sources`. False if an iteration has an effect even where all
  /// sources are zero.
  bool run();

  SetVector<StringAttr> sources;
  bool sumsUp = false;

private:
  bool isOwn(Operation *op, FlatSymbolRefAttr name, ValueRange indices) const;
  bool staysZero(Value value) const;
  bool staysZeroResult(Operation *op, unsigned number) const;
  bool areZero(ValueRange values) const {
    return llvm::all_of(values, [&](Value v) { return zeros.contains(v); });
  }
  bool isHarmless(Operation *op);

  ParallelForOp loop;
  FieldLayout layout;
  DenseSet<Value> zeros;
};
} // namespace

static bool isFloat(Type type) {
  return isa<FloatType>(getElementTypeOrSelf(type));
}

/// True if an access to the field `name` at `indices` reaches the cell that the
/// iteration visits.
static bool isOwnAccess(ParallelForOp loop, const FieldLayout &layout,
                        Operation *op, FlatSymbolRefAttr name,
                        ValueRange indices) {
  FieldLayout other = *getFieldLayout(lookupField(op, name));
  return other.tree == layout.tree && other.path.getFirstSparse() &&
         other.axisOfIndex == layout.axisOfIndex &&
         other.offset == layout.offset &&
         llvm::equal(indices, loop.getInductionVars());
}

bool LoopAnalysis::isOwn(Operation *op, FlatSymbolRefAttr name,
                         ValueRange indices) const {
  return isOwnAccess(loop, layout, op, name, indices);
}

bool mlir::tai::isZeroOfZeros(OpResult result,
                              llvm::function_ref<bool(Value)> isZero) {
  Attribute constant;
  if (matchPattern(Value(result), m_Constant(&constant)))
    return matchPattern(Value(result), m_AnyZeroFloat());
  return llvm::TypeSwitch<Operation *, bool>(result.getOwner())
      .Case<arith::MulFOp, MatmulOp, DotOp, CrossOp, OuterOp>(
          [&](Operation *product) {
            return llvm::any_of(product->getOperands(), isZero);
          })
      .Case([&](arith::DivFOp quotient) { return isZero(quotient.getLhs()); })
      .Case([&](arith::SelectOp select) {
        return isZero(select.getTrueValue()) && isZero(select.getFalseValue());
      })
      .Case<arith::AddFOp, arith::SubFOp, arith::NegFOp, arith::ExtFOp,
            arith::TruncFOp, TransposeOp, SumOp, TraceOp,
            vector::FromElementsOp, vector::BroadcastOp, vector::ShuffleOp>(
          [&](Operation *linear) {
            return llvm::all_of(linear->getOperands(), isZero);
          })
      .Case([&](vector::ExtractOp extract) {
        return isZero(extract.getSource());
      })
      .Case([&](vector::InsertOp insert) {
        return isZero(insert.getValueToStore()) && isZero(insert.getDest());
      })
      .Default([](Operation *) { return false; });
}

bool LoopAnalysis::staysZeroResult(Operation *op, unsigned number) const {
  return llvm::TypeSwitch<Operation *, bool>(op)
      .Case([&](LoadOp load) {
        return sources.contains(load.getFieldAttr().getAttr()) &&
               isOwn(load, load.getFieldAttr(), load.getIndices());
      })
      .Case([&](scf::IfOp branch) {
        return llvm::all_of(branch->getRegions(), [&](Region &region) {
          return !region.empty() &&
                 zeros.contains(
                     region.front().getTerminator()->getOperand(number));
        });
      })
      .Case([&](scf::ForOp inner) {
        return zeros.contains(inner.getInits()[number]) &&
               zeros.contains(
                   inner.getBody()->getTerminator()->getOperand(number));
      })
      .Default([&](Operation *other) {
        return isZeroOfZeros(other->getResult(number),
                             [&](Value v) { return zeros.contains(v); });
      });
}

bool LoopAnalysis::staysZero(Value value) const {
  if (auto result = dyn_cast<OpResult>(value))
    return staysZeroResult(result.getOwner(), result.getResultNumber());
  auto argument = cast<BlockArgument>(value);
  auto inner = dyn_cast<scf::ForOp>(argument.getOwner()->getParentOp());
  if (!inner || argument.getArgNumber() == 0)
    return false;
  unsigned number = argument.getArgNumber() - 1;
  return zeros.contains(inner.getInits()[number]) &&
         zeros.contains(inner.getBody()->getTerminator()->getOperand(number));
}

/// True if `op` has no effect when all values in `zeros` are zero.
bool LoopAnalysis::isHarmless(Operation *op) {
  if (auto atomic = dyn_cast<AtomicOp>(op)) {
    FieldLayout target =
        *getFieldLayout(lookupField(op, atomic.getFieldAttr()));
    sumsUp |= !target.path.getFirstSparse();
    // No iteration may change a source of another iteration.
    if (sources.contains(atomic.getFieldAttr().getAttr()) &&
        !isOwn(op, atomic.getFieldAttr(), atomic.getIndices()))
      return false;
    return (atomic.getKind() == AtomicKind::Add ||
            atomic.getKind() == AtomicKind::Sub) &&
           atomic.getOld().use_empty() && zeros.contains(atomic.getValue());
  }
  if (auto store = dyn_cast<StoreOp>(op))
    return sources.contains(store.getFieldAttr().getAttr()) &&
           isOwn(op, store.getFieldAttr(), store.getIndices()) &&
           zeros.contains(store.getValue());
  // Memory that belongs to the iteration alone is gone after it, so changes to
  // it do not matter.
  if (isa<StackCreateOp, StackPushOp, StackPopOp, StackDestroyOp, LocalStoreOp>(
          op))
    return llvm::all_of(op->getOperands(), [&](Value operand) {
      return !isa<StackType, LocalType>(operand.getType()) ||
             loop->isAncestor(operand.getParentBlock()->getParentOp());
    });
  return op->getNumRegions() != 0 || isMemoryEffectFree(op) ||
         hasSingleEffect<MemoryEffects::Read>(op) || isa<AllocaOp, YieldOp>(op);
}

bool LoopAnalysis::run() {
  if (loop.getLevel())
    return false;
  // The adjoints that the loop reads or stores in the cell that it visits are
  // the possible sources to start with.
  auto addSource = [&](Operation *op, FlatSymbolRefAttr name,
                       ValueRange indices) {
    if (isOwn(op, name, indices))
      sources.insert(name.getAttr());
  };
  DenseSet<Attribute> adjoints;
  for (FieldOp field : loop->getParentOfType<ModuleOp>().getOps<FieldOp>())
    if (field.getAdjointAttr())
      adjoints.insert(field.getAdjointAttr().getAttr());
  loop.walk([&](Operation *op) {
    if (auto load = dyn_cast<LoadOp>(op)) {
      if (adjoints.contains(load.getFieldAttr().getAttr()))
        addSource(op, load.getFieldAttr(), load.getIndices());
    } else if (auto store = dyn_cast<StoreOp>(op)) {
      if (adjoints.contains(store.getFieldAttr().getAttr()))
        addSource(op, store.getFieldAttr(), store.getIndices());
    }
  });
  auto consider = [&](Value value) {
    if (isFloat(value.getType()))
      zeros.insert(value);
  };
  loop.walk([&](Operation *op) {
    llvm::for_each(op->getResults(), consider);
    for (Region &region : op->getRegions())
      for (Block &block : region)
        llvm::for_each(block.getArguments(), consider);
    // Constants that are zero are not in the loop, so they are collected among
    // the operands.
    for (Value operand : op->getOperands())
      if (matchPattern(operand, m_AnyZeroFloat()))
        zeros.insert(operand);
  });
  for (bool changed = true; changed;) {
    SmallVector<Value> gone;
    for (Value value : zeros)
      if (!staysZero(value))
        gone.push_back(value);
    for (Value value : gone)
      zeros.erase(value);
    changed = !gone.empty();
  }
  WalkResult result = loop.walk([&](Operation *op) {
    return op == loop || isHarmless(op) ? WalkResult::advance()
                                        : WalkResult::interrupt();
  });
  return !result.wasInterrupted() && !sources.empty();
}

std::vector<LoopFlags> mlir::tai::findLoopFlags(KernelOp primal,
                                                KernelOp adjoint) {
  std::vector<LoopFlags> flags;
  adjoint.walk([&](ParallelForOp loop) {
    std::optional<FieldLayout> layout = getSparseLayout(loop);
    if (!layout)
      return;
    LoopAnalysis analysis(loop, *layout);
    bool vanishes = analysis.run();
    LoopFlags entry{loop.getFieldAttr().getValue().str(), {}, analysis.sumsUp};
    // Sums depend on the number of iterations, which splits them: where their
    // bits are fixed, a loop with sums must run for all cells.
    if (vanishes && !(analysis.sumsUp && hasFixedBits(primal)))
      for (StringAttr source : analysis.sources)
        entry.sources.push_back(source.str());
    flags.push_back(std::move(entry));
  });
  // The zeroing form of the adjoint also zeroes adjoints of elements that the
  // primal overwrites. Adjoints in the visited cell become sources of the loop;
  // if there are others, the loop cannot be skipped.
  primal.walk([&](Operation *op) {
    auto loop = op->getParentOfType<ParallelForOp>();
    FlatSymbolRefAttr name = getNamedField(op);
    FieldOp field = name ? lookupField(op, name) : FieldOp();
    bool stores = isa<StoreOp>(op);
    if (auto atomic = dyn_cast<AtomicOp>(op))
      stores = atomic.getKind() != AtomicKind::Add &&
               atomic.getKind() != AtomicKind::Sub;
    if (!loop || !field || !stores || !field.getAdjointAttr())
      return;
    std::optional<FieldLayout> layout = getSparseLayout(loop);
    if (!layout)
      return;
    auto store = dyn_cast<StoreOp>(op);
    bool isOwn = store &&
                 isOwnAccess(loop, *layout, op, name, store.getIndices()) &&
                 isOwnAccess(loop, *layout, op, field.getAdjointAttr(),
                             store.getIndices());
    for (LoopFlags &entry : flags) {
      if (entry.field != loop.getFieldAttr().getValue() ||
          entry.sources.empty())
        continue;
      std::string source = field.getAdjointAttr().getValue().str();
      if (!isOwn)
        entry.sources.clear();
      else if (!llvm::is_contained(entry.sources, source))
        entry.sources.push_back(std::move(source));
    }
  });
  return flags;
}
