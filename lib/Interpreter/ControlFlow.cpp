//===- ControlFlow.cpp - Loops, branches and calls ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Program.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include <numeric>

using namespace mlir;
using namespace mlir::tai;
using namespace mlir::tai::interpreter;

Data Run::getOperands(Operation *terminator) {
  Data operands;
  for (Value operand : terminator->getOperands())
    operands.push_back(get(operand));
  return operands;
}

void Run::setResults(Operation *op, const Data &results) {
  for (auto [result, datum] : llvm::zip(op->getResults(), results))
    set(result, datum);
}

LogicalResult Run::runTerminator(Operation *op) {
  ended = getOperands(op);
  return success();
}

LogicalResult Run::runFor(Operation *op) {
  auto loop = cast<scf::ForOp>(op);
  llvm::APInt at = std::get<llvm::APInt>(getNumber(loop.getLowerBound()));
  llvm::APInt end = std::get<llvm::APInt>(getNumber(loop.getUpperBound()));
  llvm::APInt step = std::get<llvm::APInt>(getNumber(loop.getStep()));
  bool isUnsigned = loop.getUnsignedCmp();
  if (isUnsigned ? step.isZero() : !step.isStrictlyPositive())
    return fail(op, "the step of the loop is not positive");
  Data carried;
  for (Value value : loop.getInitArgs())
    carried.push_back(get(value));
  while (isUnsigned ? at.ult(end) : at.slt(end)) {
    if (failed(passSafepoint()))
      return failure();
    Data arguments{Datum(Number(at))};
    arguments.append(carried);
    if (failed(runBlock(*loop.getBody(), arguments)))
      return failure();
    carried = ended;
    bool overflows;
    at = isUnsigned ? at.uadd_ov(step, overflows) : at.sadd_ov(step, overflows);
    if (overflows)
      break;
  }
  setResults(op, carried);
  return success();
}

LogicalResult Run::runWhile(Operation *op) {
  auto loop = cast<scf::WhileOp>(op);
  Data carried = getOperands(op);
  while (true) {
    if (failed(passSafepoint()) ||
        failed(runBlock(*loop.getBeforeBody(), carried)))
      return failure();
    // The condition, and what both the body and the results get.
    bool goesOn = isTrue(ended.front().numbers.front());
    Data forwarded(ended.begin() + 1, ended.end());
    if (!goesOn) {
      setResults(op, forwarded);
      return success();
    }
    if (failed(runBlock(*loop.getAfterBody(), forwarded)))
      return failure();
    carried = ended;
  }
}

LogicalResult Run::runIf(Operation *op) {
  auto branch = cast<scf::IfOp>(op);
  Region &taken = isTrue(getNumber(branch.getCondition()))
                      ? branch.getThenRegion()
                      : branch.getElseRegion();
  if (taken.empty())
    return success();
  if (failed(runBlock(taken.front(), {})))
    return failure();
  setResults(op, Data(ended));
  return success();
}

LogicalResult Run::runSwitch(Operation *op) {
  auto branch = cast<scf::IndexSwitchOp>(op);
  Region *taken = &branch.getDefaultRegion();
  for (auto [value, region] :
       llvm::zip(branch.getCases(), branch.getCaseRegions()))
    if (value == toIndex(getNumber(branch.getArg())))
      taken = &region;
  if (failed(runBlock(taken->front(), {})))
    return failure();
  setResults(op, Data(ended));
  return success();
}

LogicalResult Run::runCall(Operation *op) {
  auto callee = cast<func::FuncOp>(program.getCallee(op));
  if (calls.size() > 200)
    return fail(op, "calls nest too deeply");
  // A function that calls itself has values of its own in each call.
  llvm::DenseMap<Value, Datum> outer = values;
  calls.push_back(op);
  Data arguments = getOperands(op);
  LogicalResult result = runBlock(callee.getBody().front(), arguments);
  calls.pop_back();
  values = std::move(outer);
  setResults(op, Data(ended));
  return result;
}

/// Of loops over arrays: no order is promised, and reductions take the values
/// in that of the iterations.
LogicalResult Run::runScfParallel(Operation *op) {
  auto loop = cast<scf::ParallelOp>(op);
  Data reduced;
  for (Value value : loop.getInitVals())
    reduced.push_back(get(value));
  SmallVector<int64_t> lower = getIndices(loop.getLowerBound()),
                       upper = getIndices(loop.getUpperBound()),
                       step = getIndices(loop.getStep());
  SmallVector<int64_t> counts;
  int64_t total = 1;
  for (auto [first, last, by] : llvm::zip(lower, upper, step)) {
    if (by <= 0)
      return fail(op, "a step of the loop is not positive");
    counts.push_back(last > first ? llvm::divideCeil(uint64_t(last - first), by)
                                  : 0);
    total *= counts.back();
  }
  auto iterate = [&](int64_t number) -> LogicalResult {
    Data arguments(counts.size());
    for (size_t i = counts.size(); i-- > 0; number /= counts[i])
      arguments[i] = fromIndex(lower[i] + number % counts[i] * step[i]);
    if (failed(runBlock(*loop.getBody(), arguments)))
      return failure();
    auto reduce = cast<scf::ReduceOp>(loop.getBody()->getTerminator());
    Data values = ended;
    for (auto [i, region] : llvm::enumerate(reduce.getReductions())) {
      if (failed(runBlock(region.front(), {reduced[i], values[i]})))
        return failure();
      reduced[i] = ended.front();
    }
    return success();
  };
  if (failed(forEach(total, /*serial=*/!reduced.empty(), iterate)))
    return failure();
  setResults(op, reduced);
  return success();
}

//===----------------------------------------------------------------------===//
// Parallel loops
//===----------------------------------------------------------------------===//

LogicalResult Run::forEach(int64_t count, bool serial,
                           function_ref<LogicalResult(int64_t)> iterate) {
  if (serial || !program.getOptions().orderSeed) {
    for (int64_t i = 0; i < count; ++i)
      if (failed(passSafepoint()) || failed(iterate(i)))
        return failure();
    return success();
  }
  std::vector<int64_t> order(std::max<int64_t>(count, 0));
  std::iota(order.begin(), order.end(), 0);
  // The same on every machine, which std::shuffle does not promise.
  for (size_t i = order.size(); i > 1; --i)
    std::swap(order[i - 1], order[random() % i]);
  for (int64_t i : order)
    if (failed(passSafepoint()) || failed(iterate(i)))
      return failure();
  return success();
}

LogicalResult Run::runIteration(ParallelForOp loop, ArrayRef<int64_t> indices,
                                int64_t number) {
  int64_t outer = std::exchange(iteration, number);
  draws.clear();
  Data arguments;
  for (int64_t index : indices)
    arguments.push_back(Datum(fromIndex(index)));
  LogicalResult result = runBlock(loop.getBody().front(), arguments);
  iteration = outer;
  return result;
}

LogicalResult Run::runParallelFor(Operation *op) {
  auto loop = cast<ParallelForOp>(op);
  // Draws outside the loop are counted apart from those within.
  auto outer = std::exchange(draws, {});
  LogicalResult result = loop.isStructFor() ? runStructFor(loop) : runBox(loop);
  draws = std::move(outer);
  return result;
}

LogicalResult Run::runBox(ParallelForOp loop) {
  SmallVector<int64_t> lower = getIndices(loop.getLowerBounds()),
                       upper = getIndices(loop.getUpperBounds());
  int64_t total = 1;
  for (auto [first, last] : llvm::zip(lower, upper))
    total *= std::max<int64_t>(last - first, 0);
  return forEach(total, loop.getSerialize(), [&](int64_t number) {
    SmallVector<int64_t> indices(lower.size());
    int64_t rest = number;
    for (size_t i = lower.size(); i-- > 0; rest /= upper[i] - lower[i])
      indices[i] = lower[i] + rest % (upper[i] - lower[i]);
    return runIteration(loop, indices, number);
  });
}

/// Goes over the active cells of the innermost sparse level that is looped over
/// and, below each, over the digits of the dense levels.
LogicalResult Run::runStructFor(ParallelForOp loop) {
  const FieldPlace &field = getField(loop);
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
        tai_rt_active_cells(frame, getTree(field), sparse->node, &list);
    cells.assign(list, list + count);
    first = sparse->level + 1;
  }
  SmallVector<const IndexDigit *> inner;
  for (const IndexDigit &digit : field.storage.digits)
    if (digit.level >= first && digit.level < last)
      inner.push_back(&digit);
  if (!sparse && !loop.getLevel()) {
    // Random numbers count the elements in the order of memory: dimension by
    // dimension, that with the largest stride first.
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
  return forEach(total, loop.getSerialize(), [&](int64_t number) {
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
    return runIteration(loop, indices, number);
  });
}
