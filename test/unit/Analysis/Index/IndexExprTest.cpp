//===- IndexExprTest.cpp - Index expressions against enumeration ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Random index arithmetic (see IndexPrograms.h). Each answer of the queries
// must hold for the values of the program. The tests also count the answers,
// because an analysis without any answers would pass.
//
//===----------------------------------------------------------------------===//

#include "IndexPrograms.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Analysis/Index/IndexShift.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
class IndexExprTest : public IndexPrograms {};

using ValueOf = llvm::function_ref<int64_t(Value)>;

std::optional<int64_t> evaluate(const IndexExpr &expr, ValueOf valueOf);

/// The low 64 bits of a node; nothing if it divides by zero.
std::optional<int64_t> evaluate(const IndexNode &node, ValueOf valueOf) {
  using Kind = IndexNode::Kind;
  std::optional<int64_t> a = evaluate(node.lhs, valueOf);
  std::optional<int64_t> b = evaluate(node.rhs, valueOf);
  if (!a || !b)
    return std::nullopt;
  if (node.isDivision() && (*b == 0 || (*a == INT64_MIN && *b == -1)))
    return std::nullopt;
  switch (node.kind) {
  case Kind::Product:
    return static_cast<int64_t>(static_cast<uint64_t>(*a) *
                                static_cast<uint64_t>(*b));
  case Kind::Min:
    return std::min(*a, *b);
  case Kind::Max:
    return std::max(*a, *b);
  case Kind::Quotient:
    return llvm::divideFloorSigned(*a, *b);
  case Kind::Remainder:
    return *a - llvm::divideFloorSigned(*a, *b) * *b;
  case Kind::TruncatedQuotient:
    return *a / *b;
  case Kind::TruncatedRemainder:
    return *a % *b;
  }
  llvm_unreachable("all kinds are handled");
}

std::optional<int64_t> evaluate(const IndexExpr &expr, ValueOf valueOf) {
  auto sum = static_cast<uint64_t>(expr.constant);
  for (const auto &[atom, factor] : expr.terms) {
    std::optional<int64_t> value = atom.getNode()
                                       ? evaluate(*atom.getNode(), valueOf)
                                       : valueOf(atom.getValue());
    if (!value)
      return std::nullopt;
    sum += static_cast<uint64_t>(factor) * static_cast<uint64_t>(*value);
  }
  return llvm::SignExtend64(sum, expr.width);
}

} // namespace

TEST_F(IndexExprTest, AgreeWithEnumeration) {
  int exact = 0, wrapped = 0, distinct = 0, equal = 0, injective = 0, apart = 0;
  int evaluated = 0;
  for (int round = 0; round != 4000; ++round) {
    int64_t lower0 = chance(70) ? 0 : pick(-4, 4), lower1 = pick(-2, 2);
    start(lower0, lower0 + pick(2, 8), lower1, lower1 + pick(1, 4));
    pool.clear();
    SmallVector<Value, 2> roots;
    for (int k = 0; k != 2; ++k)
      roots.push_back(randomValue(chance(50) ? b.getIndexType() : randomType(),
                                  pick(1, 4)));
    IndexBuilder builder;
    IntegerRanges ranges;
    SmallVector<IndexExpr> exprs = builder.get(roots);
    bool isEqual = exprs[0] == exprs[1] && roots[0] != roots[1] &&
                   roots[0].getType() == roots[1].getType();
    bool isDistinct = areDistinct(exprs[0], exprs[1]);
    SmallVector<Value> ivs(loop.getInductionVars());
    if (upper[1] - lower[1] == 1)
      ivs.pop_back();
    bool isInjective = isInjectiveOver(builder, exprs, ivs);
    ElementPlace place{roots, {}};
    bool isApart = exprs[0].isExact() && exprs[1].isExact() &&
                   !mayMeet(loop, place, place);
    for (IndexExpr &expr : exprs)
      ++(expr.isExact() ? exact : wrapped);
    equal += isEqual, distinct += isDistinct, injective += isInjective;
    apart += isApart;
    for (int sample = 0; sample != 3; ++sample) {
      std::map<std::pair<int64_t, int64_t>, int> seen;
      for (Env &env : enumerate(randomArguments())) {
        SmallVector<std::optional<int64_t>, 2> numbers;
        for (auto [root, expr] : llvm::zip(roots, exprs)) {
          numbers.push_back(numberOf(root, env));
          if (!numbers.back())
            continue;
          Value i = loop.getInductionVars()[0];
          if (auto found = evaluateIndex(root, i, *numberOf(i, env))) {
            ASSERT_EQ(found, numbers.back()) << print(*module);
            ++evaluated;
          }
          // Undefined leaves belong to arms of selects that are not taken.
          bool isDefined = expr.allOf(
              [&](Value leaf) { return numberOf(leaf, env).has_value(); });
          if (!isDefined)
            continue;
          std::optional<int64_t> value =
              evaluate(expr, [&](Value leaf) { return *numberOf(leaf, env); });
          ASSERT_EQ(value, numbers.back()) << print(*module);
          ConstantIntRanges range = ranges.get(root);
          APInt bits = *compute(root, env);
          ASSERT_TRUE(range.smin().sle(bits) && bits.sle(range.smax()) &&
                      range.umin().ule(bits) && bits.ule(range.umax()))
              << print(*module);
          IndexRange sum = builder.getRange(expr);
          if (expr.isExact() && sum.fits(64))
            ASSERT_TRUE(sum.low <= *value && *value <= sum.high)
                << print(*module);
        }
        if (!numbers[0] || !numbers[1])
          continue;
        if (isEqual)
          ASSERT_EQ(numbers[0], numbers[1]) << print(*module);
        if (isDistinct)
          ASSERT_NE(numbers[0], numbers[1]) << print(*module);
        bool isNew = seen.insert({{*numbers[0], *numbers[1]}, 0}).second;
        if (isInjective || isApart)
          ASSERT_TRUE(isNew) << print(*module);
      }
    }
  }
  // Most of the expressions are random, so few are injective.
  EXPECT_GT(exact, 3000);
  EXPECT_GT(wrapped, 300);
  EXPECT_GT(equal, 20);
  EXPECT_GT(distinct, 50);
  EXPECT_GT(injective, 200);
  EXPECT_GT(apart, 100);
  EXPECT_GT(evaluated, 10000);
}

// A difference that is a multiple of a number, or at least one, is not zero.
TEST_F(IndexExprTest, RangesTellApart) {
  start(0, 4, 0, 4);
  auto index = [&](Value value) -> Value {
    return arith::IndexCastOp::create(b, b.getIndexType(), value);
  };
  Value x = index(arguments[1]), y = index(arguments[2]);
  Value distance = arith::SubIOp::create(b, y, x);
  Value one = constant(1, b.getIndexType());
  Value far =
      arith::AddIOp::create(b, x, arith::MaxSIOp::create(b, distance, one));
  EXPECT_TRUE(areDistinct(getIndexExpr(far), getIndexExpr(x)));
  EXPECT_FALSE(areDistinct(getIndexExpr(far), getIndexExpr(y)));
  EXPECT_FALSE(areDistinct(getIndexExpr(x), getIndexExpr(y)));
  Value two = constant(2, b.getIndexType());
  Value even = arith::MulIOp::create(b, x, two);
  Value odd = arith::AddIOp::create(b, arith::MulIOp::create(b, y, two), one);
  EXPECT_TRUE(areDistinct(getIndexExpr(even), getIndexExpr(odd)));
}

// Numbers of 128 bits are unknown; their low bits are used.
TEST_F(IndexExprTest, LowBitsOfWideNumbers) {
  start(0, 4, 0, 4);
  Type i64 = b.getI64Type(), wide = b.getIntegerType(128);
  Value x = arith::ExtSIOp::create(b, wide, arguments[2]);
  Value square = arith::MulIOp::create(b, x, x);
  Value low = arith::TruncIOp::create(b, i64, square);
  Value next = arith::AddIOp::create(b, low, constant(1, i64));
  IndexBuilder builder;
  EXPECT_TRUE(areDistinct(builder.get(low), builder.get(next)));
  EXPECT_FALSE(builder.getRange(builder.get(low)).fits(64));
  Value rest = roundDown(false, low, constant(3, i64));
  EXPECT_FALSE(areDistinct(builder.get(rest), builder.get(low)));
  // A constant of more than 64 bits is unknown.
  Value huge = arith::ConstantOp::create(
      b, IntegerAttr::get(wide, APInt::getOneBitSet(128, 100)));
  EXPECT_FALSE(getIndexExpr(huge).isConstant());
}

// The index of a loop that compares without a sign may have either sign if its
// bounds may.
TEST_F(IndexExprTest, UnsignedLoops) {
  start(0, 2, 0, 2);
  Type i32 = b.getI32Type();
  struct Case {
    int64_t lower, upper, low, high;
  };
  for (auto [lower, upper, low, high] :
       {Case{0, 10, 0, 9}, Case{3, -1, INT32_MIN, INT32_MAX},
        Case{-8, -2, -8, -3}, Case{7, 3, 7, 7}}) {
    auto inner = scf::ForOp::create(
        b, constant(lower, i32), constant(upper, i32), constant(1, i32),
        ValueRange(), nullptr, /*unsignedCmp=*/true);
    IndexBuilder builder;
    IndexRange range = builder.getRange(IndexAtom(inner.getInductionVar()));
    EXPECT_TRUE(range.low == low && range.high == high) << lower;
  }
}

// A 32-bit product wraps to equal values if the factor has no inverse: 3 has an
// inverse, 4 has none.
TEST_F(IndexExprTest, ProductsThatWrap) {
  for (auto [factor, isInjective] : {std::pair{3, true}, std::pair{4, false}}) {
    start(0, (int64_t(1) << 30) + 1, 0, 1);
    Type i32 = b.getI32Type();
    Value i = arith::IndexCastOp::create(b, i32, loop.getInductionVars()[0]);
    Value product = arith::MulIOp::create(b, i, constant(factor, i32));
    IndexBuilder builder;
    IndexExpr expr = builder.get(product);
    EXPECT_EQ(expr.width, 32u);
    EXPECT_EQ(
        isInjectiveOver(builder, expr, loop.getInductionVars().take_front()),
        isInjective);
  }
}

// Expressions stay small: repeated squares would contain i exponentially often,
// and so would repeated sums, whose depth is limited.
TEST_F(IndexExprTest, ExpressionsStaySmall) {
  start(0, 4, 0, 4);
  IndexBuilder builder;
  Value square = loop.getInductionVars()[0], sum = square;
  for (int i = 0; i != 100; ++i) {
    square = arith::MulIOp::create(b, square, square);
    Value other = arith::AddIOp::create(b, square, loop.getInductionVars()[1]);
    sum = arith::AddIOp::create(b, arith::XOrIOp::create(b, sum, other), sum);
    EXPECT_LE(builder.get(square).getSize(), 64u);
    EXPECT_LE(builder.get(sum).getSize(), 64u);
  }
  EXPECT_LE(getIndexExpr(square).getSize(), 64u);
  EXPECT_LE(getIndexExpr(sum).getSize(), 64u);
}

// A 32-bit x + 1 that is extended differs from the extended x plus one.
TEST_F(IndexExprTest, ExtendedSums) {
  start(0, 4, 0, 4);
  Type i64 = b.getI64Type();
  Value x = arguments[1];
  Value sum = arith::AddIOp::create(b, x, constant(1, x.getType()));
  Value inside = arith::ExtSIOp::create(b, i64, sum);
  Value extended = arith::ExtSIOp::create(b, i64, x);
  Value outside = arith::AddIOp::create(b, extended, constant(1, i64));
  EXPECT_FALSE(getIndexExpr(inside) == getIndexExpr(outside));
  EXPECT_TRUE(areDistinct(getIndexExpr(inside), getIndexExpr(extended)));
  EXPECT_TRUE(areDistinct(getIndexExpr(outside), getIndexExpr(extended)));
}
