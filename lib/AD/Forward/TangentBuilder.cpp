//===- TangentBuilder.cpp - Emits forward mode of a kernel ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/AD/Forward/TangentBuilder.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/CallInterfaces.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/DerivativePaths.h"
#include "tai/Analysis/HelpfulPasses.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

LogicalResult mlir::tai::refuseTangent(Operation *op, TangentBuilder &builder) {
  InFlightDiagnostic diag =
      builder.emitError(op, "'" + op->getName().getStringRef() +
                                "' has no tangent rule, but a tangent passes "
                                "through it");
  if (!attachHelpfulPass(diag, op))
    diag.attachNote() << "compute the value from differentiable ops, or keep "
                         "it out of what the derivative is taken of";
  return failure();
}

LogicalResult mlir::tai::extendRegions(Operation *op, TangentBuilder &builder) {
  auto isVaried = [&](Value value) { return builder.isVaried(value); };
  bool passesOn = llvm::any_of(op->getResults(), isVaried);
  for (Region &region : op->getRegions())
    for (Block &block : region)
      passesOn |= llvm::any_of(block.getArguments(), isVaried);
  if (passesOn)
    return refuseTangent(op, builder);
  for (Region &region : op->getRegions())
    for (Block &block : region)
      if (failed(builder.extendBlock(&block)))
        return failure();
  return success();
}

TangentBuilder::TangentBuilder(FunctionOpInterface function,
                               std::function<Storage(Storage)> tangentOf)
    : DerivativeBuilder(function), function(function),
      tangentOf(std::move(tangentOf)),
      flow(function, getFacts(), [this](Storage storage) {
        return static_cast<bool>(this->tangentOf(storage));
      }) {}

LogicalResult TangentBuilder::build() {
  auto hasTangent = [&](Storage storage) {
    return static_cast<bool>(tangentOf(storage));
  };
  DerivativeEnds ends{hasTangent};
  ends.isForward = true;
  if (failed(verifyDerivativePaths(function, ends,
                                   [&](Operation *op, const Twine &message) {
                                     return emitError(op, message);
                                   })))
    return failure();
  for (BlockArgument argument : function.getArguments())
    if (isa<MemRefType>(argument.getType()) && isVaried(argument) &&
        failed(checkUsers(argument)))
      return failure();
  for (Block &block : function.getFunctionBody())
    if (failed(extendBlock(&block)))
      hasErrors = true;
  for (Operation *op : replaced)
    op->erase();
  return failure(hasErrors);
}

InFlightDiagnostic TangentBuilder::emitError(Operation *op,
                                             const Twine &message) {
  hasErrors = true;
  return op->emitError() << message;
}

//===----------------------------------------------------------------------===//
// Tangents
//===----------------------------------------------------------------------===//

Value TangentBuilder::getTangent(Value value) { return tangents.lookup(value); }

Value TangentBuilder::getTangentOrZero(Value value) {
  Value tangent = getTangent(value);
  return tangent ? tangent : createZero(value.getType());
}

void TangentBuilder::setTangent(Value value, Value tangent) {
  if (tangent)
    tangents[value] = tangent;
}

Value TangentBuilder::createProduct(Value operand, Value product,
                                    bool partialMayBeNonFinite,
                                    function_ref<Value()> createPartial) {
  if (partialMayBeNonFinite)
    product = createGuard(getTangent(operand), product);
  if (!mayBeNonFinite(operand))
    return product;
  Value partial = createPartial();
  return matchPattern(partial, m_Constant()) ? product
                                             : createGuard(partial, product);
}

void TangentBuilder::applyToTangents(Operation *op) {
  IRMapping mapping;
  for (Value operand : op->getOperands())
    if (isFloatOrVector(operand.getType()))
      mapping.map(operand, getTangentOrZero(operand));
  Operation *copy = clone(*op, mapping);
  for (auto [result, tangent] : llvm::zip(op->getResults(), copy->getResults()))
    setTangent(result, tangent);
}

//===----------------------------------------------------------------------===//
// The walk
//===----------------------------------------------------------------------===//

LogicalResult TangentBuilder::extendBlock(Block *block) {
  OpBuilder::InsertionGuard guard(*this);
  Location loc = getLoc();
  SmallVector<Operation *> ops;
  for (Operation &op : *block)
    if (!op.hasTrait<OpTrait::IsTerminator>())
      ops.push_back(&op);
  LogicalResult result = success();
  // After a failure, go on with the next op, so that the errors of all ops are
  // reported.
  for (Operation *op : ops) {
    setLoc(op->getLoc());
    setInsertionPointAfter(op);
    if (failed(extendOp(op)))
      result = failure();
  }
  setLoc(loc);
  return result;
}

LogicalResult TangentBuilder::extendOp(Operation *op) {
  if (isa<DifferentiableAccessInterface>(op))
    return extendAccess(op);
  if (std::optional<LogicalResult> done = extendLocal(op))
    return *done;
  if (auto loop = dyn_cast<AdjointLoopInterface>(op))
    return loop.buildTangent(*this);
  if (op->getNumRegions() != 0)
    return extendRegions(op, *this);
  if (isa<CallOpInterface>(op) && !isMemoryEffectFree(op)) {
    emitError(op, "cannot differentiate a call that was not inlined")
            .attachNote()
        << "run 'inline' first; a recursive function cannot be differentiated";
    return failure();
  }
  auto rule = dyn_cast<DifferentiableOpInterface>(op);
  bool hasTangents = llvm::any_of(op->getOpOperands(), [&](OpOperand &operand) {
    return getTangent(operand.get()) && carriesDerivative(operand);
  });
  if (!hasTangents)
    return success();
  if (rule)
    return rule.buildTangent(*this);
  if (llvm::any_of(op->getResultTypes(), isFloatOrVector))
    return refuseTangent(op, *this);
  // Printing and checking ops accept values with tangents, and results that are
  // not floats have no tangent.
  if (isMemoryEffectFree(op) || isa<PrintOp, AssertOp, PreconditionOp>(op))
    return success();
  InFlightDiagnostic diag =
      emitError(op, "a derivative is lost in '" + op->getName().getStringRef() +
                        "', which cannot be differentiated");
  attachHelpfulPass(diag, op);
  return failure();
}

void TangentBuilder::replace(Operation *op, Operation *made) {
  for (auto [from, to] : llvm::zip(op->getResults(), made->getResults())) {
    if (flow.varied.contains(from))
      flow.varied.insert(to);
    if (flow.nonFinite.contains(from))
      flow.nonFinite.insert(to);
    from.replaceAllUsesWith(to);
  }
  op->remove();
  op->dropAllReferences();
  replaced.push_back(op);
}

//===----------------------------------------------------------------------===//
// Storages
//===----------------------------------------------------------------------===//

Storage TangentBuilder::getTangentStorage(Storage storage) {
  if (storage.memref)
    if (Value shadow = shadows.lookup(storage.memref))
      return shadow;
  return tangentOf(storage);
}

LogicalResult TangentBuilder::extendAccess(Operation *op) {
  auto access = cast<DifferentiableAccessInterface>(op);
  Value value = access.getAccessedValue();
  if (!isFloatOrVector(value.getType()))
    return success();
  Storage storage = access.getAccessedStorage();
  if (Storage tangent = getTangentStorage(storage))
    return access.buildTangent(*this, tangent);
  // A field without a dual is constant, like a field without an adjoint in
  // reverse mode. A tangent stored to an array is refused: a read of the array
  // would silently return a constant.
  if (storage.memref && access.getAccessKind() != AccessKind::Read &&
      getTangent(value)) {
    emitError(op, "a tangent is lost in an array, which has none").attachNote()
        << "store what has a tangent to a field with a dual";
    return failure();
  }
  return success();
}

LogicalResult TangentBuilder::checkUsers(Value array) {
  for (Operation *user : array.getUsers()) {
    auto access = dyn_cast<DifferentiableAccessInterface>(user);
    if ((access && access.getAccessedStorage().memref == array) ||
        isa<memref::DimOp, memref::RankOp, memref::DeallocOp>(user))
      continue;
    InFlightDiagnostic diag = emitError(
        user, "cannot differentiate '" + user->getName().getStringRef() +
                  "' on an array with a derivative");
    if (!attachHelpfulPass(diag, user))
      diag.attachNote() << "access its elements by 'memref.load', "
                           "'memref.store' and 'memref.atomic_rmw'";
    return failure();
  }
  return success();
}

std::optional<LogicalResult> TangentBuilder::extendLocal(Operation *op) {
  if (isa<AllocaOp, StackCreateOp, memref::AllocOp, memref::AllocaOp>(op)) {
    Value storage = op->getResult(0);
    if (!isVaried(storage))
      return success();
    if (isa<MemRefType>(storage.getType()) && failed(checkUsers(storage))) {
      // The array is entered as its own shadow, so that further accesses to it
      // do not report the error again.
      shadows[storage] = storage;
      return failure();
    }
    shadows[storage] = clone(*op)->getResult(0);
    return success();
  }
  if (auto dealloc = dyn_cast<memref::DeallocOp>(op)) {
    if (Value shadow = shadows.lookup(dealloc.getMemref()))
      memref::DeallocOp::create(*this, shadow);
    return success();
  }
  if (auto load = dyn_cast<LocalLoadOp>(op)) {
    if (Value shadow = shadows.lookup(load.getLocal()))
      setTangent(load.getValue(),
                 LocalLoadOp::create(*this, load.getType(), shadow));
    return success();
  }
  if (auto store = dyn_cast<LocalStoreOp>(op)) {
    if (Value shadow = shadows.lookup(store.getLocal()))
      LocalStoreOp::create(*this, getTangentOrZero(store.getValue()), shadow);
    return success();
  }
  if (auto destroy = dyn_cast<StackDestroyOp>(op)) {
    if (Value shadow = shadows.lookup(destroy.getStack()))
      StackDestroyOp::create(*this, shadow);
    return success();
  }
  // The stack of tangents is pushed and popped with the primal stack, with zero
  // for a missing tangent.
  if (auto push = dyn_cast<StackPushOp>(op)) {
    if (Value shadow = shadows.lookup(push.getStack()))
      StackPushOp::create(*this, getTangentOrZero(push.getValue()), shadow);
    return success();
  }
  if (auto pop = dyn_cast<StackPopOp>(op)) {
    if (Value shadow = shadows.lookup(pop.getStack()))
      setTangent(pop.getValue(),
                 StackPopOp::create(*this, pop.getType(), shadow));
    return success();
  }
  return std::nullopt;
}

//===----------------------------------------------------------------------===//
// Queries whether each iteration accesses only its own elements.
//===----------------------------------------------------------------------===//

bool TangentBuilder::isExclusive(Operation *op) {
  Operation *loop = getOutermostParallelLoop(op);
  Storage storage =
      cast<DifferentiableAccessInterface>(op).getAccessedStorage();
  if (!loop ||
      (storage.memref && getEnclosingParallelLoop(op)->isAncestor(
                             storage.memref.getParentBlock()->getParentOp())))
    return true;
  const void *key = mlir::tai::getStorageKey(op);
  SmallVector<Operation *> writes;
  loop->walk([&](DifferentiableAccessInterface other) {
    if (other.getAccessKind() != AccessKind::Read &&
        mlir::tai::getStorageKey(other) == key)
      writes.push_back(other);
  });
  return mlir::tai::isExclusive(writes);
}

LogicalResult TangentBuilder::runInOrder(Operation *op) {
  for (Operation *loop = getEnclosingParallelLoop(op); loop;
       loop = getEnclosingParallelLoop(loop)) {
    if (auto parallel = dyn_cast<ParallelForOp>(loop)) {
      parallel.setSerialize(true);
      continue;
    }
    emitError(op, "the iterations of a parallel loop may update this element "
                  "at the same time, and its tangent cannot be kept in step")
            .attachNote(loop->getLoc())
        << "use 'scf.for' here";
    return failure();
  }
  return success();
}
