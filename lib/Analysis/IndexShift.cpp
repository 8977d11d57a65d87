//===- IndexShift.cpp - Indices that are shifts of a loop index -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/IndexShift.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/IR/Matchers.h"
#include "llvm/ADT/DenseMap.h"
#include "llvm/ADT/SetVector.h"
#include "llvm/ADT/TypeSwitch.h"
#include "llvm/Support/MathExtras.h"

using namespace mlir;
using namespace mlir::tai;

/// Longest loop that is evaluated index by index: beyond it the pass would cost
/// more than a millisecond, and symbolic forms serve such programs.
static constexpr int64_t kMaxEvaluations = 1 << 16;

/// True for the operations that `evaluateOp` follows.
static bool isIntegerArithmetic(Operation *op) {
  return isa<arith::IndexCastOp, arith::ExtSIOp, arith::ExtUIOp,
             arith::TruncIOp, arith::AddIOp, arith::SubIOp, arith::MulIOp,
             arith::DivSIOp, arith::RemSIOp, arith::FloorDivSIOp,
             arith::RemUIOp, arith::DivUIOp, arith::MinSIOp, arith::MaxSIOp,
             arith::CmpIOp, arith::SelectOp, arith::AndIOp, arith::OrIOp,
             arith::XOrIOp>(op);
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

/// Width of the integers of `type`; index counts as 64 bits.
static unsigned getWidth(Type type) {
  return type.isIndex() ? 64 : type.getIntOrFloatBitWidth();
}

/// The low bits of `value` as a signed number of the type's width.
static int64_t wrapTo(Type type, int64_t value) {
  return llvm::SignExtend64(static_cast<uint64_t>(value), getWidth(type));
}

static int64_t unsignedOf(Type type, int64_t value) {
  unsigned width = getWidth(type);
  return width == 64
             ? value
             : static_cast<int64_t>(static_cast<uint64_t>(value) &
                                    llvm::maskTrailingOnes<uint64_t>(width));
}

static bool compare(arith::CmpIPredicate predicate, int64_t a, int64_t b) {
  auto ua = static_cast<uint64_t>(a), ub = static_cast<uint64_t>(b);
  switch (predicate) {
  case arith::CmpIPredicate::eq:
    return a == b;
  case arith::CmpIPredicate::ne:
    return a != b;
  case arith::CmpIPredicate::slt:
    return a < b;
  case arith::CmpIPredicate::sle:
    return a <= b;
  case arith::CmpIPredicate::sgt:
    return a > b;
  case arith::CmpIPredicate::sge:
    return a >= b;
  case arith::CmpIPredicate::ult:
    return ua < ub;
  case arith::CmpIPredicate::ule:
    return ua <= ub;
  case arith::CmpIPredicate::ugt:
    return ua > ub;
  case arith::CmpIPredicate::uge:
    return ua >= ub;
  }
  llvm_unreachable("all predicates are handled");
}

/// The result of a binary operation in wide arithmetic, before it is wrapped
/// to the width of its type.
static std::optional<int64_t> evaluateBinary(Operation *op, int64_t a,
                                             int64_t b) {
  using Wide = uint64_t; // wraps without undefined behaviour
  bool divides = isa<arith::DivSIOp, arith::RemSIOp, arith::FloorDivSIOp,
                     arith::DivUIOp, arith::RemUIOp>(op);
  if (divides && (b == 0 || (b == -1 && a == INT64_MIN)))
    return std::nullopt;
  Type type = op->getOperand(0).getType();
  return llvm::TypeSwitch<Operation *, std::optional<int64_t>>(op)
      .Case([&](arith::AddIOp) { return int64_t(Wide(a) + Wide(b)); })
      .Case([&](arith::SubIOp) { return int64_t(Wide(a) - Wide(b)); })
      .Case([&](arith::MulIOp) { return int64_t(Wide(a) * Wide(b)); })
      .Case([&](arith::DivSIOp) { return a / b; })
      .Case([&](arith::RemSIOp) { return a % b; })
      .Case([&](arith::FloorDivSIOp) { return llvm::divideFloorSigned(a, b); })
      .Case([&](arith::DivUIOp) {
        return int64_t(Wide(unsignedOf(type, a)) / Wide(unsignedOf(type, b)));
      })
      .Case([&](arith::RemUIOp) {
        return int64_t(Wide(unsignedOf(type, a)) % Wide(unsignedOf(type, b)));
      })
      .Case([&](arith::MinSIOp) { return std::min(a, b); })
      .Case([&](arith::MaxSIOp) { return std::max(a, b); })
      .Case([&](arith::AndIOp) { return a & b; })
      .Case([&](arith::OrIOp) { return a | b; })
      .Case([&](arith::XOrIOp) { return a ^ b; })
      .Case([&](arith::CmpIOp cmp) {
        return int64_t(compare(cmp.getPredicate(), a, b) ? -1 : 0);
      })
      .Default([](Operation *) { return std::nullopt; });
}

static std::optional<int64_t> evaluateOp(Operation *op,
                                         ArrayRef<int64_t> operands) {
  Type type = op->getResult(0).getType();
  if (isa<arith::SelectOp>(op))
    return operands[0] ? operands[1] : operands[2];
  if (isa<arith::IndexCastOp, arith::ExtSIOp, arith::TruncIOp>(op))
    return wrapTo(type, operands[0]);
  if (isa<arith::ExtUIOp>(op))
    return unsignedOf(op->getOperand(0).getType(), operands[0]);
  std::optional<int64_t> result = evaluateBinary(op, operands[0], operands[1]);
  if (result)
    *result = wrapTo(type, *result);
  return result;
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
    if (!op || !isIntegerArithmetic(op) || !value.getType().isIntOrIndex())
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
