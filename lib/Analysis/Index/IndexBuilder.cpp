//===- IndexBuilder.cpp - Index expressions of a program ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Index/IndexBuilder.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/IR/Matchers.h"
#include "llvm/Support/MathExtras.h"

using namespace mlir;
using namespace mlir::tai;
using Kind = IndexNode::Kind;

/// The largest depth to which a value is decomposed. Longer chains of
/// operations are unrolled sums, whose expressions have too many terms to be
/// useful.
static constexpr unsigned kMostDepth = 16;
/// The most occurrences of values in an expression: in nested products, their
/// number would grow exponentially.
static constexpr unsigned kMostSize = 64;

static unsigned getWidth(Type type) {
  return type.isIndex() ? 64 : type.getIntOrFloatBitWidth();
}

//===----------------------------------------------------------------------===//
// Ranges
//===----------------------------------------------------------------------===//

/// Ranges are clamped to this magnitude: sums of a few such numbers fit 128
/// bits.
static constexpr __int128 kFar = static_cast<__int128>(1) << 120;

static __int128 clampFar(__int128 number) {
  return std::clamp(number, -kFar, kFar);
}

static __int128 multiplyFar(__int128 a, __int128 b) {
  __int128 product;
  if (__builtin_mul_overflow(a, b, &product))
    return (a < 0) == (b < 0) ? kFar : -kFar;
  return clampFar(product);
}

static IndexRange multiplyRanges(IndexRange a, IndexRange b) {
  __int128 ends[] = {multiplyFar(a.low, b.low), multiplyFar(a.low, b.high),
                     multiplyFar(a.high, b.low), multiplyFar(a.high, b.high)};
  return {*std::min_element(ends, ends + 4), *std::max_element(ends, ends + 4)};
}

static IndexRange addRanges(IndexRange a, IndexRange b) {
  return {clampFar(a.low + b.low), clampFar(a.high + b.high)};
}

static __int128 divideDown(__int128 a, __int128 b) {
  __int128 quotient = a / b;
  return quotient - ((a % b != 0 && (a < 0) != (b < 0)) ? 1 : 0);
}

IndexRange IndexBuilder::getSignedRange(Value value) {
  ConstantIntRanges range = ranges.get(value);
  if (range.smin().getBitWidth() > 64)
    return {-kFar, kFar};
  return {range.smin().getSExtValue(), range.smax().getSExtValue()};
}

IndexRange IndexBuilder::getRange(const IndexAtom &atom) {
  const IndexNode *node = atom.getNode();
  if (!node)
    return getSignedRange(atom.getValue());
  IndexRange a = getRange(node->lhs), b = getRange(node->rhs);
  if (node->kind == Kind::Product)
    return multiplyRanges(a, b);
  // Operations other than products compute with the low 64 bits of their
  // operands: if the range of an operand does not fit, use the whole range of
  // 64 bits.
  constexpr IndexRange all{INT64_MIN, INT64_MAX};
  a = a.fits(64) ? a : all;
  b = b.fits(64) ? b : all;
  switch (node->kind) {
  case Kind::Product:
    break;
  case Kind::Min:
    return {std::min(a.low, b.low), std::min(a.high, b.high)};
  case Kind::Max:
    return {std::max(a.low, b.low), std::max(a.high, b.high)};
  case Kind::Quotient:
  case Kind::TruncatedQuotient: {
    if (b.low <= 0) {
      // The divisor is possibly not positive. The magnitude of a quotient is at
      // most that of the dividend, or 1 where a quotient between -1 and 0 is
      // rounded down.
      __int128 most = std::max({a.high, -a.low, static_cast<__int128>(1)});
      return {-most, most};
    }
    auto divide = [&](__int128 x, __int128 y) {
      return node->kind == Kind::Quotient ? divideDown(x, y) : x / y;
    };
    __int128 ends[] = {divide(a.low, b.low), divide(a.low, b.high),
                       divide(a.high, b.low), divide(a.high, b.high)};
    return {*std::min_element(ends, ends + 4),
            *std::max_element(ends, ends + 4)};
  }
  case Kind::Remainder: {
    IndexRange range{std::min<__int128>(b.low + 1, 0),
                     std::max<__int128>(b.high - 1, 0)};
    if (a.low >= 0 && b.low > 0)
      range.high = std::min(range.high, a.high);
    return range;
  }
  case Kind::TruncatedRemainder: {
    // The divisor may be taken as non-zero: otherwise the remainder is
    // undefined.
    __int128 most = std::max({b.high, -b.low, static_cast<__int128>(1)}) - 1;
    return {a.low < 0 ? std::max(a.low, -most) : 0,
            a.high > 0 ? std::min(a.high, most) : 0};
  }
  }
  llvm_unreachable("all kinds are handled");
}

IndexRange IndexBuilder::getRange(const IndexExpr &expr) {
  IndexRange range{expr.constant, expr.constant};
  for (const auto &[atom, factor] : expr.terms)
    range = addRanges(range, multiplyRanges(getRange(atom), {factor, factor}));
  return range;
}

//===----------------------------------------------------------------------===//
// Quotients
//===----------------------------------------------------------------------===//

IndexBuilder::Parts IndexBuilder::takeMultiples(const IndexExpr &expr,
                                                int64_t divisor) {
  Parts parts;
  for (const auto &[atom, factor] : expr.terms)
    if (factor % divisor == 0)
      parts.multiple.add(IndexExpr(atom), factor / divisor);
    else
      parts.rest.add(IndexExpr(atom), factor);
  parts.multiple.constant = llvm::divideFloorSigned(expr.constant, divisor);
  parts.rest.constant = expr.constant - parts.multiple.constant * divisor;
  // Both sums must fit 64 bits: numbers with equal low bits but different high
  // bits have different quotients.
  IndexRange rest = getRange(parts.rest);
  if (!rest.fits(64) || !getRange(expr).fits(64))
    return {IndexExpr(0), expr, false};
  parts.isDigit = rest.low >= 0 && rest.high < divisor;
  return parts;
}

std::optional<std::pair<IndexExpr, IndexExpr>>
IndexBuilder::split(const IndexExpr &expr, int64_t divisor) {
  Parts parts = takeMultiples(expr, divisor);
  if (!parts.isDigit)
    return std::nullopt;
  return std::pair{std::move(parts.multiple), std::move(parts.rest)};
}

IndexExpr IndexBuilder::getQuotient(const IndexExpr &lhs,
                                    const IndexExpr &rhs) {
  if (!rhs.isConstant() || rhs.constant <= 0)
    return IndexExpr(IndexNode{Kind::Quotient, lhs, rhs});
  auto [multiple, rest, isDigit] = takeMultiples(lhs, rhs.constant);
  if (isDigit)
    return multiple;
  // Dividing a quotient by another divisor is a division by the product of the
  // divisors.
  if (rest.terms.size() == 1 && rest.constant == 0 &&
      rest.terms.front().second == 1) {
    const IndexNode *node = rest.terms.front().first.getNode();
    int64_t product;
    if (node && node->kind == Kind::Quotient && node->rhs.isConstant() &&
        node->rhs.constant > 0 &&
        !llvm::MulOverflow(node->rhs.constant, rhs.constant, product))
      return multiple.add(getQuotient(node->lhs, IndexExpr(product)));
  }
  return multiple.add(IndexExpr(IndexNode{Kind::Quotient, rest, rhs}));
}

IndexExpr IndexBuilder::getRemainder(const IndexExpr &lhs,
                                     const IndexExpr &rhs) {
  if (!rhs.isConstant() || rhs.constant <= 0)
    return IndexExpr(IndexNode{Kind::Remainder, lhs, rhs});
  Parts parts = takeMultiples(lhs, rhs.constant);
  return parts.isDigit ? parts.rest
                       : IndexExpr(IndexNode{Kind::Remainder, parts.rest, rhs});
}

IndexExpr IndexBuilder::getQuotientOf(const IndexNode &rest) {
  if (rest.kind == Kind::Remainder)
    return getQuotient(rest.lhs, rest.rhs);
  return IndexExpr(IndexNode{Kind::TruncatedQuotient, rest.lhs, rest.rhs});
}

IndexExpr IndexBuilder::joinDigits(IndexExpr expr) {
  for (const auto &[atom, factor] : expr.terms) {
    const IndexNode *node = atom.getNode();
    if (!node || !node->isRemainder())
      continue;
    IndexExpr quotient = getQuotientOf(*node);
    IndexExpr multiple;
    if (node->rhs.isConstant())
      multiple.add(quotient, node->rhs.constant);
    else
      multiple = IndexExpr(IndexNode{Kind::Product, node->rhs, quotient});
    bool isThere = llvm::all_of(
        multiple.terms,
        [&, factor = factor](std::pair<IndexAtom, int64_t> term) {
          return !llvm::MulOverflow(factor, term.second, term.second) &&
                 llvm::is_contained(expr.terms, term);
        });
    if (!isThere)
      continue;
    IndexExpr joined = expr;
    unsigned width = expr.width;
    joined.add(IndexExpr(atom), -factor);
    joined.add(multiple, -factor);
    joined.add(node->lhs, factor);
    joined.width = width;
    return joinDigits(std::move(joined));
  }
  return expr;
}

//===----------------------------------------------------------------------===//
// Operations
//===----------------------------------------------------------------------===//

IndexExpr IndexBuilder::limit(IndexExpr expr, Type type,
                              llvm::function_ref<bool()> fits) {
  unsigned width = getWidth(type);
  if (width < 64 && !(expr.isExact() && fits()))
    expr.width = std::min(expr.width, width);
  return expr;
}

template <typename Op> static bool neverWraps(Op op) {
  return bitEnumContainsAny(op.getOverflowFlags(),
                            arith::IntegerOverflowFlags::nsw);
}

std::optional<IndexExpr> IndexBuilder::buildSum(Operation *op, unsigned depth) {
  auto add = dyn_cast<arith::AddIOp>(op);
  auto sub = dyn_cast<arith::SubIOp>(op);
  if (!add && !sub)
    return std::nullopt;
  Value lhs = op->getOperand(0), rhs = op->getOperand(1);
  int64_t sign = add ? 1 : -1;
  IndexExpr a = buildWhole(lhs, depth), b = buildWhole(rhs, depth);
  auto fits = [&] {
    if (add ? neverWraps(add) : neverWraps(sub))
      return true;
    return addRanges(getSignedRange(lhs),
                     multiplyRanges(getSignedRange(rhs), {sign, sign}))
        .fits(getWidth(op->getResult(0).getType()));
  };
  a.add(b, sign);
  return limit(joinDigits(std::move(a)), op->getResult(0).getType(), fits);
}

std::optional<IndexExpr> IndexBuilder::buildProduct(Operation *op,
                                                    unsigned depth) {
  auto mul = dyn_cast<arith::MulIOp>(op);
  if (!mul)
    return std::nullopt;
  Value lhs = mul.getLhs(), rhs = mul.getRhs();
  IndexExpr a = buildWhole(lhs, depth), b = buildWhole(rhs, depth);
  if (a.isConstant())
    std::swap(a, b);
  IndexExpr product;
  product.width = std::min(a.width, b.width);
  if (b.isConstant()) {
    product.add(a, b.constant);
  } else {
    unsigned width = product.width;
    // The factors are exact integers. The width says that only the low bits of
    // their product are kept.
    a.width = b.width = 64;
    product = IndexExpr(IndexNode{Kind::Product, std::move(a), std::move(b)});
    product.width = width;
  }
  auto fits = [&] {
    return neverWraps(mul) ||
           multiplyRanges(getSignedRange(lhs), getSignedRange(rhs))
               .fits(getWidth(mul.getType()));
  };
  return limit(std::move(product), mul.getType(), fits);
}

std::optional<IndexExpr> IndexBuilder::buildCast(Operation *op,
                                                 unsigned depth) {
  if (!isa<arith::IndexCastOp, arith::IndexCastUIOp, arith::ExtSIOp,
           arith::ExtUIOp, arith::TruncIOp>(op))
    return std::nullopt;
  Value from = op->getOperand(0);
  Type to = op->getResult(0).getType();
  if (from.getType().isInteger(1) || to.isInteger(1))
    return std::nullopt;
  bool isUnsigned = isa<arith::IndexCastUIOp, arith::ExtUIOp>(op);
  if (getWidth(to) > getWidth(from.getType())) {
    // Zero-extension of a negative number changes its value.
    if (isUnsigned && getSignedRange(from).low < 0)
      return std::nullopt;
    return build(from, depth);
  }
  IndexExpr expr = build(from, depth);
  if (getWidth(to) == getWidth(from.getType()))
    return expr;
  // Dropping high bits does not change a number that fits the remaining bits.
  if (getSignedRange(from).fits(getWidth(to)))
    return expr;
  expr.width = std::min(expr.width, getWidth(to));
  return expr;
}

std::optional<IndexExpr> IndexBuilder::buildDivision(Operation *op,
                                                     unsigned depth) {
  bool isFloor = isa<arith::FloorDivSIOp>(op);
  bool isQuotient = isFloor || isa<arith::DivSIOp, arith::DivUIOp>(op);
  if (!isQuotient && !isa<arith::RemSIOp, arith::RemUIOp>(op))
    return std::nullopt;
  Value lhs = op->getOperand(0), rhs = op->getOperand(1);
  IndexExpr a = buildExact(lhs, depth), b = buildExact(rhs, depth);
  if (b.isConstant() && b.constant == 0)
    return std::nullopt;
  IndexRange divisor = getSignedRange(rhs);
  // A quotient overflows only if the least number is divided by -1.
  if (divisor.low <= -1 && divisor.high >= -1 &&
      !multiplyRanges(getSignedRange(lhs), {-1, -1})
           .fits(getWidth(lhs.getType())))
    return std::nullopt;
  // If neither operand is negative, rounding towards zero is rounding down.
  if (isFloor || (getSignedRange(lhs).low >= 0 && divisor.low >= 0))
    return isQuotient ? getQuotient(a, b) : getRemainder(a, b);
  if (isa<arith::DivUIOp, arith::RemUIOp>(op))
    return std::nullopt;
  return IndexExpr(
      IndexNode{isQuotient ? Kind::TruncatedQuotient : Kind::TruncatedRemainder,
                std::move(a), std::move(b)});
}

/// Returns `expr` with the bits of `mask` flipped. Each run of ones in the mask
/// selects a digit of the number; flipping subtracts the digit from the largest
/// digit.
static IndexExpr flipBits(IndexBuilder &builder, const IndexExpr &expr,
                          uint64_t mask) {
  if (mask == 0)
    return expr;
  unsigned start = llvm::countr_zero(mask);
  unsigned length = llvm::countr_one(mask >> start);
  IndexExpr low(int64_t(1) << start), values(int64_t(1) << length);
  IndexExpr rest = builder.getQuotient(expr, low);
  IndexExpr flipped(values.constant - 1);
  flipped.add(builder.getRemainder(rest, values), -1);
  IndexExpr above = flipBits(builder, builder.getQuotient(rest, values),
                             mask >> (start + length));
  return builder.getRemainder(expr, low)
      .add(flipped, low.constant)
      .add(above, int64_t(1) << (start + length));
}

/// Decomposes bit operations: shifts by constants, masks of low or high bits by
/// constants, unions of bits that do not overlap, and flips of bits by
/// constants.
std::optional<IndexExpr> IndexBuilder::buildBits(Operation *op,
                                                 unsigned depth) {
  if (!isa<arith::ShLIOp, arith::ShRSIOp, arith::ShRUIOp, arith::AndIOp,
           arith::OrIOp, arith::XOrIOp>(op))
    return std::nullopt;
  Value lhs = op->getOperand(0), rhs = op->getOperand(1);
  Type type = lhs.getType();
  if (isa<arith::OrIOp>(op)) {
    IndexExpr a = buildExact(lhs, depth), b = buildExact(rhs, depth);
    for (auto [high, low] : {std::pair(&a, &b), std::pair(&b, &a)}) {
      auto bits = static_cast<uint64_t>(high->constant);
      for (const auto &[atom, factor] : high->terms)
        bits |= static_cast<uint64_t>(factor);
      IndexRange range = getRange(*low);
      if (range.low >= 0 && range.high < static_cast<__int128>(1)
                                             << llvm::countr_zero(bits))
        return joinDigits(a.add(b));
    }
    return std::nullopt;
  }
  std::optional<int64_t> number = getConstantIntValue(rhs);
  if (!number)
    return std::nullopt;
  if (isa<arith::AndIOp>(op)) {
    int64_t mask = *number < 0 ? ~*number : *number;
    if (mask == INT64_MAX || (mask & (mask + 1)) != 0)
      return std::nullopt;
    IndexExpr all = buildExact(lhs, depth);
    IndexExpr low = getRemainder(all, IndexExpr(mask + 1));
    return *number < 0 ? all.add(low, -1) : low;
  }
  if (isa<arith::XOrIOp>(op)) {
    // For a negative mask m, the identity x ^ m = ~(x ^ ~m) is used.
    int64_t mask = *number < 0 ? ~*number : *number;
    if (mask >= int64_t(1) << 62)
      return std::nullopt;
    IndexExpr flipped =
        joinDigits(flipBits(*this, buildExact(lhs, depth), mask));
    return *number < 0 ? IndexExpr(-1).add(flipped, -1) : flipped;
  }
  if (*number < 0 || *number >= getWidth(type) || *number == 63)
    return std::nullopt;
  int64_t power = int64_t(1) << *number;
  if (auto shift = dyn_cast<arith::ShLIOp>(op)) {
    IndexExpr product = IndexExpr().add(buildWhole(lhs, depth), power);
    return limit(std::move(product), type, [&] {
      return neverWraps(shift) ||
             multiplyRanges(getSignedRange(lhs), {power, power})
                 .fits(getWidth(type));
    });
  }
  if (isa<arith::ShRUIOp>(op) && getSignedRange(lhs).low < 0)
    return std::nullopt;
  return getQuotient(buildExact(lhs, depth), IndexExpr(power));
}

/// True if `condition` implies that `rest`, a remainder that is rounded towards
/// zero, and `divisor` have different signs.
static bool saysSignsDiffer(Value condition, Value rest, Value divisor) {
  auto comparesWithZero = [](Value side, arith::CmpIPredicate predicate) {
    auto compare = side.getDefiningOp<arith::CmpIOp>();
    return compare && compare.getPredicate() == predicate &&
                   matchPattern(compare.getRhs(), m_Zero())
               ? compare.getLhs()
               : Value();
  };
  APInt constant;
  if (matchPattern(divisor, m_ConstantInt(&constant)) &&
      constant.isStrictlyPositive() &&
      comparesWithZero(condition, arith::CmpIPredicate::slt) == rest)
    return true;
  auto both = condition.getDefiningOp<arith::AndIOp>();
  if (!both)
    return false;
  for (auto [first, second] : {std::pair{both.getLhs(), both.getRhs()},
                               std::pair{both.getRhs(), both.getLhs()}}) {
    if (comparesWithZero(first, arith::CmpIPredicate::ne) != rest)
      continue;
    Value bits = comparesWithZero(second, arith::CmpIPredicate::slt);
    auto differ = bits ? bits.getDefiningOp<arith::XOrIOp>() : nullptr;
    if (differ && ((differ.getLhs() == rest && differ.getRhs() == divisor) ||
                   (differ.getLhs() == divisor && differ.getRhs() == rest)))
      return true;
  }
  return false;
}

/// Recognises division that rounds down, written by means of division that
/// rounds towards zero; and resolves selects whose condition is known.
std::optional<IndexExpr> IndexBuilder::buildSelect(Operation *op,
                                                   unsigned depth) {
  auto select = dyn_cast<arith::SelectOp>(op);
  if (!select || !select.getCondition().getType().isInteger(1))
    return std::nullopt;
  Value yes = select.getTrueValue(), no = select.getFalseValue();
  ConstantIntRanges condition = ranges.get(select.getCondition());
  if (std::optional<APInt> outcome = condition.getConstantValue())
    return build(outcome->isZero() ? no : yes, depth);
  Value lhs, rhs, rest;
  bool isQuotient = false;
  if (auto rem = no.getDefiningOp<arith::RemSIOp>()) {
    auto sum = yes.getDefiningOp<arith::AddIOp>();
    lhs = rem.getLhs(), rhs = rem.getRhs(), rest = no;
    if (!sum || !((sum.getLhs() == no && sum.getRhs() == rhs) ||
                  (sum.getLhs() == rhs && sum.getRhs() == no)))
      return std::nullopt;
  } else if (auto div = no.getDefiningOp<arith::DivSIOp>()) {
    // For a quotient q, the other arm of the select must be q - 1, written as a
    // sum or a difference.
    isQuotient = true;
    lhs = div.getLhs(), rhs = div.getRhs();
    APInt number;
    auto sum = yes.getDefiningOp<arith::AddIOp>();
    auto difference = yes.getDefiningOp<arith::SubIOp>();
    bool isLess = (sum && sum.getLhs() == no &&
                   matchPattern(sum.getRhs(), m_ConstantInt(&number)) &&
                   number.isAllOnes()) ||
                  (difference && difference.getLhs() == no &&
                   matchPattern(difference.getRhs(), m_One()));
    if (!isLess)
      return std::nullopt;
    for (Operation *user : lhs.getUsers())
      if (auto rem = dyn_cast<arith::RemSIOp>(user);
          rem && rem.getLhs() == lhs && rem.getRhs() == rhs &&
          saysSignsDiffer(select.getCondition(), rem, rhs))
        rest = rem;
  }
  if (!rest || !saysSignsDiffer(select.getCondition(), rest, rhs))
    return std::nullopt;
  IndexExpr a = buildExact(lhs, depth), b = buildExact(rhs, depth);
  if (b.isConstant() && b.constant == 0)
    return std::nullopt;
  // The quotient is exact: the overflow of the least number divided by -1 is
  // undefined in the program.
  return isQuotient ? getQuotient(a, b) : getRemainder(a, b);
}

std::optional<IndexExpr> IndexBuilder::buildExtreme(Operation *op,
                                                    unsigned depth) {
  bool isMin = isa<arith::MinSIOp>(op);
  if (!isMin && !isa<arith::MaxSIOp>(op))
    return std::nullopt;
  return IndexExpr(IndexNode{isMin ? Kind::Min : Kind::Max,
                             buildExact(op->getOperand(0), depth),
                             buildExact(op->getOperand(1), depth)});
}

IndexExpr IndexBuilder::buildWhole(Value value, unsigned depth) {
  IndexExpr expr = build(value, depth);
  return expr.width >= getWidth(value.getType()) ? expr : IndexExpr(value);
}

IndexExpr IndexBuilder::buildExact(Value value, unsigned depth) {
  IndexExpr expr = build(value, depth);
  return expr.isExact() ? expr : IndexExpr(value);
}

IndexExpr IndexBuilder::build(Value value, unsigned depth) {
  APInt constant;
  if (matchPattern(value, m_ConstantInt(&constant)) &&
      constant.getSignificantBits() <= 64)
    return IndexExpr(constant.getSExtValue());
  Operation *op = value.getDefiningOp();
  Type type = value.getType();
  if (!op || !type.isIntOrIndex() || type.isInteger(1) || getWidth(type) > 64 ||
      (scope && !scope->isProperAncestor(op)))
    return IndexExpr(value);
  if (auto found = known.find(value); found != known.end())
    return found->second;
  if (auto found = cut.find(value); found != cut.end()) {
    isCut = true;
    return found->second;
  }
  if (depth == 0) {
    isCut = true;
    return IndexExpr(value);
  }
  bool wasCut = std::exchange(isCut, false);
  std::optional<IndexExpr> expr;
  for (auto rule : {&IndexBuilder::buildCast, &IndexBuilder::buildSum,
                    &IndexBuilder::buildProduct, &IndexBuilder::buildDivision,
                    &IndexBuilder::buildBits, &IndexBuilder::buildSelect,
                    &IndexBuilder::buildExtreme})
    if ((expr = (this->*rule)(op, depth - 1)))
      break;
  if (!expr || expr->getSize() > kMostSize)
    expr = IndexExpr(value);
  (isCut ? cut : known)[value] = *expr;
  isCut |= wasCut;
  return *expr;
}

IndexExpr IndexBuilder::get(Value value) {
  isCut = false;
  cut.clear();
  return build(value, kMostDepth);
}

SmallVector<IndexExpr> IndexBuilder::get(ValueRange values) {
  return llvm::map_to_vector(values, [&](Value value) { return get(value); });
}

IndexExpr mlir::tai::getIndexExpr(Value value) {
  return IndexBuilder().get(value);
}

SmallVector<IndexExpr> mlir::tai::getIndexExprs(ValueRange values) {
  return IndexBuilder().get(values);
}

static void addSummands(Value index, SmallVectorImpl<IndexSummand> &summands) {
  if (auto cast = index.getDefiningOp<arith::IndexCastOp>())
    return addSummands(cast.getIn(), summands);
  if (auto add = index.getDefiningOp<arith::AddIOp>()) {
    addSummands(add.getLhs(), summands);
    return addSummands(add.getRhs(), summands);
  }
  IndexSummand summand{index, index};
  if (auto product = index.getDefiningOp<arith::MulIOp>())
    if (auto factor = getConstantIntValue(product.getRhs()))
      summand = {index, product.getLhs(), *factor};
  summands.push_back(summand);
}

SmallVector<IndexSummand> mlir::tai::getSummands(Value index) {
  SmallVector<IndexSummand> summands;
  addSummands(index, summands);
  return summands;
}
