//===- IndexShift.cpp - Indices that are shifts of a loop index -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Index/IndexShift.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/InferIntRangeInterface.h"
#include "llvm/ADT/DenseMap.h"
#include "llvm/ADT/SetVector.h"
#include "llvm/ADT/TypeSwitch.h"
#include "llvm/Support/MathExtras.h"

using namespace mlir;
using namespace mlir::tai;

/// Longest loop that is evaluated index by index: beyond it the pass would cost
/// more than a millisecond, and symbolic forms serve such programs.
static constexpr int64_t kMaxEvaluations = 1 << 16;

/// Width of the integers of `type`; index counts as 64 bits.
static unsigned getWidth(Type type) {
  return type.isIndex() ? 64 : type.getIntOrFloatBitWidth();
}

static bool isWord(Type type) {
  return type.isIntOrIndex() && getWidth(type) <= 64;
}

/// True for the operations that `evaluateOp` follows.
static bool isIntegerArithmetic(Operation *op) {
  return isa<arith::ArithDialect>(op->getDialect()) &&
         isa<InferIntRangeInterface>(op) &&
         llvm::all_of(op->getOperandTypes(), isWord) &&
         llvm::all_of(op->getResultTypes(), isWord) && op->getNumResults() == 1;
}

bool tai::collectIndexVariables(Value index, Region &scope,
                                SmallVectorImpl<Value> &variables) {
  SmallVector<Value> pending{index};
  llvm::SmallDenseSet<Value> seen;
  while (!pending.empty()) {
    Value value = pending.pop_back_val();
    if (!seen.insert(value).second ||
        !scope.isAncestor(value.getParentRegion()))
      continue;
    Operation *op = value.getDefiningOp();
    if (!op) {
      variables.push_back(value);
      continue;
    }
    if (matchPattern(value, m_Constant()))
      continue;
    if (!isIntegerArithmetic(op))
      return false;
    llvm::append_range(pending, op->getOperands());
  }
  return true;
}

/// The result of an operation on constants: the range that upstream infers.
static std::optional<int64_t> inferResult(Operation *op,
                                          ArrayRef<int64_t> operands) {
  SmallVector<ConstantIntRanges> ranges;
  for (auto [operand, number] : llvm::zip(op->getOperands(), operands))
    ranges.push_back(ConstantIntRanges::constant(
        APInt(getWidth(operand.getType()), number, /*isSigned=*/true)));
  std::optional<APInt> result;
  cast<InferIntRangeInterface>(op).inferResultRanges(
      ranges, [&](Value, const ConstantIntRanges &range) {
        result = range.getConstantValue();
      });
  return result ? std::optional(result->getSExtValue()) : std::nullopt;
}

/// The same, at once for the operations that most indices are made of.
static std::optional<int64_t> evaluateOp(Operation *op,
                                         ArrayRef<int64_t> operands) {
  Type type = op->getResult(0).getType();
  int64_t a = operands.front(), b = operands.back();
  auto ua = static_cast<uint64_t>(a), ub = static_cast<uint64_t>(b);
  auto wrap = [&](uint64_t value) {
    return llvm::SignExtend64(value, getWidth(type));
  };
  return llvm::TypeSwitch<Operation *, std::optional<int64_t>>(op)
      .Case<arith::IndexCastOp, arith::ExtSIOp, arith::TruncIOp>(
          [&](auto) { return wrap(ua); })
      .Case([&](arith::SelectOp) { return a ? operands[1] : b; })
      .Case([&](arith::AddIOp) { return wrap(ua + ub); })
      .Case([&](arith::SubIOp) { return wrap(ua - ub); })
      .Case([&](arith::MulIOp) { return wrap(ua * ub); })
      .Case([&](arith::MinSIOp) { return std::min(a, b); })
      .Case([&](arith::MaxSIOp) { return std::max(a, b); })
      .Case([&](arith::AndIOp) { return a & b; })
      .Case([&](arith::OrIOp) { return a | b; })
      .Case([&](arith::CmpIOp cmp) {
        return int64_t(arith::applyCmpPredicate(cmp.getPredicate(),
                                                APInt(64, a, /*isSigned=*/true),
                                                APInt(64, b, /*isSigned=*/true))
                           ? -1
                           : 0);
      })
      .Case<arith::DivSIOp, arith::RemSIOp>(
          [&](auto division) -> std::optional<int64_t> {
            if (b == 0 || b == -1)
              return inferResult(division, operands);
            return isa<arith::DivSIOp>(op) ? a / b : a % b;
          })
      .Default([&](Operation *other) { return inferResult(other, operands); });
}

namespace {
/// An expression as a list of operations in order of evaluation, so that it
/// can be evaluated many times.
class IndexProgram {
public:
  IndexProgram(Value index, Value variable) {
    slots[variable] = 0;
    values.push_back(0);
    valid = add(index);
    result = valid ? slots.lookup(index) : 0;
  }

  explicit operator bool() const { return valid; }

  std::optional<int64_t> run(int64_t at) {
    values[0] = at;
    SmallVector<int64_t, 4> operands;
    for (const Step &step : steps) {
      operands.clear();
      for (unsigned slot : step.operands)
        operands.push_back(values[slot]);
      std::optional<int64_t> value = evaluateOp(step.op, operands);
      if (!value)
        return std::nullopt;
      values[step.slot] = *value;
    }
    return values[result];
  }

private:
  struct Step {
    Operation *op;
    SmallVector<unsigned, 3> operands;
    unsigned slot;
  };

  bool add(Value value) {
    if (slots.contains(value))
      return true;
    llvm::APInt constant;
    if (matchPattern(value, m_ConstantInt(&constant))) {
      slots[value] = values.size();
      values.push_back(constant.getSExtValue());
      return true;
    }
    Operation *op = value.getDefiningOp();
    if (!op || !isIntegerArithmetic(op))
      return false;
    Step step{op, {}, 0};
    for (Value operand : op->getOperands()) {
      if (!add(operand))
        return false;
      step.operands.push_back(slots[operand]);
    }
    step.slot = values.size();
    slots[value] = step.slot;
    values.push_back(0);
    steps.push_back(std::move(step));
    return true;
  }

  llvm::DenseMap<Value, unsigned> slots;
  SmallVector<int64_t> values;
  SmallVector<Step> steps;
  unsigned result = 0;
  bool valid = false;
};
} // namespace

std::optional<int64_t> tai::evaluateIndex(Value index, Value variable,
                                          int64_t at) {
  IndexProgram program(index, variable);
  return program ? program.run(at) : std::nullopt;
}

std::optional<ConstantStretch> tai::getConstantStretch(Value condition,
                                                       Value variable,
                                                       int64_t lower,
                                                       int64_t upper) {
  if (upper <= lower || upper - lower > kMaxEvaluations)
    return std::nullopt;
  IndexProgram program(condition, variable);
  int64_t low = lower + (upper - lower) / 2, high = low + 1;
  std::optional<int64_t> answer = program ? program.run(low) : std::nullopt;
  if (!answer)
    return std::nullopt;
  while (low > lower && program.run(low - 1) == answer)
    --low;
  while (high < upper && program.run(high) == answer)
    ++high;
  return ConstantStretch{low, high, *answer != 0};
}

std::optional<IndexShift> tai::getIndexShift(Value index, Value variable,
                                             int64_t lower, int64_t upper) {
  int64_t length = upper - lower;
  if (length <= 0 || length > kMaxEvaluations)
    return std::nullopt;
  IndexProgram program(index, variable);
  if (!program)
    return std::nullopt;

  IndexShift shift;
  for (int64_t i = lower; i != upper; ++i) {
    std::optional<int64_t> value = program.run(i);
    if (!value)
      return std::nullopt;
    int64_t offset = *value - i;
    if (i == lower) {
      shift.offset = offset;
      continue;
    }
    if (offset == shift.offset)
      continue;
    // The one allowed break: the index has run over the end of the range.
    if (offset != shift.offset - length)
      return std::nullopt;
    if (!shift.wraps && shift.offset < 0)
      return std::nullopt;
    if (i + shift.offset < upper)
      return std::nullopt;
    shift.wraps = true;
    // From here on all indices are wrapped: check them against the new offset.
    for (int64_t rest = i + 1; rest != upper; ++rest) {
      std::optional<int64_t> next = program.run(rest);
      if (!next || *next - rest != offset)
        return std::nullopt;
    }
    break;
  }
  if (!shift.wraps)
    return shift;
  // Everything must have landed in the range, and a shift of most of the
  // length is a small one the other way.
  if (lower + shift.offset >= upper)
    return std::nullopt;
  if (2 * shift.offset > length)
    shift.offset -= length;
  return shift;
}
