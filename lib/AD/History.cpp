//===- History.cpp - Values that serial loops carry -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What one iteration of a serial loop begins with cannot be computed again from
// that iteration alone. The loop is run forward once more and records it; only
// the carried values that a rule asks for are recorded.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/IR/Matchers.h"
#include "tai/AD/AdjointBuilder.h"

using namespace mlir;
using namespace mlir::tai;

Value AdjointBuilder::createTripCount(scf::ForOp loop) {
  Value lower = getPrimal(loop.getLowerBound());
  Value upper = getPrimal(loop.getUpperBound());
  Value step = getPrimal(loop.getStep());
  Value count = upper;
  if (!matchPattern(lower, m_Zero()))
    count = createOrFold<arith::SubIOp>(upper, lower);
  if (!matchPattern(step, m_One()))
    count = createOrFold<arith::CeilDivSIOp>(count, step);
  if (!count.getType().isIndex())
    count = createOrFold<arith::IndexCastOp>(getIndexType(), count);
  return count;
}

// A vector is kept component by component, so that what lowers the adjoint need
// not know memrefs of vectors.

static MemRefType getHistoryType(Type type) {
  SmallVector<int64_t> shape = {ShapedType::kDynamic};
  if (auto vector = dyn_cast<VectorType>(type))
    shape.push_back(vector.getNumElements());
  return MemRefType::get(shape, getElementTypeOrSelf(type));
}

static void storeHistory(AdjointBuilder &b, Value value, Value buffer,
                         Value position) {
  auto vector = dyn_cast<VectorType>(value.getType());
  if (!vector) {
    memref::StoreOp::create(b, value, buffer, position);
    return;
  }
  for (int64_t i = 0, e = vector.getNumElements(); i != e; ++i)
    memref::StoreOp::create(
        b, b.createExtract(value, i), buffer,
        ValueRange{position, arith::ConstantIndexOp::create(b, i)});
}

static Value loadHistory(AdjointBuilder &b, Type type, Value buffer,
                         Value position) {
  auto vector = dyn_cast<VectorType>(type);
  if (!vector)
    return memref::LoadOp::create(b, buffer, position);
  SmallVector<Value> components;
  for (int64_t i = 0, e = vector.getNumElements(); i != e; ++i)
    components.push_back(memref::LoadOp::create(
        b, buffer, ValueRange{position, arith::ConstantIndexOp::create(b, i)}));
  return b.createVector(vector, components);
}

/// The buffer of a carried value: made before `loop`, and written by it where
/// an iteration begins, at `position`.
static Value createHistory(AdjointBuilder &b, Operation *loop, Value carried,
                           Value size, function_ref<Value()> getPosition) {
  b.setInsertionPoint(loop);
  b.setLoc(loop->getLoc());
  Value buffer =
      memref::AllocOp::create(b, getHistoryType(carried.getType()), size);
  b.setInsertionPointToStart(cast<BlockArgument>(carried).getOwner());
  Value position = getPosition();
  storeHistory(b, carried, buffer, position);
  return buffer;
}

Value AdjointBuilder::recordFor(scf::ForOp primalLoop, unsigned index) {
  // The recomputed loop stands in the frame around, once for all that it
  // records and for its results.
  getPrimal(primalLoop.getResult(index));
  if (hasErrors)
    return {};
  auto loop = cast<scf::ForOp>(current->recomputed.at(primalLoop));
  setInsertionPoint(loop);
  Value count = createTripCount(primalLoop);
  Value &buffer = histories[{primalLoop, current}][index];
  if (buffer)
    return buffer;
  Value zero = arith::ConstantIndexOp::create(*this, 0);
  Value size = createOrFold<arith::MaxSIOp>(count, zero);
  buffer = createHistory(
      *this, loop, loop.getRegionIterArg(index), size, [&]() -> Value {
        Value position = loop.getInductionVar();
        if (!matchPattern(loop.getLowerBound(), m_Zero()))
          position =
              arith::SubIOp::create(*this, position, loop.getLowerBound());
        if (!matchPattern(loop.getStep(), m_One()))
          position = arith::DivSIOp::create(*this, position, loop.getStep());
        if (!position.getType().isIndex())
          position =
              arith::IndexCastOp::create(*this, getIndexType(), position);
        return position;
      });
  return buffer;
}

scf::WhileOp AdjointBuilder::createCountedCopy(scf::WhileOp primalLoop) {
  SmallVector<Value> inits = getPrimals(primalLoop.getInits());
  inits.push_back(arith::ConstantIndexOp::create(*this, 0));
  SmallVector<Type> types(primalLoop.getResultTypes());
  types.push_back(getIndexType());
  auto copy = scf::WhileOp::create(*this, types, inits);
  OpBuilder::InsertionGuard guard(*this);
  for (auto [from, to] :
       llvm::zip(primalLoop->getRegions(), copy->getRegions())) {
    Block *mirror = createBlock(&to);
    for (BlockArgument argument : from.getArguments())
      mirror->addArgument(argument.getType(), argument.getLoc());
    Value count = mirror->addArgument(getIndexType(), getLoc());
    recomputeBlock(&from.front(), mirror);
    Operation *terminator = mirror->getTerminator();
    if (isa<scf::YieldOp>(terminator)) {
      setInsertionPoint(terminator);
      Value one = arith::ConstantIndexOp::create(*this, 1);
      count = arith::AddIOp::create(*this, count, one);
    }
    terminator->insertOperands(terminator->getNumOperands(), count);
  }
  return copy;
}

Value AdjointBuilder::recordWhile(scf::WhileOp primalLoop) {
  // The number of iterations is known after one run; then there is room to
  // record the next.
  Value count = createCountedCopy(primalLoop).getResults().back();
  recordedLoops[{primalLoop, current}] = {createCountedCopy(primalLoop), count};
  return count;
}

Value AdjointBuilder::recordWhile(scf::WhileOp primalLoop, unsigned index) {
  auto [loop, count] = recordedLoops.lookup({primalLoop, current});
  Value &buffer = histories[{primalLoop, current}][index];
  if (buffer)
    return buffer;
  // The condition is evaluated once more than the body runs.
  setInsertionPoint(loop);
  Value one = arith::ConstantIndexOp::create(*this, 1);
  Value size = arith::AddIOp::create(*this, count, one);
  Block::BlockArgListType carried = loop.getBeforeArguments();
  buffer = createHistory(*this, loop, carried[index], size,
                         [&]() -> Value { return carried.back(); });
  return buffer;
}

void AdjointBuilder::materializeArgument(Frame &frame, BlockArgument argument) {
  Operation *parent = frame.primal->getParentOp();
  unsigned index = argument.getArgNumber();
  current = frame.parent;
  Value value;
  if (!frame.argumentValues.empty()) {
    value = getPrimal(frame.argumentValues[index]);
  } else if (frame.iteration) {
    Value buffer;
    if (auto loop = dyn_cast<scf::ForOp>(parent))
      buffer = recordFor(loop, index - loop.getNumInductionVars());
    else
      buffer = recordWhile(cast<scf::WhileOp>(parent), index);
    if (buffer) {
      setInsertionPoint(frame.recomputeBegin);
      value = loadHistory(*this, argument.getType(), buffer, frame.iteration);
    }
  } else {
    emitError(parent, "the gradient needs a value that this op carries, which "
                      "cannot be recomputed");
  }
  current = &frame;
  if (value)
    frame.values.map(argument, value);
}

void AdjointBuilder::freeHistory(Operation *loop) {
  auto it = histories.find({loop, current});
  if (it != histories.end()) {
    for (auto [index, buffer] : it->second)
      memref::DeallocOp::create(*this, buffer);
    histories.erase(it);
  } else if (scf::WhileOp copy = recordedLoops.lookup({loop, current}).copy) {
    copy.erase(); // there was nothing to record
  }
  recordedLoops.erase({loop, current});
}
