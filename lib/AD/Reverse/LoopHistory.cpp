//===- LoopHistory.cpp - Loop-carried values, in reverse ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Recovers the carried values at the start of each iteration in reverse. They
// cannot be recomputed from the iteration alone. Nothing is done for carried
// values that no rule needs.
//
//===----------------------------------------------------------------------===//

#include "tai/AD/Reverse/LoopHistory.h"
#include "LoopRemarks.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/IR/Matchers.h"

using namespace mlir;
using namespace mlir::tai;

LoopHistory::LoopHistory(AdjointBuilder &builder, scf::ForOp loop, Value count)
    : b(builder), loop(loop), around(builder.getFrame()), carried(loop),
      count(count), trajectory(builder, loop) {}

LoopHistory::LoopHistory(AdjointBuilder &builder, scf::WhileOp loop)
    : b(builder), loop(loop), around(builder.getFrame()), carried(loop),
      trajectory(builder, loop) {
  if (b.isRecordedLoop(loop)) {
    count = b.fetchCount(loop);
    return;
  }
  counted = createCopy(/*counted=*/true);
  count = counted.getResults().back();
}

/// Copies the loop to the insertion point; `counted` adds a last carried value
/// that counts how often the second region runs.
scf::WhileOp LoopHistory::createCopy(bool counted) {
  auto primal = cast<scf::WhileOp>(loop);
  SmallVector<Value> inits = b.getPrimals(primal.getInits());
  SmallVector<Type> types(primal.getResultTypes());
  if (counted) {
    inits.push_back(arith::ConstantIndexOp::create(b, 0));
    types.push_back(b.getIndexType());
  }
  auto copy = scf::WhileOp::create(b, types, inits);
  OpBuilder::InsertionGuard guard(b);
  for (auto [from, to] : llvm::zip(loop->getRegions(), copy->getRegions())) {
    Block *mirror = b.createBlock(&to);
    for (BlockArgument argument : from.getArguments())
      mirror->addArgument(argument.getType(), argument.getLoc());
    Value number;
    if (counted)
      number = mirror->addArgument(b.getIndexType(), b.getLoc());
    b.recomputeBlock(&from.front(), mirror);
    if (!counted)
      continue;
    Operation *terminator = mirror->getTerminator();
    if (isa<scf::YieldOp>(terminator)) {
      b.setInsertionPoint(terminator);
      Value one = arith::ConstantIndexOp::create(b, 1);
      number = arith::AddIOp::create(b, number, one);
    }
    terminator->insertOperands(terminator->getNumOperands(), number);
  }
  return copy;
}

/// The loop that runs the iterations again: the loop that was recomputed in the
/// frame around, or, if the iterations had to be counted, a for loop over their
/// number. Its results are the carried values after the last iteration.
scf::ForOp LoopHistory::getForward() {
  if (forward)
    return forward;
  OpBuilder::InsertionGuard guard(b);
  auto scope = b.enter(around);
  if (!counted) {
    b.getPrimal(loop->getResult(0));
    if (!b.hasFailed()) {
      forward = cast<scf::ForOp>(around.recomputed.at(loop));
      trajectory.setForward(forward, count);
    }
    return forward;
  }
  Location loc = b.getLoc();
  b.setLoc(loop->getLoc());
  b.setInsertionPointAfter(counted);
  scf::WhileOp copy = createCopy(/*counted=*/false);
  Value zero = arith::ConstantIndexOp::create(b, 0);
  Value one = arith::ConstantIndexOp::create(b, 1);
  forward = scf::ForOp::create(b, zero, count, one, copy.getInits());
  // The number of iterations has been counted, so the condition of the
  // scf.while holds in each iteration, and the body runs.
  Block *body = forward.getBody();
  if (!body->empty())
    body->back().erase();
  scf::ConditionOp condition = copy.getConditionOp();
  SmallVector<Value> passed(condition.getArgs());
  for (auto [from, to] :
       llvm::zip(copy.getBeforeArguments(), forward.getRegionIterArgs()))
    from.replaceAllUsesWith(to);
  for (Value &value : passed)
    if (auto argument = dyn_cast<BlockArgument>(value);
        argument && argument.getOwner() == copy.getBeforeBody())
      value = forward.getRegionIterArg(argument.getArgNumber());
  condition.erase();
  body->getOperations().splice(body->end(),
                               copy.getBeforeBody()->getOperations());
  for (auto [from, to] : llvm::zip(copy.getAfterArguments(), passed))
    from.replaceAllUsesWith(to);
  body->getOperations().splice(body->end(),
                               copy.getAfterBody()->getOperations());
  copy->erase();
  b.setLoc(loc);
  trajectory.setForward(forward, count);
  return forward;
}

BlockArgument LoopHistory::getArgument(unsigned index) const {
  if (auto forOp = dyn_cast<scf::ForOp>(loop))
    return forOp.getRegionIterArg(index);
  return cast<scf::WhileOp>(loop).getBeforeArguments()[index];
}

Value LoopHistory::getCarried(Frame &frame, unsigned index) {
  const CarriedValue &value = carried[index];
  if (value.kind == CarriedKind::ClosedForm && !b.getPlan().recordsAll()) {
    closed.insert(index);
    return createClosedForm(frame, value, index);
  }
  if (!getForward())
    return {};
  // After the last iteration, carried values are the results of the forward
  // loop.
  if (frame.iteration == count)
    return forward.getResult(index);
  if (value.kind == CarriedKind::Invertible && !b.getPlan().recordsAll()) {
    inverted.insert(index);
    return createInverse(frame, value);
  }
  return trajectory.load(frame, index, draft);
}

/// The primal value of an operand of an update step, computed at the very start
/// of the reversed iteration: before all values that the sweep recomputes
/// there.
Value LoopHistory::getEarly(Frame &frame, Value value) {
  value = b.getPlan().local.resolve(value);
  if (!loop->isAncestor(value.getParentBlock()->getParentOp()))
    return b.getPrimal(value);
  if (std::optional<unsigned> index = carried.getIndex(value)) {
    auto scope = b.enter(frame);
    return b.getPrimal(getArgument(*index));
  }
  if (isa<BlockArgument>(value)) // the induction variable
    return frame.values.lookup(value);
  Operation *op = value.getDefiningOp();
  IRMapping mapping;
  for (Value operand : op->getOperands())
    mapping.map(operand, getEarly(frame, operand));
  b.setInsertionPoint(frame.recomputeBegin);
  return b.clone(*op, mapping)
      ->getResult(cast<OpResult>(value).getResultNumber());
}

Value LoopHistory::createClosedForm(Frame &frame, const CarriedValue &value,
                                    unsigned index) {
  const auto &[op, operand, factor] = value.steps.front();
  Value init = b.getPrimal(isa<scf::ForOp>(loop)
                               ? cast<scf::ForOp>(loop).getInitArgs()[index]
                               : cast<scf::WhileOp>(loop).getInits()[index]);
  Value by = getEarly(frame, op->getOperand(1 - operand));
  b.setInsertionPoint(frame.recomputeBegin);
  Type type = init.getType();
  Value times = frame.iteration;
  if (isa<arith::XOrIOp>(op))
    times =
        arith::AndIOp::create(b, times, arith::ConstantIndexOp::create(b, 1));
  if (!type.isIndex())
    times = arith::IndexCastOp::create(b, type, times);
  Value change =
      matchPattern(by, m_One()) ? times : arith::MulIOp::create(b, times, by);
  if (isa<arith::XOrIOp>(op))
    return arith::XOrIOp::create(b, init, change);
  if (isa<arith::SubIOp>(op))
    return arith::SubIOp::create(b, init, change);
  return b.createOrFold<arith::AddIOp>(init, change);
}

/// Returns the value, at the start of the next iteration, of the carried value
/// number `index`.
Value LoopHistory::getNext(unsigned index) {
  BlockArgument &next = nexts[index];
  if (!next)
    next = draft.loop.getBody()->addArgument(getArgument(index).getType(),
                                             loop->getLoc());
  return next;
}

/// Returns the inverse of the odd number `value` modulo 2^n, where n is its
/// width.
static APInt invertOdd(const APInt &value) {
  APInt inverse = value; // correct in 3 bits; each step doubles them
  APInt two(value.getBitWidth(), 2, false, /*implicitTrunc=*/true);
  for (unsigned bits = 3; bits < value.getBitWidth(); bits *= 2)
    inverse *= two - value * inverse;
  return inverse;
}

Value LoopHistory::createInverse(Frame &frame, const CarriedValue &value) {
  Value result = getNext(value.source);
  for (const auto &[op, operand, factor] : llvm::reverse(value.steps)) {
    Value other;
    if (op->getNumOperands() == 2 && !factor)
      other = getEarly(frame, op->getOperand(1 - operand));
    b.setInsertionPoint(frame.recomputeBegin);
    if (isa<arith::AddIOp>(op)) {
      result = arith::SubIOp::create(b, result, other);
    } else if (isa<arith::SubIOp>(op)) {
      result = operand == 0
                   ? arith::AddIOp::create(b, result, other).getResult()
                   : arith::SubIOp::create(b, other, result).getResult();
    } else if (isa<arith::XOrIOp>(op)) {
      result = arith::XOrIOp::create(b, result, other);
    } else if (factor) {
      TypedAttr attr = b.getIntegerAttr(getElementTypeOrSelf(result.getType()),
                                        invertOdd(*factor));
      if (auto vector = dyn_cast<VectorType>(result.getType()))
        attr = DenseElementsAttr::get(vector, Attribute(attr));
      result =
          arith::MulIOp::create(b, result, arith::ConstantOp::create(b, attr));
    } else {
      result = arith::NegFOp::create(b, result);
    }
  }
  return result;
}

scf::ForOp LoopHistory::createReverse(ValueRange inits) {
  Value zero = arith::ConstantIndexOp::create(b, 0);
  Value one = arith::ConstantIndexOp::create(b, 1);
  draft.loop = scf::ForOp::create(b, zero, count, one, inits);
  if (!draft.loop.getBody()->empty())
    draft.loop.getBody()->back().erase();
  draft.inits.assign(inits.begin(), inits.end());
  return draft.loop;
}

void LoopHistory::beginIteration(Frame &frame) {
  Value zero = arith::ConstantIndexOp::create(b, 0);
  Value one = arith::ConstantIndexOp::create(b, 1);
  draft.last = arith::SubIOp::create(b, count, one);
  draft.local = arith::SubIOp::create(b, draft.last->getResult(0),
                                      draft.loop.getInductionVar());
  draft.iteration = arith::AddIOp::create(b, draft.local->getResult(0), zero);
  frame.iteration = draft.iteration->getResult(0);
  frame.history = this;
}

void LoopHistory::beginLast(Frame &frame) {
  frame.iteration = count;
  frame.history = this;
}

void LoopHistory::endIteration() {
  if (b.getPlan().recordsAll())
    for (unsigned i = 0, e = static_cast<unsigned>(carried.size()); i != e; ++i)
      b.getPrimal(getArgument(i));
  // This loop must count on `nexts` growing: `getPrimal` may add entries to it.
  for (size_t i = 0; i != nexts.size(); ++i)
    nextYields.push_back(
        b.getPrimal(getArgument(nexts.getArrayRef()[i].first)));
}

ResultRange LoopHistory::close(ArrayRef<Value> yields,
                               const llvm::MapVector<Value, Value> &captured) {
  size_t own = draft.inits.size();
  SmallVector<Value> inits(draft.inits), all(yields);
  trajectory.record();
  for (auto [index, next] : nexts)
    inits.push_back(forward.getResult(index));
  llvm::append_range(all, nextYields);
  {
    OpBuilder::InsertionGuard guard(b);
    Block *body = draft.loop.getBody();
    for (auto &[value, adjoint] : captured) {
      b.setInsertionPoint(draft.loop);
      inits.push_back(b.createZero(value.getType()));
      Value sum = body->addArgument(value.getType(), value.getLoc());
      b.setInsertionPointToEnd(body);
      all.push_back(arith::AddFOp::create(b, sum, adjoint));
    }
  }
  scf::ForOp reverse = trajectory.createReverse(draft, inits, all);
  draft.loop.erase();
  for (auto [entry, result] :
       llvm::zip(captured, reverse.getResults().drop_front(own + nexts.size())))
    b.addAdjoint(entry.first, result);
  trajectory.release();
  b.countCarried(static_cast<int64_t>(carried.size()),
                 static_cast<int64_t>(trajectory.size()));
  // No remarks for the stored form of the adjoint: the plain form has emitted
  // them.
  if (loop->getContext()->getRemarkEngine() && !b.getPlan().options.loadsStored)
    remarkReversedLoop(summarize());
  return reverse.getResults().take_front(own);
}

StringRef LoopHistory::classify(unsigned index) const {
  if (trajectory.isRecorded(index))
    return "trajectory";
  if (inverted.contains(index))
    return "invertible";
  if (closed.contains(index))
    return "closed form";
  return b.isActive(getArgument(index)) ? "linear" : "not needed";
}

ReversedLoop LoopHistory::summarize() {
  ReversedLoop summary;
  summary.loop = loop;
  FunctionOpInterface function = b.getPlan().primal;
  summary.function = function.getName();
  APInt trips;
  if (!counted)
    summary.trips = matchPattern(count, m_ConstantInt(&trips))
                        ? llvm::toString(trips, 10, /*Signed=*/true)
                        : "known when the loop begins";
  if (trajectory.size() != 0)
    summary.bytesPerIteration = trajectory.getBytesPerIteration();
  if (trajectory.isChunked())
    summary.chunkedFrom =
        std::max(b.getPlan().options.historyBytes, summary.bytesPerIteration);
  for (unsigned i = 0; i != carried.size(); ++i)
    summary.carried.push_back(
        {getArgument(i), classify(i), trajectory.isKeptByChunks(i)});
  return summary;
}
