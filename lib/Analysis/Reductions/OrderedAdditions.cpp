//===- OrderedAdditions.cpp - Deterministic additions by a warp -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Reductions/OrderedAdditions.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Index/IndexQueries.h"
#include "tai/Analysis/Reductions/Accumulation.h"

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Control flow
//===----------------------------------------------------------------------===//

/// True if all iterations that execute the same point of the body compute the
/// same value.
static bool isUniform(ParallelForOp loop, Value value, unsigned depth = 16) {
  if (loop.isDefinedOutsideOfLoop(value))
    return true;
  if (depth == 0)
    return false;
  auto isSame = [&](Value operand) {
    return isUniform(loop, operand, depth - 1);
  };
  if (auto argument = dyn_cast<BlockArgument>(value)) {
    auto serial = dyn_cast<scf::ForOp>(argument.getOwner()->getParentOp());
    return serial && argument == serial.getInductionVar() &&
           isSame(serial.getLowerBound()) && isSame(serial.getUpperBound()) &&
           isSame(serial.getStep());
  }
  Operation *op = value.getDefiningOp();
  return op->getNumRegions() == 0 && isMemoryEffectFree(op) &&
         llvm::all_of(op->getOperands(), isSame);
}

Operation *tai::findDivergence(ParallelForOp loop, OpPredicate isAddition) {
  Operation *found = nullptr;
  loop.getBody().walk([&](Operation *op) {
    if (!isAddition(op))
      return WalkResult::advance();
    bool isRepeated = false;
    for (Operation *at = op->getParentOp(); at != loop;
         at = at->getParentOp()) {
      bool isTogether = false;
      if (auto branch = dyn_cast<scf::IfOp>(at)) {
        // The addition can be moved out of the branch, unless it is in a loop
        // within the branch: then the condition must be the same in all
        // iterations.
        isTogether = !isRepeated || isUniform(loop, branch.getCondition());
      } else if (auto serial = dyn_cast<scf::ForOp>(at)) {
        isTogether = isUniform(loop, serial.getLowerBound()) &&
                     isUniform(loop, serial.getUpperBound()) &&
                     isUniform(loop, serial.getStep());
        isRepeated = true;
      }
      if (!isTogether) {
        found = at;
        return WalkResult::interrupt();
      }
    }
    return WalkResult::advance();
  });
  return found;
}

//===----------------------------------------------------------------------===//
// Memory
//===----------------------------------------------------------------------===//

namespace {
/// The accesses of a loop to one field or array, sorted by kind.
struct PlaceAccesses {
  struct Access {
    Operation *op;
    SmallVector<Value> indices;
    bool isSparse;
  };
  /// updates: atomic updates whose result is unused. writes: plain stores.
  SmallVector<Access> updates, writes, reads;
};

class Checker {
public:
  Checker(ParallelForOp loop, FieldTable &fields, const ReductionPlan &plan)
      : loop(loop), fields(fields), plan(plan) {}
  bool run();
  bool runInAnyOrder(SmallVectorImpl<AtomicOp> &found);
  bool haveElementsOfTheirOwn();

private:
  bool visit(Operation *op);
  bool visitField(FieldAccessOpInterface op);
  bool visitArray(Operation *op);
  bool mayReach(ValueRange a, ValueRange b);
  bool isFree(const PlaceAccesses &place);
  bool areFree();
  bool readsComeFirst(const PlaceAccesses &place);

  ParallelForOp loop;
  FieldTable &fields;
  const ReductionPlan &plan;
  /// True for the analysis of canAddInAnyOrder: iterations may then also
  /// allocate memory and add 16-bit floats.
  bool inAnyOrder = false;
  llvm::MapVector<const void *, PlaceAccesses> places;
  llvm::DenseSet<Operation *> additions;
};
} // namespace

static bool isOrderable(Type type) { return type.isF32() || type.isF64(); }

bool Checker::visitField(FieldAccessOpInterface op) {
  FailureOr<const FieldInfo *> field = fields.lookup(op, op.getFieldAttr());
  if (failed(field))
    return false;
  PlaceAccesses &place = places[(*field)->scope.getAsOpaquePointer()];
  bool isSparse = !(*field)->sparse.empty() && !op->hasAttr(kActiveAttrName);
  auto add = [&](SmallVector<PlaceAccesses::Access> &list, ValueRange indices) {
    list.push_back({op, llvm::to_vector(indices), isSparse});
    return true;
  };
  if (!op.writesField())
    return add(place.reads, op.getIndices());
  if (!op.readsField())
    return add(place.writes, op.getIndices());
  auto atomic = dyn_cast<AtomicOp>(op.getOperation());
  if (!atomic)
    return false;
  if (plan.isExclusive(op))
    return add(place.writes, atomic.getIndices());
  if (!atomic.getOld().use_empty())
    return false;
  // A sum over all iterations is kept in a register, and written to memory only
  // after the loop: it meets no access in the loop.
  if (plan.isDoneByLoop(op))
    return true;
  Type type = atomic.getValue().getType();
  AtomicKind kind = atomic.getKind();
  if (isa<FloatType>(getElementTypeOrSelf(type)) && kind != AtomicKind::Min &&
      kind != AtomicKind::Max) {
    bool isKnown =
        isOrderable(type) || (inAnyOrder && (type.isF16() || type.isBF16()));
    if (!isKnown || (kind != AtomicKind::Add && kind != AtomicKind::Sub))
      return false;
    additions.insert(op);
  }
  return add(place.updates, atomic.getIndices());
}

bool Checker::visitArray(Operation *op) {
  auto load = dyn_cast<memref::LoadOp>(op);
  auto store = dyn_cast<memref::StoreOp>(op);
  auto atomic = dyn_cast<memref::AtomicRMWOp>(op);
  Value array = load    ? load.getMemRef()
                : store ? store.getMemRef()
                        : atomic.getMemref();
  // An array that is allocated in the loop belongs to one iteration.
  if (!loop.isDefinedOutsideOfLoop(array))
    return true;
  PlaceAccesses &place = places[array.getAsOpaquePointer()];
  auto add = [&](SmallVector<PlaceAccesses::Access> &list, ValueRange indices) {
    list.push_back({op, llvm::to_vector(indices), false});
    return true;
  };
  if (load)
    return add(place.reads, load.getIndices());
  if (store)
    return add(place.writes, store.getIndices());
  if (!atomic.getResult().use_empty())
    return false;
  if (plan.isDoneByLoop(op))
    return true;
  Type type = atomic.getValue().getType();
  bool isExtreme = atomic.getKind() == arith::AtomicRMWKind::minimumf ||
                   atomic.getKind() == arith::AtomicRMWKind::maximumf;
  if (isa<FloatType>(type) && !isExtreme) {
    if (!isOrderable(type) || atomic.getKind() != arith::AtomicRMWKind::addf)
      return false;
    additions.insert(op);
  }
  return add(place.updates, atomic.getIndices());
}

/// Checks an operation of the loop. Returns false for operations that are
/// unknown or may affect other iterations.
bool Checker::visit(Operation *op) {
  if (auto access = dyn_cast<FieldAccessOpInterface>(op);
      access && access.isElementAccess())
    return visitField(access);
  if (isa<memref::LoadOp, memref::StoreOp, memref::AtomicRMWOp>(op))
    return visitArray(op);
  // These ops access memory of one iteration, or lists of active cells, which
  // no op in the loop changes.
  if (isa<memref::AllocaOp, AllocaOp, LocalLoadOp, LocalStoreOp, LLVM::LoadOp>(
          op))
    return true;
  if (isa<scf::IfOp, scf::ForOp, scf::WhileOp, scf::IndexSwitchOp>(op))
    return true;
  if (isa<scf::YieldOp, scf::ConditionOp, YieldOp>(op))
    return true;
  if (isa<StackCreateOp>(op))
    return inAnyOrder;
  if (isa<StackPushOp, StackPopOp, StackDestroyOp>(op))
    return inAnyOrder && llvm::none_of(op->getOperands(), [&](Value operand) {
             return isa<StackType>(operand.getType()) &&
                    loop.isDefinedOutsideOfLoop(operand);
           });
  return op->getNumRegions() == 0 && isMemoryEffectFree(op);
}

/// True unless `a` and `b` differ at a position where both have an index from
/// outside of the loop.
bool Checker::mayReach(ValueRange a, ValueRange b) {
  for (auto [x, y] : llvm::zip_equal(a, b))
    if (loop.isDefinedOutsideOfLoop(x) && loop.isDefinedOutsideOfLoop(y) &&
        areProvablyDistinct(x, y))
      return false;
  return true;
}

/// True if no iteration reads or overwrites elements that another iteration
/// writes.
bool Checker::isFree(const PlaceAccesses &place) {
  using Access = PlaceAccesses::Access;
  auto meets = [&](const Access &a, const Access &b) {
    return mayReach(a.indices, b.indices);
  };
  // If both accesses can reach the same element, each iteration must access
  // only its own elements.
  auto isOwn = [&](const Access &write, const Access &other) {
    return !meets(write, other) ||
           (areProvablyEqual(write.indices, other.indices) &&
            isInjective(loop, write.indices));
  };
  for (const Access &update : place.updates) {
    // An update of a sparse field may have to activate its cell.
    if (update.isSparse)
      return false;
    for (const auto *others : {&place.reads, &place.writes})
      if (llvm::any_of(*others, [&](const Access &other) {
            return meets(update, other);
          }))
        return false;
  }
  return llvm::all_of(place.writes, [&](const Access &write) {
    if (write.isSparse || !isInjective(loop, write.indices))
      return false;
    auto isOwnWith = [&](const Access &other) { return isOwn(write, other); };
    return llvm::all_of(place.writes, isOwnWith) &&
           llvm::all_of(place.reads, isOwnWith);
  });
}

bool Checker::areFree() {
  if (loop->getParentOfType<ParallelForOp>() || loop.isStructFor())
    return false;
  WalkResult result = loop.getBody().walk([&](Operation *op) {
    return visit(op) ? WalkResult::advance() : WalkResult::interrupt();
  });
  return !result.wasInterrupted() && llvm::all_of(places, [&](auto &entry) {
    return isFree(entry.second);
  });
}

bool Checker::run() {
  return areFree() && !findDivergence(loop, [&](Operation *op) {
           return additions.contains(op);
         });
}

bool tai::canOrderAdditions(ParallelForOp loop, FieldTable &fields,
                            const ReductionPlan &plan) {
  return Checker(loop, fields, plan).run();
}

/// True if no iteration reads elements of the field or array `place` after it
/// has written some of them.
bool Checker::readsComeFirst(const PlaceAccesses &place) {
  return llvm::all_of(place.writes, [&](const auto &write) {
    return llvm::all_of(place.reads, [&](const auto &read) {
      // A write and a read in the same inner loop count as a read after the
      // write: the next turn of that loop could read the written element.
      for (Operation *at = write.op->getParentOp(); at != loop;
           at = at->getParentOp())
        if (!isa<scf::IfOp>(at) && at->isProperAncestor(read.op))
          return false;
      Operation *before = read.op, *after = write.op;
      Block *common = before->getBlock();
      while (common && !common->findAncestorOpInBlock(*after))
        common = common->getParentOp()->getBlock();
      if (!common)
        return false;
      before = common->findAncestorOpInBlock(*before);
      after = common->findAncestorOpInBlock(*after);
      // Accesses in different branches of an `if` count as if each could come
      // before the other.
      return before != after && before->isBeforeInBlock(after);
    });
  });
}

bool Checker::runInAnyOrder(SmallVectorImpl<AtomicOp> &found) {
  inAnyOrder = true;
  if (!areFree())
    return false;
  WalkResult result = loop.getBody().walk([&](Operation *op) {
    // Sums in fixed point run the iterations three times. A local variable that
    // outlives the iteration would then be written three times, so stores to
    // such variables are refused.
    Value local;
    if (auto store = dyn_cast<LocalStoreOp>(op))
      local = store.getLocal();
    auto update = dyn_cast<AtomicOp>(op);
    bool usesOld = update && !update.getOld().use_empty();
    // Updates without an atomic instruction would become loops.
    bool isLoop = update && !plan.isExclusive(op) && !plan.isDoneByLoop(op) &&
                  (update.getKind() == AtomicKind::Mul ||
                   update.getValue().getType().isInteger(1));
    return usesOld || isLoop || (local && loop.isDefinedOutsideOfLoop(local))
               ? WalkResult::interrupt()
               : WalkResult::advance();
  });
  if (result.wasInterrupted())
    return false;
  for (const auto &[key, place] : places) {
    if (!readsComeFirst(place))
      return false;
    for (const PlaceAccesses::Access &update : place.updates)
      if (additions.contains(update.op)) {
        auto atomic = dyn_cast<AtomicOp>(update.op);
        if (!atomic)
          return false;
        found.push_back(atomic);
      }
  }
  return true;
}

bool tai::canAddInAnyOrder(ParallelForOp loop, FieldTable &fields,
                           const ReductionPlan &plan,
                           SmallVectorImpl<AtomicOp> &additions) {
  return Checker(loop, fields, plan).runInAnyOrder(additions);
}

/// The constant component indices that an atomic update has, if any.
static ValueRange getComponentsOf(Operation *op) {
  auto atomic = dyn_cast<AtomicOp>(op);
  return atomic ? ValueRange(atomic.getComponents()) : ValueRange();
}

/// True if no two additions can reach the same element, and an iteration
/// executes each at most once.
bool Checker::haveElementsOfTheirOwn() {
  using Access = PlaceAccesses::Access;
  auto areApart = [&](const Access &a, const Access &b) {
    if (!mayReach(a.indices, b.indices))
      return true;
    ValueRange x = getComponentsOf(a.op), y = getComponentsOf(b.op);
    return x.size() == y.size() &&
           llvm::any_of(llvm::zip_equal(x, y), [](auto pair) {
             auto one = getConstantIntValue(std::get<0>(pair));
             auto other = getConstantIntValue(std::get<1>(pair));
             return one && other && *one != *other;
           });
  };
  for (const auto &[key, place] : places)
    for (auto [i, update] : llvm::enumerate(place.updates)) {
      if (!additions.contains(update.op))
        continue;
      for (Operation *at = update.op->getParentOp(); at != loop;
           at = at->getParentOp())
        if (!isa<scf::IfOp>(at))
          return false;
      for (const Access &other : ArrayRef(place.updates).drop_front(i + 1))
        if (additions.contains(other.op) && !areApart(update, other))
          return false;
    }
  return true;
}

bool tai::canQueueAdditions(ParallelForOp loop, FieldTable &fields,
                            const ReductionPlan &plan) {
  Checker checker(loop, fields, plan);
  return checker.run() && checker.haveElementsOfTheirOwn();
}

/// Updates of a field at more places than these are not compared in pairs.
static constexpr size_t kMostPlaces = 8;

bool tai::haveOwnElements(ParallelForOp loop, ArrayRef<AtomicOp> atomics) {
  SmallVector<ValueRange> places;
  for (AtomicOp atomic : atomics) {
    ValueRange indices = atomic.getIndices();
    if (llvm::none_of(places, [&](ValueRange place) {
          return llvm::equal(place, indices);
        }))
      places.push_back(indices);
    if (places.size() > kMostPlaces)
      return false;
  }
  for (auto [i, a] : llvm::enumerate(places)) {
    if (!isInjective(loop, a))
      return false;
    for (ValueRange b : ArrayRef(places).take_front(i))
      if (llvm::none_of(llvm::zip_equal(a, b), [&](auto pair) {
            return areDistinctOver(getIndexExpr(std::get<0>(pair)),
                                   getIndexExpr(std::get<1>(pair)), loop);
          }))
        return false;
  }
  return true;
}
