//===- ControlFlow.cpp - Loops, branches and calls ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Handlers.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include <numeric>

using namespace mlir;
using namespace mlir::tai;
using namespace mlir::tai::interpreter;

static LogicalResult runTerminator(Run &run, Operation *op) {
  run.ended = run.getOperands(op);
  return success();
}

static LogicalResult runFor(Run &run, Operation *op) {
  auto loop = cast<scf::ForOp>(op);
  llvm::APInt at = std::get<llvm::APInt>(run.getNumber(loop.getLowerBound()));
  llvm::APInt end = std::get<llvm::APInt>(run.getNumber(loop.getUpperBound()));
  llvm::APInt step = std::get<llvm::APInt>(run.getNumber(loop.getStep()));
  bool isUnsigned = loop.getUnsignedCmp();
  if (isUnsigned ? step.isZero() : !step.isStrictlyPositive())
    return run.fail(op, "the step of the loop is not positive");
  Data carried;
  for (Value value : loop.getInitArgs())
    carried.push_back(run.get(value));
  while (isUnsigned ? at.ult(end) : at.slt(end)) {
    if (failed(run.passSafepoint()))
      return failure();
    Data arguments{Datum(Number(at))};
    arguments.append(carried);
    if (failed(run.runBlock(*loop.getBody(), arguments)))
      return failure();
    carried = run.ended;
    bool overflows;
    at = isUnsigned ? at.uadd_ov(step, overflows) : at.sadd_ov(step, overflows);
    if (overflows)
      break;
  }
  run.setResults(op, carried);
  return success();
}

static LogicalResult runWhile(Run &run, Operation *op) {
  auto loop = cast<scf::WhileOp>(op);
  Data carried = run.getOperands(op);
  while (true) {
    if (failed(run.passSafepoint()) ||
        failed(run.runBlock(*loop.getBeforeBody(), carried)))
      return failure();
    // scf.condition ends the block with the condition, and the values for the
    // body or the loop's results.
    bool goesOn = isTrue(run.ended.front().numbers.front());
    Data forwarded(run.ended.begin() + 1, run.ended.end());
    if (!goesOn) {
      run.setResults(op, forwarded);
      return success();
    }
    if (failed(run.runBlock(*loop.getAfterBody(), forwarded)))
      return failure();
    carried = run.ended;
  }
}

static LogicalResult runIf(Run &run, Operation *op) {
  auto branch = cast<scf::IfOp>(op);
  Region &taken = isTrue(run.getNumber(branch.getCondition()))
                      ? branch.getThenRegion()
                      : branch.getElseRegion();
  if (taken.empty())
    return success();
  if (failed(run.runBlock(taken.front(), {})))
    return failure();
  run.setResults(op, Data(run.ended));
  return success();
}

static LogicalResult runSwitch(Run &run, Operation *op) {
  auto branch = cast<scf::IndexSwitchOp>(op);
  Region *taken = &branch.getDefaultRegion();
  for (auto [value, region] :
       llvm::zip(branch.getCases(), branch.getCaseRegions()))
    if (value == toIndex(run.getNumber(branch.getArg())))
      taken = &region;
  if (failed(run.runBlock(taken->front(), {})))
    return failure();
  run.setResults(op, Data(run.ended));
  return success();
}

static LogicalResult runCall(Run &run, Operation *op) {
  auto callee = cast<func::FuncOp>(run.program.getCallee(op));
  if (run.draws.calls.size() > 200)
    return run.fail(op, "calls nest too deeply");
  // In a recursive function, each call has its own values.
  llvm::DenseMap<Value, Datum> outer = run.values;
  run.draws.calls.push_back(op);
  Data arguments = run.getOperands(op);
  LogicalResult result = run.runBlock(callee.getBody().front(), arguments);
  run.draws.calls.pop_back();
  run.values = std::move(outer);
  run.setResults(op, Data(run.ended));
  return result;
}

//===----------------------------------------------------------------------===//
// Parallel loops
//===----------------------------------------------------------------------===//

/// Calls iterate(0), iterate(1), ..., or, with a seed, in an order drawn from
/// it.
static LogicalResult forEach(Run &run, int64_t count, bool serial,
                             function_ref<LogicalResult(int64_t)> iterate) {
  if (serial || !run.program.getOptions().orderSeed) {
    for (int64_t i = 0; i < count; ++i)
      if (failed(run.passSafepoint()) || failed(iterate(i)))
        return failure();
    return success();
  }
  std::vector<int64_t> order(std::max<int64_t>(count, 0));
  std::iota(order.begin(), order.end(), 0);
  // A shuffle written out, since std::shuffle may give another order on another
  // machine.
  for (size_t i = order.size(); i > 1; --i)
    std::swap(order[i - 1], order[run.order() % i]);
  for (int64_t i : order)
    if (failed(run.passSafepoint()) || failed(iterate(i)))
      return failure();
  return success();
}

/// scf.parallel promises no order of iterations; with reductions, iterations
/// run in their order, and so do the reductions.
static LogicalResult runScfParallel(Run &run, Operation *op) {
  auto loop = cast<scf::ParallelOp>(op);
  Data reduced;
  for (Value value : loop.getInitVals())
    reduced.push_back(run.get(value));
  SmallVector<int64_t> lower = run.getIndices(loop.getLowerBound()),
                       upper = run.getIndices(loop.getUpperBound()),
                       step = run.getIndices(loop.getStep());
  SmallVector<int64_t> counts;
  int64_t total = 1;
  for (auto [first, last, by] : llvm::zip(lower, upper, step)) {
    if (by <= 0)
      return run.fail(op, "a step of the loop is not positive");
    counts.push_back(last > first ? llvm::divideCeil(uint64_t(last - first), by)
                                  : 0);
    total *= counts.back();
  }
  auto iterate = [&](int64_t number) -> LogicalResult {
    Data arguments(counts.size());
    for (size_t i = counts.size(); i-- > 0; number /= counts[i])
      arguments[i] = fromIndex(lower[i] + number % counts[i] * step[i]);
    if (failed(run.runBlock(*loop.getBody(), arguments)))
      return failure();
    auto reduce = cast<scf::ReduceOp>(loop.getBody()->getTerminator());
    Data values = run.ended;
    for (auto [i, region] : llvm::enumerate(reduce.getReductions())) {
      if (failed(run.runBlock(region.front(), {reduced[i], values[i]})))
        return failure();
      reduced[i] = run.ended.front();
    }
    return success();
  };
  if (failed(forEach(run, total, /*serial=*/!reduced.empty(), iterate)))
    return failure();
  run.setResults(op, reduced);
  return success();
}

static LogicalResult runIteration(Run &run, ParallelForOp loop,
                                  ArrayRef<int64_t> indices, int64_t number) {
  int64_t outer = std::exchange(run.draws.iteration, number);
  run.draws.drawn.clear();
  Data arguments;
  for (int64_t index : indices)
    arguments.push_back(Datum(fromIndex(index)));
  LogicalResult result = run.runBlock(loop.getBody().front(), arguments);
  run.draws.iteration = outer;
  return result;
}

static LogicalResult runBox(Run &run, ParallelForOp loop) {
  SmallVector<int64_t> lower = run.getIndices(loop.getLowerBounds()),
                       upper = run.getIndices(loop.getUpperBounds());
  int64_t total = 1;
  for (auto [first, last] : llvm::zip(lower, upper))
    total *= std::max<int64_t>(last - first, 0);
  return forEach(run, total, loop.getSerialize(), [&](int64_t number) {
    SmallVector<int64_t> indices(lower.size());
    int64_t rest = number;
    for (size_t i = lower.size(); i-- > 0; rest /= upper[i] - lower[i])
      indices[i] = lower[i] + rest % (upper[i] - lower[i]);
    return runIteration(run, loop, indices, number);
  });
}

/// Visits the active cells of the innermost sparse level that the loop covers
/// and, below each cell, all digits of the dense levels.
static LogicalResult runStructFor(Run &run, ParallelForOp loop) {
  const FieldPlace &field = run.getField(loop);
  unsigned levels = field.layout.path.levels.size();
  unsigned last = levels + 1 - loop.getLevel().value_or(1);
  const FieldStorage::SparseLevel *sparse = nullptr;
  for (const auto &candidate : field.storage.sparse)
    if (candidate.level < last)
      sparse = &candidate;

  SmallVector<int64_t> cells{0};
  unsigned first = 0;
  if (sparse) {
    const int64_t *list = nullptr;
    int64_t count =
        tai_rt_active_cells(run.frame, run.getTree(field), sparse->node, &list);
    cells.assign(list, list + count);
    first = sparse->level + 1;
  }
  SmallVector<const IndexDigit *> inner;
  for (const IndexDigit &digit : field.storage.digits)
    if (digit.level >= first && digit.level < last)
      inner.push_back(&digit);
  if (!sparse && !loop.getLevel()) {
    // Random numbers count the elements in the order of memory: dimension by
    // dimension, the dimension with the largest stride first.
    SmallVector<uint64_t> strides(field.layout.shape.size(), UINT64_MAX);
    for (const IndexDigit &digit : field.storage.digits)
      strides[digit.dimension] =
          std::min(strides[digit.dimension], digit.stride);
    llvm::sort(inner, [&](const IndexDigit *a, const IndexDigit *b) {
      return std::tuple(strides[a->dimension], b->dimension, a->divisor) >
             std::tuple(strides[b->dimension], a->dimension, b->divisor);
    });
  }
  int64_t below = 1;
  for (const IndexDigit *digit : inner)
    below *= digit->extent;

  int64_t total = static_cast<int64_t>(cells.size()) * below;
  return forEach(run, total, loop.getSerialize(), [&](int64_t number) {
    SmallVector<int64_t> indices(field.layout.offset);
    int64_t rest = number % below;
    for (const IndexDigit *digit : llvm::reverse(inner)) {
      indices[digit->dimension] += rest % digit->extent * digit->divisor;
      rest /= digit->extent;
    }
    int64_t cell = cells[number / below];
    for (unsigned level = first; level-- > 0;) {
      int64_t count = field.layout.path.levels[level].type.getNumCells();
      for (const IndexDigit &digit : field.storage.digits)
        if (digit.level == level)
          indices[digit.dimension] +=
              cell % count / digit.weight % digit.extent * digit.divisor;
      cell /= count;
    }
    return runIteration(run, loop, indices, number);
  });
}

static LogicalResult runParallelFor(Run &run, Operation *op) {
  auto loop = cast<ParallelForOp>(op);
  // Random numbers that are drawn outside of the loop are counted separately
  // from those in the loop.
  auto outer = std::exchange(run.draws.drawn, {});
  LogicalResult result =
      loop.isStructFor() ? runStructFor(run, loop) : runBox(run, loop);
  run.draws.drawn = std::move(outer);
  return result;
}

void interpreter::addControlFlowHandlers(Handlers &handlers) {
  handlers["func.call"] = runCall;
  handlers["func.return"] = runTerminator;
  handlers["scf.condition"] = runTerminator;
  handlers["scf.for"] = runFor;
  handlers["scf.if"] = runIf;
  handlers["scf.index_switch"] = runSwitch;
  handlers["scf.parallel"] = runScfParallel;
  handlers["scf.reduce"] = runTerminator;
  handlers["scf.reduce.return"] = runTerminator;
  handlers["scf.while"] = runWhile;
  handlers["scf.yield"] = runTerminator;
  handlers["tai.parallel_for"] = runParallelFor;
  handlers["tai.return"] = runTerminator;
  handlers["tai.yield"] = runTerminator;
}
