//===- ContendedAtomics.cpp - Products and extrema over iterations --------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Several iterations of a parallel loop update one element by atomic products,
// minima or maxima, in any order. The derivative of each contribution is known
// only when all are known: which is the greatest, and how many are equal to it;
// how many factors are zero, and the product of the others.
//
// So the adjoint first re-executes the loop for these values alone. Each is
// computed once and kept, because a recomputed value may differ in its last
// bit, and then none would be equal to the greatest. Small loops then turn the
// values into the adjoints of the contributions, which the reverse of the loop
// uses at the atomic:
//
//   1. values[p] = v; elements[p] = e; total[e] (kind)= v    the loop, forward
//   2. count[e] += 1 where values[p] decides                 over all p
//   3. weight[e], and the adjoint of the old value           over all e
//   4. values[p] = the adjoint of v                          over all p
//
// where p numbers the executions of the atomic, and e elements of the field.
// The element itself is read in the version before the kernel.
//
//===----------------------------------------------------------------------===//

#include "ContendedAtomics.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/IR/Matchers.h"
#include "mlir/IR/PatternMatch.h"
#include "mlir/Transforms/RegionUtils.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Dialect/Tai/IR/Layout.h"

using namespace mlir;
using namespace mlir::tai;

bool mlir::tai::isKnownBefore(Operation *loop, Value value) {
  return !loop->isAncestor(value.getParentBlock()->getParentOp());
}

SmallVector<Value> mlir::tai::getElementPosition(AtomicOp atomic) {
  SmallVector<Value> position(atomic.getIndices());
  llvm::append_range(position, atomic.getComponents());
  return position;
}

//===----------------------------------------------------------------------===//
// Supported updates
//===----------------------------------------------------------------------===//

/// True if the accesses differ in an index of the element or of its component
/// that is the same in all iterations.
static bool areKeptApart(Operation *loop, DifferentiableAccessInterface lhs,
                         DifferentiableAccessInterface rhs) {
  auto isSame = [&](const IndexExpr &index) {
    return index.allOf([&](Value value) { return isKnownBefore(loop, value); });
  };
  auto areApart = [&](ValueRange a, ValueRange b) {
    SmallVector<IndexExpr> first = getIndexExprs(a), second = getIndexExprs(b);
    return first.size() == second.size() &&
           llvm::any_of(llvm::zip(first, second), [&](auto pair) {
             auto &[x, y] = pair;
             return isSame(x) && isSame(y) && areDistinct(x, y);
           });
  };
  return areApart(lhs.getAccessIndices(), rhs.getAccessIndices()) ||
         areApart(lhs.getAccessComponents(), rhs.getAccessComponents());
}

// Refuses accesses that would make the element depend on the order of
// iterations, and accesses that need the element's value between the loops of
// one kernel.
LogicalResult ContendedAtomics::check(FunctionOpInterface kernel,
                                      ParallelForOp loop, AtomicOp atomic) {
  if (!isa<KernelOp>(kernel.getOperation())) {
    b.emitError(atomic, "iterations combine values at the same time, in a "
                        "function that is no kernel")
            .attachNote()
        << "a tape can bring back what stood there before, and nobody else; "
           "make it a kernel";
    return failure();
  }
  if (loop->getParentOp() != kernel) {
    b.emitError(atomic, "iterations combine values at the same time, in a loop "
                        "that itself may run several times")
            .attachNote()
        << "give the parallel loop a kernel of its own";
    return failure();
  }
  Block &body = kernel.getFunctionBody().front();
  const void *key = getStorageKey(atomic);
  WalkResult result = kernel.walk([&](DifferentiableAccessInterface other) {
    if (getStorageKey(other) != key)
      return WalkResult::advance();
    bool isInside = loop->isProperAncestor(other);
    auto same = dyn_cast<AtomicOp>(other.getOperation());
    if ((isInside && same && same.getKind() == atomic.getKind()) ||
        areKeptApart(loop,
                     cast<DifferentiableAccessInterface>(atomic.getOperation()),
                     other))
      return WalkResult::advance();
    bool isRead = other.getAccessKind() == AccessKind::Read;
    if (isRead && !isInside &&
        body.findAncestorOpInBlock(*other)->isBeforeInBlock(loop))
      return WalkResult::advance();
    if (!isInside)
      b.requestSplit();
    InFlightDiagnostic diag = b.emitError(
        atomic, isInside ? "an element that iterations combine at the same "
                           "time is also accessed in another way"
                         : "an element that iterations combine at the same "
                           "time is also accessed outside of the loop");
    diag.attachNote(other->getLoc()) << (isRead ? "read here" : "written here");
    diag.attachNote() << (isInside ? "do this in a loop of its own"
                                   : "do this in a kernel of its own");
    return WalkResult::interrupt();
  });
  return failure(result.wasInterrupted());
}

/// Describes the range of a loop along one dimension by values of type index.
static CountedLoop countLoop(AdjointBuilder &b, Value iv, Value lower,
                             Value upper, Value step) {
  auto toIndex = [&](Value value) -> Value {
    return value.getType().isIndex()
               ? value
               : b.createOrFold<arith::IndexCastOp>(b.getIndexType(), value);
  };
  lower = toIndex(lower);
  // The extent (upper bound less lower bound) is unsigned: it may exceed the
  // range of signed numbers.
  Value extent = b.createOrFold<arith::SubIOp>(
      b.createOrFold<arith::MaxSIOp>(toIndex(upper), lower), lower);
  if (step && matchPattern(step, m_One()))
    step = {};
  if (step) {
    step = toIndex(step);
    extent = b.createOrFold<arith::CeilDivUIOp>(extent, step);
  }
  return {iv, lower, step, extent};
}

// Fails if the number of executions of the atomic cannot be computed before the
// loop.
FailureOr<SmallVector<CountedLoop>>
ContendedAtomics::countLoops(ParallelForOp loop, AtomicOp atomic) {
  SmallVector<scf::ForOp> inner;
  for (Operation *parent = atomic->getParentOp(); parent != loop;
       parent = parent->getParentOp()) {
    if (isa<scf::IfOp>(parent))
      continue;
    auto serial = dyn_cast<scf::ForOp>(parent);
    if (!serial || !isKnownBefore(loop, serial.getLowerBound()) ||
        !isKnownBefore(loop, serial.getUpperBound()) ||
        !isKnownBefore(loop, serial.getStep())) {
      InFlightDiagnostic diag = b.emitError(
          atomic, "how often an iteration combines its values with those of "
                  "others is not known before the loop");
      diag.attachNote(parent->getLoc()) << "because of this loop";
      diag.attachNote() << "combine them in a local variable first, and then "
                           "that with the field";
      return failure();
    }
    inner.push_back(serial);
  }
  SmallVector<CountedLoop> loops;
  if (loop.isStructFor()) {
    FieldLayout layout =
        *getFieldLayout(lookupField(loop, loop.getFieldAttr()));
    for (auto [iv, extent, first] :
         llvm::zip(loop.getInductionVars(), layout.shape, layout.offset))
      loops.push_back(countLoop(
          b, iv, arith::ConstantIndexOp::create(b, first),
          arith::ConstantIndexOp::create(b, first + extent), Value()));
  } else {
    for (auto [iv, lower, upper] :
         llvm::zip(loop.getInductionVars(), loop.getLowerBounds(),
                   loop.getUpperBounds()))
      loops.push_back(
          countLoop(b, iv, b.getPrimal(lower), b.getPrimal(upper), Value()));
  }
  for (scf::ForOp serial : llvm::reverse(inner))
    loops.push_back(countLoop(
        b, serial.getInductionVar(), b.getPrimal(serial.getLowerBound()),
        b.getPrimal(serial.getUpperBound()), b.getPrimal(serial.getStep())));
  return loops;
}

//===----------------------------------------------------------------------===//
// The loop, forward
//===----------------------------------------------------------------------===//

/// Emits the number of the current execution of the atomic, linearized over the
/// iterations of the loops around it.
static Value createRun(AdjointBuilder &b, const KeptValues &kept,
                       llvm::function_ref<Value(Value)> getIndex) {
  Value run = arith::ConstantIndexOp::create(b, 0);
  for (const CountedLoop &loop : kept.loops) {
    Value index = getIndex(loop.iv);
    if (!index.getType().isIndex())
      index = arith::IndexCastOp::create(b, b.getIndexType(), index);
    index = b.createOrFold<arith::SubIOp>(index, loop.lower);
    if (loop.step)
      index = arith::DivUIOp::create(b, index, loop.step);
    run = b.createOrFold<arith::AddIOp>(
        b.createOrFold<arith::MulIOp>(run, loop.extent), index);
  }
  return run;
}

/// Erases the ops with side effects from a copy of a loop, and the ops that are
/// unused without them.
static LogicalResult
removeEffects(AdjointBuilder &b, Operation *copy,
              const DenseMap<Operation *, Operation *> &originals) {
  SmallVector<Operation *> effects;
  for (auto [op, original] : originals)
    if (op != copy && op->getNumRegions() == 0 &&
        !op->hasTrait<OpTrait::IsTerminator>() && !isMemoryEffectFree(op) &&
        !hasSingleEffect<MemoryEffects::Read>(op) && !isa<RandomOp>(op))
      effects.push_back(op);
  IRRewriter rewriter(copy->getContext());
  size_t before;
  do {
    before = effects.size();
    llvm::erase_if(effects, [&](Operation *op) {
      bool isUnused = op->use_empty();
      if (isUnused)
        rewriter.eraseOp(op);
      return isUnused;
    });
    (void)runRegionDCE(rewriter, copy->getRegions());
  } while (effects.size() != before);
  for (Operation *op : effects)
    b.emitError(originals.at(op),
                "the value before the update is needed by the gradient, but is "
                "gone when the gradient runs")
            .attachNote()
        << "store it to a field in a kernel of its own, and load it from there";
  return success(effects.empty());
}

LogicalResult ContendedAtomics::keepValues(FunctionOpInterface kernel,
                                           ParallelForOp loop,
                                           MutableArrayRef<Contention> groups) {
  OpBuilder::InsertionGuard guard(b);
  IRMapping mapping;
  Operation *copy = b.clone(*loop, mapping);
  DenseMap<Operation *, Operation *> originals;
  loop->walk([&](Operation *op) { originals[mapping.lookup(op)] = op; });
  for (Contention &group : groups)
    for (AtomicOp atomic : group.getAtomics()) {
      auto place = cast<AtomicOp>(mapping.lookup(atomic.getOperation()));
      b.setInsertionPoint(place);
      b.setLoc(atomic.getLoc());
      Value run = createRun(b, kept[atomic],
                            [&](Value iv) { return mapping.lookup(iv); });
      group.keepValue(kept[atomic], place, run);
    }
  // The effects of the copied loop are removed before anything else, so that no
  // values are requested for the erased ops.
  if (failed(removeEffects(b, copy, originals))) {
    copy->erase();
    return failure();
  }
  // Collects the values that the copied loop uses, and the reads that it makes.
  llvm::SetVector<Value> used;
  llvm::SetVector<Operation *> reads;
  copy->walk([&](Operation *op) {
    used.insert_range(op->getOperands());
    if (Operation *original = originals.lookup(op);
        original && original->getName() == op->getName() &&
        isa<DifferentiableAccessInterface>(original))
      reads.insert(original);
  });
  for (Operation *read : reads) {
    // The value of a re-executed read is available only in the reverse of the
    // read's own iteration.
    if (b.isReexecuted(read))
      b.emitError(read,
                  "the value read here decides on a value that iterations "
                  "combine, and is overwritten by the loop")
              .attachNote()
          << "combine the values in a loop of its own";
    else if (b.checkReadable(cast<DifferentiableAccessInterface>(read)))
      continue;
    copy->erase();
    return failure();
  }
  b.setInsertionPoint(copy);
  for (Value value : used) {
    if (!kernel->isAncestor(value.getParentBlock()->getParentOp()))
      continue;
    Value known = b.getPrimal(value);
    value.replaceUsesWithIf(known, [&](OpOperand &use) {
      return copy->isAncestor(use.getOwner());
    });
  }
  return success();
}

LogicalResult ContendedAtomics::begin(FunctionOpInterface kernel,
                                      ParallelForOp loop) {
  SmallVector<AtomicOp> atomics;
  loop->walk([&](AtomicOp atomic) {
    auto access = cast<DifferentiableAccessInterface>(atomic.getOperation());
    if (access.getAccessKind() == AccessKind::Update &&
        b.getActivity().isActiveAccess(atomic))
      atomics.push_back(atomic);
  });
  if (atomics.empty())
    return success();
  Location loc = b.getLoc();
  llvm::MapVector<std::pair<Attribute, AtomicKind>, Contention> byField;
  for (AtomicOp atomic : atomics) {
    if (failed(check(kernel, loop, atomic)))
      return failure();
    AtomicKind kind = atomic.getKind();
    byField.insert({{atomic.getFieldAttr(), kind}, Contention(b, loop, kind)})
        .first->second.add(atomic);
  }
  SmallVector<Contention, 0> groups;
  for (auto &[key, group] : byField)
    groups.push_back(std::move(group));
  for (Contention &group : groups) {
    b.setLoc(group.getAtomics().front().getLoc());
    b.requireBefore(group.getAtomics().front());
    if (failed(group.prepare()))
      return failure();
    for (AtomicOp atomic : group.getAtomics()) {
      FailureOr<SmallVector<CountedLoop>> loops = countLoops(loop, atomic);
      if (failed(loops))
        return failure();
      kept[atomic] = group.createKept(*loops);
    }
  }
  b.setLoc(loc);
  if (failed(keepValues(kernel, loop, groups)))
    return failure();
  for (Contention &group : groups) {
    b.setLoc(group.getAtomics().front().getLoc());
    SmallVector<KeptValues> values;
    for (AtomicOp atomic : group.getAtomics())
      values.push_back(kept[atomic]);
    group.createAdjoints(values);
  }
  b.setLoc(loc);
  return success();
}

Value ContendedAtomics::getAdjoint(AtomicOp atomic) {
  auto *it = kept.find(atomic);
  if (it == kept.end())
    return {};
  Value run =
      createRun(b, it->second, [&](Value iv) { return b.getPrimal(iv); });
  Value share = memref::LoadOp::create(b, it->second.values, run);
  Type type = atomic.getValue().getType();
  if (share.getType() != type)
    share = arith::TruncFOp::create(b, type, share);
  return share;
}

void ContendedAtomics::end() {
  for (auto &[atomic, values] : kept)
    for (Value buffer : {values.values, values.elements})
      memref::DeallocOp::create(b, buffer);
  kept.clear();
}
