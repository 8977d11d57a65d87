//===- AdjointBuilder.cpp - Emits reverse mode of a kernel ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The reverse sweep: blocks, ops and sums of adjoints. Primal values come from
// Rematerializer.
//
//===----------------------------------------------------------------------===//

#include "tai/AD/Reverse/AdjointBuilder.h"
#include "ContendedAtomics.h"
#include "ForwardReexecution.h"
#include "NonFiniteAdjoints.h"
#include "Rematerializer.h"
#include "StoredOutputs.h"
#include "ValueShadows.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/CallInterfaces.h"
#include "tai/AD/NarrowAdjoints.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/HelpfulPasses.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

AdjointBuilder::AdjointBuilder(FunctionOpInterface adjoint,
                               const AdjointPlan &plan)
    : DerivativeBuilder(plan.primal, /*usesConditions=*/true),
      primal(plan.primal), adjoint(adjoint), plan(plan),
      stored(plan.options.loadsStored
                 ? std::make_unique<StoredOutputs>(primal, plan.accesses)
                 : nullptr),
      reexecution(
          std::make_unique<ForwardReexecution>(*this, plan.reexecution)),
      rematerializer(std::make_unique<Rematerializer>(
          *this, plan, demands, *reexecution, stored.get())),
      nonFinite(std::make_unique<NonFiniteAdjoints>(*this)),
      contended(std::make_unique<ContendedAtomics>(*this)) {}

AdjointBuilder::~AdjointBuilder() = default;

LogicalResult AdjointBuilder::build() {
  nonFinite->propagateMarks(primal);
  Block *body = &primal.getFunctionBody().front();
  Block *mirror = &adjoint.getFunctionBody().front();
  LogicalResult result = reverseBlock(
      body, mirror,
      [&](Frame &frame) {
        for (auto [from, to] :
             llvm::zip(body->getArguments(), mirror->getArguments()))
          frame.values.map(from, to);
        for (auto &[from, to] : plan.local.records)
          frame.values.map(from, to);
        seedOutputs(*this);
      },
      [&](Frame &) { accumulateInputs(*this); });
  if (failed(result) || hasErrors)
    return failure();
  reexecution->collectReads(adjoint, demands);
  if (stored)
    demands.stored = stored->getUsed();
  if (!plan.keepsDead())
    dropDeadCarried(adjoint.getFunctionBody());
  return success();
}

//===----------------------------------------------------------------------===//
// Methods of AdjointBuilder that forward to its parts
//===----------------------------------------------------------------------===//

Value AdjointBuilder::getPrimal(Value value) {
  return rematerializer->get(value);
}

SmallVector<Value> AdjointBuilder::getPrimals(ValueRange values) {
  return llvm::map_to_vector(values,
                             [&](Value value) { return getPrimal(value); });
}

void AdjointBuilder::recomputeBlock(Block *primal, Block *mirror) {
  rematerializer->cloneBlock(primal, mirror);
}

bool AdjointBuilder::checkReadable(DifferentiableAccessInterface read) {
  return rematerializer->checkReadable(read);
}

Value AdjointBuilder::fetchCount(scf::WhileOp loop) {
  return reexecution->fetchCount(loop);
}

bool AdjointBuilder::isReexecuted(Operation *access) const {
  return plan.reexecution.isRecorded(access) ||
         plan.reexecution.isRewritten(getStorageKey(access));
}

LogicalResult AdjointBuilder::beginContended(ParallelForOp loop) {
  return contended->begin(primal, loop);
}

void AdjointBuilder::endContended() { contended->end(); }

void AdjointBuilder::markInfinite(Value value) {
  nonFinite->markInfinite(value);
}

void AdjointBuilder::markUndefined(Value value) {
  nonFinite->markUndefined(value);
}

bool AdjointBuilder::isSeedUndefined() const {
  return nonFinite->isSeedUndefined();
}

Value AdjointBuilder::createTripCount(scf::ForOp loop) {
  auto toIndex = [&](Value value) -> Value {
    return value.getType().isIndex()
               ? value
               : createOrFold<arith::IndexCastOp>(getIndexType(), value);
  };
  // The distance between the bounds may exceed the range of their signed type.
  // Bounds of fewer than 64 bits are subtracted as indices, wider ones as
  // unsigned numbers.
  Value lower = getPrimal(loop.getLowerBound());
  Value upper = getPrimal(loop.getUpperBound());
  Value step = getPrimal(loop.getStep());
  bool startsAtZero = matchPattern(lower, m_Zero());
  auto type = dyn_cast<IntegerType>(step.getType());
  bool isNarrow = type && type.getWidth() < 64;
  if (isNarrow) {
    lower = toIndex(lower);
    upper = toIndex(upper);
    step = toIndex(step);
  } else if (!startsAtZero) {
    upper = createOrFold<arith::MaxSIOp>(upper, lower);
  }
  Value count = upper;
  if (!startsAtZero)
    count = createOrFold<arith::SubIOp>(upper, lower);
  if (matchPattern(step, m_One()))
    return toIndex(count);
  if (startsAtZero || isNarrow)
    return toIndex(createOrFold<arith::CeilDivSIOp>(count, step));
  return toIndex(createOrFold<arith::CeilDivUIOp>(count, step));
}

InFlightDiagnostic AdjointBuilder::emitError(Operation *op,
                                             const Twine &message) {
  hasErrors = true;
  return op->emitError() << message;
}

//===----------------------------------------------------------------------===//
// The sweep
//===----------------------------------------------------------------------===//

LogicalResult
AdjointBuilder::reverseBlock(Block *primal, Block *mirror,
                             llvm::function_ref<void(Frame &)> begin,
                             llvm::function_ref<void(Frame &)> end,
                             llvm::function_ref<void()> beforeSweep) {
  OpBuilder::InsertionGuard guard(*this);
  Location loc = getLoc();
  setInsertionPointToEnd(mirror);
  Frame frame(current, primal, mirror);
  current = &frame;
  begin(frame);
  // Two placeholder ops mark where recomputed values and where the sweep are
  // inserted, until the block is complete.
  auto createMarker = [&] { return createConstant(getF32Type(), 0); };
  frame.recomputeBegin = createMarker().getDefiningOp();
  frame.sweepBegin = createMarker().getDefiningOp();
  bool isReexecuted = plan.reexecution.isReexecuted(primal);
  if (isReexecuted)
    reexecution->begin(frame);
  if (plan.local.setAdjoint)
    createOwnAdjoints(frame);
  if (beforeSweep)
    beforeSweep();
  LogicalResult result = success();
  for (Operation &op : llvm::reverse(primal->without_terminator())) {
    setLoc(op.getLoc());
    if (failed(reverseOp(&op)))
      result = failure();
  }
  setLoc(loc);
  if (isReexecuted)
    reexecution->end(frame);
  for (Value buffer : frame.buffers)
    memref::DeallocOp::create(*this, buffer);
  end(frame);
  frame.sweepBegin->erase();
  reexecution->leave(frame);
  current = frame.parent;
  return result;
}

/// Emits zero adjoints of the arrays that the block allocates.
void AdjointBuilder::createOwnAdjoints(Frame &frame) {
  Location loc = getLoc();
  for (Operation &op : *frame.primal) {
    if (!isa<memref::AllocOp, memref::AllocaOp>(op) ||
        !plan.adjointOf(Storage(op.getResult(0))))
      continue;
    Value array = op.getResult(0);
    // The adjoint of an array without active accesses would always be zero.
    if (llvm::none_of(array.getUsers(), [&](Operation *user) {
          return plan.activity.isActiveAccess(user);
        }))
      continue;
    setLoc(op.getLoc());
    MemRefType type = getShadowType(array.getType());
    type = MemRefType::get(type.getShape(), type.getElementType(),
                           MemRefLayoutAttrInterface(), type.getMemorySpace());
    SmallVector<Value> sizes = getPrimals(op.getOperands());
    Value shadow = memref::AllocOp::create(*this, type, sizes);
    frame.buffers.push_back(shadow);
    plan.local.setAdjoint(array, shadow);
    Value zero = createZero(type.getElementType());
    Value begin = arith::ConstantIndexOp::create(*this, 0);
    Value step = arith::ConstantIndexOp::create(*this, 1);
    SmallVector<Value> upper, lower(type.getRank(), begin),
        steps(type.getRank(), step);
    unsigned next = 0;
    for (int64_t size : type.getShape())
      upper.push_back(ShapedType::isDynamic(size)
                          ? sizes[next++]
                          : Value(arith::ConstantIndexOp::create(*this, size)));
    scf::buildLoopNest(*this, getLoc(), lower, upper, steps,
                       [&](OpBuilder &b, Location at, ValueRange ivs) {
                         memref::StoreOp::create(b, at, zero, shadow, ivs);
                       });
  }
  setLoc(loc);
}

static bool hasAdjoint(Frame &frame, Value value) {
  return frame.adjoints.contains(value);
}

LogicalResult AdjointBuilder::reverseOp(Operation *op) {
  if (isa<DifferentiableAccessInterface>(op))
    return isReversed(op) ? reverseAccess(op) : success();
  bool matters =
      plan.activity.holdsActiveAccess(op) || plan.zeroing.isHeldBy(op) ||
      llvm::any_of(op->getResults(),
                   [&](Value result) { return hasAdjoint(*current, result); });
  if (isa<CallOpInterface>(op) && !isMemoryEffectFree(op)) {
    emitError(op, "cannot differentiate a call that was not inlined")
            .attachNote()
        << "run 'inline' first; a recursive function cannot be differentiated";
    return failure();
  }
  if (!matters)
    return success();
  if (auto loop = dyn_cast<AdjointLoopInterface>(op)) {
    llvm::SaveAndRestore notForRule(rematerializer->isForRule, false);
    return loop.buildReverse(*this);
  }
  llvm::SaveAndRestore forRule(rematerializer->isForRule, true);
  if (auto rule = dyn_cast<DifferentiableOpInterface>(op)) {
    nonFinite->beginRule(op);
    LogicalResult result = rule.buildAdjoint(*this);
    nonFinite->endRule();
    return result;
  }
  InFlightDiagnostic diag =
      emitError(op, "'" + op->getName().getStringRef() +
                        "' has no derivative rule, but a gradient passes "
                        "through it");
  if (!attachHelpfulPass(diag, op))
    diag.attachNote() << "compute the value from differentiable ops, or keep "
                         "it out of what the gradient is taken of";
  return failure();
}

LogicalResult AdjointBuilder::reverseAccess(Operation *op) {
  auto access = cast<DifferentiableAccessInterface>(op);
  Value value = access.getAccessedValue();
  Storage storage = plan.adjointOf(access.getAccessedStorage());
  bool isRead = access.getAccessKind() == AccessKind::Read;
  if (!isRead)
    for (Value result : op->getResults())
      if (hasAdjoint(*current, result)) {
        emitError(op, "the value before the accumulation is used in what the "
                      "gradient is taken of")
                .attachNote()
            << "an element must not be read before its accumulation is done; "
               "load it in a later loop";
        return failure();
      }
  if (access.getAccessKind() == AccessKind::Update) {
    auto atomic = dyn_cast<AtomicOp>(op);
    if (Value share = atomic ? contended->getAdjoint(atomic) : Value()) {
      addAdjoint(value, share);
      return success();
    }
    if (isa<memref::AtomicRMWOp>(op)) {
      emitError(op,
                "this product, minimum or maximum of an element of an array "
                "has no gradient, because several iterations may combine "
                "into one element")
              .attachNote()
          << "combine into a field that has a gradient instead of the array";
      return failure();
    }
    emitError(op, "cannot differentiate this read-modify-write of a field "
                  "with an adjoint")
            .attachNote()
        << "run 'tai-expand-atomics' first, or write it as a load and a store";
    return failure();
  }
  Value seed = isRead ? getAdjoint(value) : Value();
  if (isRead && !seed)
    return success();
  SmallVector<Value> indices = getPrimals(access.getAccessIndices());
  SmallVector<Value> components = getPrimals(access.getAccessComponents());
  if (isRead) {
    access.createAdjointAccumulate(*this, seed, storage, indices, components);
    return success();
  }
  Value read;
  if (plan.activity.isActiveAccess(op))
    read = access.createAdjointRead(*this, storage, indices, components);
  if (zeroesAdjoint(op))
    access.createAdjointStore(*this, createZero(value.getType()), storage,
                              indices, components);
  if (read && access.isNegated())
    read = arith::NegFOp::create(*this, read);
  addAdjoint(value, read);
  return success();
}

/// Collects the active ops in the block of `value` that compute it from reads.
/// False if one of the ops cannot be reversed on its own, or if there are too
/// many.
static bool collectMakers(AdjointBuilder &b, Value value,
                          llvm::SetVector<Operation *> &makers) {
  constexpr unsigned kMany = 32;
  Block *block = value.getParentBlock();
  SmallVector<Value> pending = {value};
  while (!pending.empty()) {
    Operation *op = pending.pop_back_val().getDefiningOp();
    if (!op || op->getBlock() != block || op->getNumRegions() != 0)
      return false;
    if (!makers.insert(op))
      continue;
    if (makers.size() > kMany)
      return false;
    if (auto read = dyn_cast<DifferentiableAccessInterface>(op)) {
      // The read must not be of an element that is overwritten later, because
      // the adjoint of the element would be that of the new value.
      if (b.mayBeOverwritten(read))
        return false;
      continue;
    }
    if (!isa<DifferentiableOpInterface>(op))
      return false;
    for (Value operand : op->getOperands())
      if (b.isActive(operand))
        pending.push_back(operand);
  }
  return true;
}

void AdjointBuilder::sweepCaptured() {
  Frame &frame = *current;
  llvm::SetVector<Operation *> all;
  for (auto &[value, entry] : frame.adjoints) {
    llvm::SetVector<Operation *> makers;
    if (value.getParentBlock() == frame.parent->primal &&
        collectMakers(*this, value, makers))
      all.insert(makers.begin(), makers.end());
  }
  SmallVector<Operation *> ordered = all.takeVector();
  llvm::sort(ordered, [](Operation *lhs, Operation *rhs) {
    return rhs->isBeforeInBlock(lhs);
  });
  for (Operation *op : ordered) {
    setLoc(op->getLoc());
    if (failed(reverseOp(op)))
      hasErrors = true;
    for (Value result : op->getResults())
      frame.adjoints.erase(result);
  }
}

//===----------------------------------------------------------------------===//
// Sums of adjoints
//===----------------------------------------------------------------------===//

static Value addUp(ImplicitLocOpBuilder &builder, Value sum, Value term) {
  if (!sum || !term)
    return sum ? sum : term;
  Value wideSum = getWidened(sum), wideTerm = getWidened(term);
  if (wideSum == sum || wideSum.getType() != wideTerm.getType())
    return arith::AddFOp::create(builder, sum, term);
  Value inF64 = arith::AddFOp::create(builder, wideSum, wideTerm);
  return arith::TruncFOp::create(builder, sum.getType(), inF64);
}

void AdjointBuilder::addAdjoint(Value value, Value contribution) {
  if (!contribution || !isActive(value))
    return;
  PartialAdjoint &entry = current->adjoints[value];
  entry.whole =
      addUp(*this, entry.whole, nonFinite->guard(value, contribution));
}

void AdjointBuilder::addAdjointComponent(Value value, int64_t component,
                                         Value contribution) {
  if (!contribution || !isActive(value))
    return;
  PartialAdjoint &entry = current->adjoints[value];
  if (entry.components.empty())
    entry.components.resize(cast<VectorType>(value.getType()).getNumElements());
  Value &sum = entry.components[component];
  sum = addUp(*this, sum, nonFinite->guard(value, contribution));
}

Value AdjointBuilder::sumUp(Value value, PartialAdjoint &entry) {
  if (entry.components.empty())
    return entry.whole;
  auto type = cast<VectorType>(value.getType());
  SmallVector<Value> components = std::move(entry.components);
  entry.components.clear();
  if (entry.whole)
    for (auto [i, component] : llvm::enumerate(components))
      component = addUp(*this, createExtract(entry.whole, i), component);
  entry.whole = createVector(type, components);
  return entry.whole;
}

Value AdjointBuilder::getAdjoint(Value value) {
  auto *it = current->adjoints.find(value);
  return it == current->adjoints.end() ? Value() : sumUp(value, it->second);
}

Value AdjointBuilder::getAdjointOrZero(Value value) {
  Value sum = getAdjoint(value);
  return sum ? sum : createZero(value.getType());
}

SmallVector<Value> AdjointBuilder::getAdjointComponents(Value value) {
  auto type = cast<VectorType>(value.getType());
  auto *it = current->adjoints.find(value);
  if (it == current->adjoints.end())
    return SmallVector<Value>(type.getNumElements());
  PartialAdjoint &entry = it->second;
  if (!entry.whole)
    return entry.components;
  SmallVector<Value> components(entry.components);
  components.resize(type.getNumElements());
  for (auto [i, component] : llvm::enumerate(components))
    component = addUp(*this, createExtract(entry.whole, i), component);
  return components;
}

llvm::MapVector<Value, Value> AdjointBuilder::takeCaptured(Frame &frame) {
  llvm::MapVector<Value, Value> captured;
  for (auto &[value, entry] : frame.adjoints)
    if (value.getParentBlock() != frame.primal)
      captured[value] = sumUp(value, entry);
  return captured;
}
