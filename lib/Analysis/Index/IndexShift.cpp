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

/// The longest loop that is evaluated index by index, if an expression has no
/// pieces: for longer loops the pass would take more than a millisecond.
static constexpr int64_t kMaxEvaluations = 1 << 16;

/// The largest bound of a loop: no loop over a field has larger bounds.
static constexpr int64_t kFarthest = int64_t(1) << 48;

/// The most linear pieces of an index: even a stencil with its borders has
/// fewer.
static constexpr unsigned kMaxPieces = 32;

/// Returns the number of bits of the integers of `type`; 64 for index.
static unsigned getWidth(Type type) {
  return type.isIndex() ? 64 : type.getIntOrFloatBitWidth();
}

static bool isWord(Type type) {
  return type.isIntOrIndex() && getWidth(type) <= 64;
}

/// True for the integer operations that `evaluateOp` evaluates.
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

/// Returns the result of an operation on constants: the range that upstream
/// infers.
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

/// Evaluates an op like inferResult, but faster, for the operations that occur
/// in most indices; none for other operations.
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

//===----------------------------------------------------------------------===//
// Pieces
//===----------------------------------------------------------------------===//

namespace {
/// The values of one operation in consecutive iterations i, as slope * i +
/// offset. The line holds from the iteration `first` of a LineEvaluator to its
/// `end`, which shrinks until the lines of all operations hold.
struct Line {
  int64_t slope = 0, offset = 0;

  __int128 at(int64_t i) const {
    return static_cast<__int128>(slope) * i + offset;
  }
  bool isConstant() const { return slope == 0; }
};

/// Computes the values of operations as lines (slope and offset) that hold for
/// all iterations of a range; shortens the range where they hold no longer.
class LineEvaluator {
public:
  LineEvaluator(int64_t first, int64_t end) : first(first), end(end) {}

  int64_t getEnd() const { return end; }
  std::optional<Line> evaluate(Operation *op, ArrayRef<Line> operands);

private:
  using Wide = __int128;

  std::optional<Line> make(Wide slope, Wide offset, unsigned width);
  std::optional<Line> combine(const Line &a, int64_t factor, const Line &b,
                              unsigned width) {
    return make(Wide(a.slope) + Wide(factor) * b.slope,
                Wide(a.offset) + Wide(factor) * b.offset, width);
  }
  /// Moves the end of the range to where the line leaves [low, high]. The first
  /// value of the line must be in [low, high].
  void keepWithin(Wide slope, Wide offset, Wide low, Wide high);
  /// Returns the sign of a - b in the first iteration, and moves the end of the
  /// range to where the sign changes.
  int getOrder(const Line &a, const Line &b);
  bool isNegative(const Line &line) { return getOrder(line, Line{0, -1}) <= 0; }
  std::optional<bool> compare(arith::CmpIPredicate predicate, const Line &a,
                              const Line &b);
  std::optional<std::pair<Line, Line>> divide(const Line &a, const Line &b,
                                              bool roundsDown);

  /// Products of numbers with these limits fit 128 bits.
  static constexpr Wide kSteep = Wide(1) << 32, kFar = Wide(1) << 62;

  int64_t first, end;
};
} // namespace

void LineEvaluator::keepWithin(Wide slope, Wide offset, Wide low, Wide high) {
  if (slope == 0)
    return;
  // The value `here` is in [low, high], so dividend and divisor of these
  // quotients have the same sign.
  Wide here = slope * first + offset;
  Wide steps = slope > 0 ? (high - here) / slope : (here - low) / -slope;
  if (steps < Wide(end) - first - 1)
    end = static_cast<int64_t>(first + steps + 1);
}

/// Makes a line of integers of `width` bits: wraps its first value into the
/// range of the type, and moves the end of the range of iterations to where the
/// line would leave that range.
std::optional<Line> LineEvaluator::make(Wide slope, Wide offset,
                                        unsigned width) {
  Wide low = -(Wide(1) << (width - 1)), high = -low - 1;
  Wide here = slope * first + offset;
  if (width < 64) {
    Wide turn = Wide(1) << width;
    Wide rest = ((here - low) % turn + turn) % turn + low;
    offset += rest - here;
    here = rest;
  }
  if (here < low || here > high)
    return std::nullopt;
  keepWithin(slope, offset, low, high);
  if (slope < -kSteep || slope > kSteep || offset < -kFar || offset > kFar)
    return std::nullopt;
  return Line{static_cast<int64_t>(slope), static_cast<int64_t>(offset)};
}

int LineEvaluator::getOrder(const Line &a, const Line &b) {
  Wide slope = Wide(a.slope) - b.slope, offset = Wide(a.offset) - b.offset;
  Wide here = slope * first + offset;
  Wide far = Wide(1) << 100;
  if (here < 0)
    keepWithin(slope, offset, -far, -1);
  else if (here > 0)
    keepWithin(slope, offset, 1, far);
  else
    keepWithin(slope, offset, 0, 0);
  return here < 0 ? -1 : here > 0 ? 1 : 0;
}

std::optional<bool> LineEvaluator::compare(arith::CmpIPredicate predicate,
                                           const Line &a, const Line &b) {
  using P = arith::CmpIPredicate;
  int order = getOrder(a, b);
  switch (predicate) {
  case P::eq:
    return order == 0;
  case P::ne:
    return order != 0;
  case P::slt:
    return order < 0;
  case P::sle:
    return order <= 0;
  case P::sgt:
    return order > 0;
  case P::sge:
    return order >= 0;
  default:
    break;
  }
  // In an unsigned comparison, negative numbers are greater than all others.
  bool isNegativeA = isNegative(a), isNegativeB = isNegative(b);
  if (isNegativeA != isNegativeB)
    order = isNegativeA ? 1 : -1;
  switch (predicate) {
  case P::ult:
    return order < 0;
  case P::ule:
    return order <= 0;
  case P::ugt:
    return order > 0;
  default:
    return order >= 0;
  }
}

/// The quotient and the remainder by a positive constant, rounded towards zero
/// or down.
std::optional<std::pair<Line, Line>>
LineEvaluator::divide(const Line &a, const Line &b, bool roundsDown) {
  if (!b.isConstant() || b.offset <= 0)
    return std::nullopt;
  Wide divisor = b.offset;
  bool isBelow = isNegative(a);
  // A quotient rounded towards zero is rounded up if it is negative.
  Wide shift = isBelow && !roundsDown ? divisor - 1 : 0;
  auto floorDiv = [](Wide x, Wide y) {
    return x / y - (x % y != 0 && x < 0 ? 1 : 0);
  };
  Line quotient;
  if (a.slope % b.offset == 0) {
    quotient.slope = a.slope / b.offset;
    quotient.offset =
        static_cast<int64_t>(floorDiv(Wide(a.offset) + shift, divisor));
  } else {
    Wide number = floorDiv(a.at(first) + shift, divisor);
    keepWithin(a.slope, a.offset, number * divisor - shift,
               (number + 1) * divisor - 1 - shift);
    quotient.offset = static_cast<int64_t>(number);
  }
  std::optional<Line> rest = combine(a, -b.offset, quotient, 64);
  if (!rest)
    return std::nullopt;
  return std::pair(quotient, *rest);
}

std::optional<Line> LineEvaluator::evaluate(Operation *op,
                                            ArrayRef<Line> operands) {
  Type type = op->getResult(0).getType();
  unsigned width = getWidth(type);
  if (llvm::all_of(operands,
                   [](const Line &line) { return line.isConstant(); })) {
    auto numbers = llvm::map_to_vector(
        operands, [](const Line &line) { return line.offset; });
    std::optional<int64_t> value = evaluateOp(op, numbers);
    return value ? std::optional(Line{0, *value}) : std::nullopt;
  }
  const Line &a = operands.front(), &b = operands.back();
  using Result = std::optional<Line>;
  // Unsigned operations agree with signed operations if no operand is negative.
  auto divideUnsigned = [&](bool wantsRest) -> Result {
    if (isNegative(a))
      return std::nullopt;
    auto parts = divide(a, b, /*roundsDown=*/true);
    if (!parts)
      return std::nullopt;
    return wantsRest ? parts->second : parts->first;
  };
  auto divideSigned = [&](bool wantsRest, bool roundsDown) -> Result {
    auto parts = divide(a, b, roundsDown);
    if (!parts)
      return std::nullopt;
    return wantsRest ? parts->second : parts->first;
  };
  return llvm::TypeSwitch<Operation *, Result>(op)
      .Case<arith::IndexCastOp, arith::ExtSIOp, arith::TruncIOp>(
          [&](auto) { return make(a.slope, a.offset, width); })
      .Case<arith::ExtUIOp, arith::IndexCastUIOp>([&](auto) -> Result {
        if (isNegative(a))
          return std::nullopt;
        return make(a.slope, a.offset, width);
      })
      .Case([&](arith::AddIOp) { return combine(a, 1, b, width); })
      .Case([&](arith::SubIOp) { return combine(a, -1, b, width); })
      .Case([&](arith::MulIOp) -> Result {
        if (!a.isConstant() && !b.isConstant())
          return std::nullopt;
        const Line &line = a.isConstant() ? b : a;
        int64_t factor = a.isConstant() ? a.offset : b.offset;
        if (factor < -kSteep || factor > kSteep)
          return std::nullopt;
        return make(Wide(line.slope) * factor, Wide(line.offset) * factor,
                    width);
      })
      .Case([&](arith::SelectOp) -> Result {
        if (!operands[0].isConstant())
          return std::nullopt;
        return operands[0].offset ? operands[1] : operands[2];
      })
      .Case([&](arith::MinSIOp) { return getOrder(a, b) <= 0 ? a : b; })
      .Case([&](arith::MaxSIOp) { return getOrder(a, b) >= 0 ? a : b; })
      .Case([&](arith::CmpIOp cmp) -> Result {
        std::optional<bool> holds = compare(cmp.getPredicate(), a, b);
        return holds ? std::optional(Line{0, *holds ? -1 : 0}) : std::nullopt;
      })
      .Case([&](arith::DivSIOp) { return divideSigned(false, false); })
      .Case([&](arith::RemSIOp) { return divideSigned(true, false); })
      .Case([&](arith::FloorDivSIOp) { return divideSigned(false, true); })
      .Case([&](arith::DivUIOp) { return divideUnsigned(false); })
      .Case([&](arith::RemUIOp) { return divideUnsigned(true); })
      .Default([](Operation *) { return Result(); });
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

  /// Divides [lower, upper) into the pieces on which the expression is linear.
  std::optional<SmallVector<IndexPiece>> getPieces(int64_t lower,
                                                   int64_t upper) {
    SmallVector<IndexPiece> pieces;
    if (lower < -kFarthest || upper > kFarthest)
      return std::nullopt;
    SmallVector<Line> lines(values.size());
    for (auto [line, value] : llvm::zip(lines, values))
      line.offset = value;
    lines[0] = {1, 0};
    SmallVector<Line, 4> operands;
    while (lower < upper) {
      LineEvaluator evaluator(lower, upper);
      for (const Step &step : steps) {
        operands.clear();
        for (unsigned slot : step.operands)
          operands.push_back(lines[slot]);
        std::optional<Line> line = evaluator.evaluate(step.op, operands);
        if (!line)
          return std::nullopt;
        lines[step.slot] = *line;
      }
      Line line = lines[result];
      int64_t end = evaluator.getEnd();
      IndexPiece *last = pieces.empty() ? nullptr : &pieces.back();
      // If the last piece has only one iteration, any slope fits it: give it
      // the slope of the next piece.
      if (last && last->upper - last->lower == 1 &&
          line.at(last->lower) == last->at(last->lower))
        last->slope = line.slope, last->offset = line.offset;
      if (last && last->slope == line.slope && last->offset == line.offset)
        last->upper = end;
      else if (last && end - lower == 1 && line.at(lower) == last->at(lower))
        last->upper = end;
      else
        pieces.push_back({lower, end, line.slope, line.offset});
      if (pieces.size() > kMaxPieces)
        return std::nullopt;
      lower = end;
    }
    return pieces;
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

std::optional<SmallVector<IndexPiece>>
tai::getIndexPieces(Value index, Value variable, int64_t lower, int64_t upper) {
  IndexProgram program(index, variable);
  return program && lower < upper ? program.getPieces(lower, upper)
                                  : std::nullopt;
}

std::optional<ConstantStretch> tai::getConstantStretch(Value condition,
                                                       Value variable,
                                                       int64_t lower,
                                                       int64_t upper) {
  if (upper <= lower)
    return std::nullopt;
  IndexProgram program(condition, variable);
  if (!program)
    return std::nullopt;
  int64_t low = lower + (upper - lower) / 2, high = low + 1;
  if (auto pieces = program.getPieces(lower, upper)) {
    // The condition has different values in adjacent pieces, so the piece that
    // contains `low` is the whole stretch.
    for (const IndexPiece &piece : *pieces)
      if (piece.lower <= low && low < piece.upper)
        return ConstantStretch{piece.lower, piece.upper, piece.offset != 0};
  }
  if (upper - lower > kMaxEvaluations)
    return std::nullopt;
  std::optional<int64_t> answer = program.run(low);
  if (!answer)
    return std::nullopt;
  while (low > lower && program.run(low - 1) == answer)
    --low;
  while (high < upper && program.run(high) == answer)
    ++high;
  return ConstantStretch{low, high, *answer != 0};
}

/// Finds the pieces on which an expression is the variable plus a constant, by
/// evaluating it for each value of the variable. For expressions that
/// `LineEvaluator` does not support; none if there are more than two pieces.
static std::optional<SmallVector<IndexPiece>>
evaluateEach(IndexProgram &program, int64_t lower, int64_t upper) {
  if (upper - lower > kMaxEvaluations)
    return std::nullopt;
  SmallVector<IndexPiece> pieces;
  for (int64_t i = lower; i != upper; ++i) {
    std::optional<int64_t> value = program.run(i);
    if (!value)
      return std::nullopt;
    if (!pieces.empty() && pieces.back().offset == *value - i)
      pieces.back().upper = i + 1;
    else
      pieces.push_back({i, i + 1, 1, *value - i});
    if (pieces.size() > 2)
      return std::nullopt;
  }
  return pieces;
}

std::optional<IndexShift> tai::getIndexShift(Value index, Value variable,
                                             int64_t lower, int64_t upper) {
  int64_t length = upper - lower;
  if (length <= 0)
    return std::nullopt;
  IndexProgram program(index, variable);
  if (!program)
    return std::nullopt;
  auto pieces = program.getPieces(lower, upper);
  if (!pieces)
    pieces = evaluateEach(program, lower, upper);
  if (!pieces || pieces->size() > 2)
    return std::nullopt;
  for (IndexPiece &piece : *pieces) {
    if (piece.upper - piece.lower == 1)
      piece = {piece.lower, piece.upper, 1,
               piece.at(piece.lower) - piece.lower};
    if (piece.slope != 1)
      return std::nullopt;
  }
  IndexShift shift{pieces->front().offset, pieces->size() == 2};
  if (!shift.wraps)
    return shift;
  // The index may have one break only, where it wraps around at the end of the
  // range.
  const IndexPiece &rest = pieces->back();
  if (rest.offset != shift.offset - length || shift.offset < 0 ||
      rest.lower + shift.offset < upper)
    return std::nullopt;
  // The first index must not wrap. A wrapping shift by more than half of the
  // range's length is a smaller shift in the other direction.
  if (lower + shift.offset >= upper)
    return std::nullopt;
  if (2 * shift.offset > length)
    shift.offset -= length;
  return shift;
}
