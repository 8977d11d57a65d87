//===- AdjointBuilder.cpp - Builds the reverse of a kernel ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The reverse sweep: blocks, ops and sums of adjoints. Recomputation of primal
// values is in Recompute.cpp.
//
//===----------------------------------------------------------------------===//

#include "tai/AD/AdjointBuilder.h"
#include "ContendedAtomics.h"
#include "StoredOutputs.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/CallInterfaces.h"
#include "tai/AD/Rerun.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/DerivativePaths.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/Support/SaveAndRestore.h"

using namespace mlir;
using namespace mlir::tai;

AdjointBuilder::AdjointBuilder(FunctionOpInterface primal,
                               FunctionOpInterface adjoint,
                               std::function<Storage(Storage)> adjointOf,
                               bool takesAll, const RerunPlan &plan,
                               ValueShadows valueShadows, SkipSet skips)
    : DerivativeBuilder(primal, /*usesConditions=*/true), primal(primal),
      adjoint(adjoint), adjointOf(std::move(adjointOf)),
      shadows(std::move(valueShadows)),
      activity(
          primal,
          [this](Storage storage) {
            return static_cast<bool>(this->adjointOf(storage));
          },
          shadows.inputs, shadows.outputs,
          /*assumeVaried=*/!skips.has(Skip::ActivityAnalysis)),
      accesses(primal), takesAll(takesAll),
      recordsAll(!skips.has(Skip::RecordingAnalysis)),
      keepsDead(!skips.has(Skip::ActivityAnalysis)), plan(plan), larger(plan),
      contended(std::make_unique<ContendedAtomics>(*this)) {
  for (Operation *op : plan.recorded) {
    Block *unit = getRerunUnit(op);
    units.insert(unit);
    for (Operation *parent = op->getParentOp(); parent != unit->getParentOp();
         parent = parent->getParentOp())
      holders.insert(parent);
  }
}

AdjointBuilder::~AdjointBuilder() = default;

LogicalResult AdjointBuilder::build() {
  if (failed(checkAccesses()))
    return failure();
  findTakes();
  Block *body = &primal.getFunctionBody().front();
  Block *mirror = &adjoint.getFunctionBody().front();
  LogicalResult result = reverseBlock(
      body, mirror,
      [&](Frame &frame) {
        for (auto [from, to] :
             llvm::zip(body->getArguments(), mirror->getArguments()))
          frame.values.map(from, to);
        seedOutputs();
      },
      [&](Frame &) { accumulateInputs(); });
  if (failed(result) || hasErrors)
    return failure();
  collectRerunReads();
  if (failed(chooseStates()))
    return failure();
  if (!keepsDead)
    dropDeadCarried(adjoint.getFunctionBody());
  return success();
}

LogicalResult AdjointBuilder::beginContended(ParallelForOp loop) {
  return contended->begin(primal, loop);
}

void AdjointBuilder::endContended() { contended->end(); }

bool AdjointBuilder::runsAgain(Operation *access) const {
  return plan.recorded.contains(access) ||
         plan.storages.contains(getStorageKey(access));
}

/// True for what only looks at an array.
static bool isQuery(Operation *op) {
  return isa<memref::DimOp, memref::RankOp, memref::DeallocOp>(op);
}

// What is not understood would be left out of the gradient in silence.
LogicalResult AdjointBuilder::checkAccesses() {
  for (BlockArgument argument : primal.getArguments()) {
    if (!isa<MemRefType>(argument.getType()) || !adjointOf(Storage(argument)))
      continue;
    for (Operation *user : argument.getUsers()) {
      auto access = dyn_cast<DifferentiableAccessInterface>(user);
      if (isQuery(user) ||
          (access && access.getAccessedStorage().memref == argument) ||
          !refused.insert(user).second)
        continue;
      emitError(user, "cannot differentiate '" +
                          user->getName().getStringRef() +
                          "' on an array with a derivative")
              .attachNote()
          << "access its elements by 'memref.load', 'memref.store' and "
             "'memref.atomic_rmw addf'";
    }
  }
  auto hasAdjoint = [&](Storage storage) {
    return static_cast<bool>(adjointOf(storage));
  };
  DerivativeEnds ends{hasAdjoint, shadows.inputs, shadows.outputs};
  (void)verifyDerivativePaths(primal, ends,
                              [&](Operation *op, const Twine &message) {
                                return emitError(op, message);
                              });
  checkActivityChanges();
  primal.walk([&](Operation *op) {
    if (auto access = dyn_cast<DifferentiableAccessInterface>(op)) {
      Storage storage = access.getAccessedStorage();
      if (access.getAccessKind() == AccessKind::Read) {
        if (activity.isActiveAccess(op))
          accumulated.insert(adjointOf(storage).getOpaque());
      } else if (storage.memref && !isa<BlockArgument>(storage.memref) &&
                 activity.isVaried(access.getAccessedValue())) {
        emitError(op, "a derivative is lost in an array that the function "
                      "makes for itself")
                .attachNote()
            << "use a local variable, a field, or an array that is an argument";
      }
      return;
    }
    // Output and checks take what they like; regions are looked into.
    if (op->getNumRegions() != 0 || isMemoryEffectFree(op) ||
        isa<PrintOp, AssertOp, PreconditionOp>(op))
      return;
    if (llvm::none_of(op->getOperands(),
                      [&](Value v) { return activity.isVaried(v); }))
      return;
    InFlightDiagnostic diag = emitError(
        op, "a derivative is lost in '" + op->getName().getStringRef() +
                "', which cannot be differentiated");
    if (isa<AppendOp>(op))
      diag.attachNote() << "store the value to the element by an index; the "
                           "list grows to the highest one";
  });
  return failure(hasErrors);
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
  // Two ops that only mark places; they are gone when the block is done.
  auto createMarker = [&] { return createConstant(getF32Type(), 0); };
  frame.recomputeBegin = createMarker().getDefiningOp();
  frame.sweepBegin = createMarker().getDefiningOp();
  if (units.contains(primal))
    beginRerun(frame);
  if (beforeSweep)
    beforeSweep();
  LogicalResult result = success();
  for (Operation &op : llvm::reverse(primal->without_terminator())) {
    setLoc(op.getLoc());
    if (failed(reverseOp(&op)))
      result = failure();
  }
  setLoc(loc);
  if (units.contains(primal))
    endRerun(frame);
  end(frame);
  frame.sweepBegin->erase();
  leaveMirror(frame);
  current = frame.parent;
  return result;
}

static bool hasAdjoint(Frame &frame, Value value) {
  return frame.adjoints.contains(value);
}

LogicalResult AdjointBuilder::reverseOp(Operation *op) {
  if (isa<DifferentiableAccessInterface>(op))
    return isReversed(op) ? reverseAccess(op) : success();
  bool matters = activity.holdsActiveAccess(op) || takeHolders.contains(op) ||
                 llvm::any_of(op->getResults(), [&](Value result) {
                   return hasAdjoint(*current, result);
                 });
  if (isa<CallOpInterface>(op) && !isMemoryEffectFree(op)) {
    emitError(op, "cannot differentiate a call that was not inlined")
            .attachNote()
        << "run 'inline' first; a recursive function cannot be differentiated";
    return failure();
  }
  if (!matters)
    return success();
  if (auto loop = dyn_cast<AdjointLoopInterface>(op)) {
    llvm::SaveAndRestore notInRule(inRule, false);
    return loop.buildReverse(*this);
  }
  llvm::SaveAndRestore nowInRule(inRule, true);
  if (auto rule = dyn_cast<DifferentiableOpInterface>(op)) {
    seedIsInfinite = createInfinityTest(op);
    seedIsUndefined = llvm::any_of(op->getResults(), [&](Value result) {
      return mayBeUndefined.contains(result);
    });
    LogicalResult result = rule.buildAdjoint(*this);
    seedIsInfinite = {};
    seedIsUndefined = false;
    return result;
  }
  emitError(op, "'" + op->getName().getStringRef() +
                    "' has no derivative rule, but a gradient passes through "
                    "it")
          .attachNote()
      << "compute the value from differentiable ops, or keep it out of what "
         "the gradient is taken of";
  return failure();
}

LogicalResult AdjointBuilder::reverseAccess(Operation *op) {
  auto access = cast<DifferentiableAccessInterface>(op);
  Value value = access.getAccessedValue();
  Storage storage = adjointOf(access.getAccessedStorage());
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
  if (activity.isActiveAccess(op))
    read = access.createAdjointRead(*this, storage, indices, components);
  if (takes.contains(op))
    access.createAdjointStore(*this, createZero(value.getType()), storage,
                              indices, components);
  if (read && access.isNegated())
    read = arith::NegFOp::create(*this, read);
  addAdjoint(value, read);
  return success();
}

/// The ops of the block of `value` that make it from reads, as far as they are
/// active. False if one of them cannot be swept by itself, or they are many.
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
      // Nor may what comes between touch the adjoint of the element.
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
  return arith::AddFOp::create(builder, sum, term);
}

/// Whether some adjoint of a result of `op` is infinite; null where that cannot
/// be.
Value AdjointBuilder::createInfinityTest(Operation *op) {
  Value any;
  ruleSeeds.clear();
  for (Value result : op->getResults()) {
    Value size = getAdjoint(result);
    if (!size)
      continue;
    ruleSeeds.insert(size);
    if (!mayBeInfinite.contains(result))
      continue;
    size = math::AbsFOp::create(*this, size);
    if (isa<VectorType>(size.getType()))
      size = SumOp::create(*this, getElementTypeOrSelf(size.getType()), size);
    Value infinity =
        createConstant(size.getType(), std::numeric_limits<double>::infinity());
    Value test =
        arith::CmpFOp::create(*this, arith::CmpFPredicate::OEQ, size, infinity);
    any = any ? Value(arith::OrIOp::create(*this, any, test)) : test;
  }
  return any;
}

/// What a rule has made of the adjoints that it starts from, with 1 in their
/// place: the partial derivative. Null where it is not made by a few plain ops.
Value AdjointBuilder::createUnitContribution(Value contribution) {
  SmallVector<Operation *> slice;
  DenseMap<Value, bool> known;
  auto depends = [&](auto &self, Value value) -> bool {
    if (ruleSeeds.contains(value))
      return true;
    Operation *op = value.getDefiningOp();
    if (!op || op->getBlock() != getInsertionBlock())
      return false;
    if (auto it = known.find(value); it != known.end())
      return it->second;
    bool any = false;
    for (Value operand : op->getOperands())
      any |= self(self, operand);
    known[value] = any;
    if (any && !llvm::is_contained(slice, op))
      slice.push_back(op);
    return any;
  };
  constexpr size_t most = 64;
  if (!depends(depends, contribution) || slice.size() > most ||
      llvm::any_of(slice, [](Operation *op) {
        return op->getNumRegions() != 0 || !isMemoryEffectFree(op);
      }))
    return {};
  IRMapping mapping;
  for (Value seed : ruleSeeds)
    mapping.map(seed, createConstant(seed.getType(), 1));
  for (Operation *op : slice)
    clone(*op, mapping);
  return mapping.lookup(contribution);
}

/// What an infinite adjoint contributes: nothing where the partial derivative
/// is zero, and not the NaN that the product of both is. A partial that is
/// itself no number stays one.
Value AdjointBuilder::createFinite(Value value, Value contribution) {
  if (seedIsUndefined)
    mayBeUndefined.insert(value);
  if (!seedIsInfinite)
    return contribution;
  mayBeInfinite.insert(value);
  auto isOrdered = [&](arith::CmpFPredicate predicate, Value number) {
    return arith::CmpFOp::create(*this, predicate, number, number);
  };
  Value isNaN = isOrdered(arith::CmpFPredicate::UNO, contribution);
  if (Value partial = createUnitContribution(contribution);
      partial && !matchPattern(partial, m_Constant()))
    isNaN = arith::AndIOp::create(
        *this, isNaN, isOrdered(arith::CmpFPredicate::ORD, partial));
  Value infinite = seedIsInfinite;
  if (isa<VectorType>(isNaN.getType()))
    infinite = vector::BroadcastOp::create(*this, isNaN.getType(), infinite);
  Value drops = arith::AndIOp::create(*this, infinite, isNaN);
  return arith::SelectOp::create(
      *this, drops, createZero(contribution.getType()), contribution);
}

void AdjointBuilder::addAdjoint(Value value, Value contribution) {
  if (!contribution || !isActive(value))
    return;
  PartialAdjoint &entry = current->adjoints[value];
  entry.whole = addUp(*this, entry.whole, createFinite(value, contribution));
}

void AdjointBuilder::addAdjointComponent(Value value, int64_t component,
                                         Value contribution) {
  if (!contribution || !isActive(value))
    return;
  PartialAdjoint &entry = current->adjoints[value];
  if (entry.components.empty())
    entry.components.resize(cast<VectorType>(value.getType()).getNumElements());
  Value &sum = entry.components[component];
  sum = addUp(*this, sum, createFinite(value, contribution));
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
  auto it = current->adjoints.find(value);
  return it == current->adjoints.end() ? Value() : sumUp(value, it->second);
}

Value AdjointBuilder::getAdjointOrZero(Value value) {
  Value sum = getAdjoint(value);
  return sum ? sum : createZero(value.getType());
}

SmallVector<Value> AdjointBuilder::getAdjointComponents(Value value) {
  auto type = cast<VectorType>(value.getType());
  auto it = current->adjoints.find(value);
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
