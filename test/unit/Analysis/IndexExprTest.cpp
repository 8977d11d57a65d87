//===- IndexExprTest.cpp - Index expressions against enumeration ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Random index arithmetic in integers of several widths, in a loop over two
// indices. MLIR's folders compute its values in all iterations and for several
// arguments, among them the extremes, and each answer of the queries must hold
// for them. The tests also count the answers: an analysis that knows nothing
// is right as well.
//
//===----------------------------------------------------------------------===//

#include "../Compiler/ContextTest.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Parser/Parser.h"
#include "tai/Analysis/Index/IndexQueries.h"
#include "tai/Analysis/Index/IndexShift.h"
#include "tai/Analysis/IterationOrder.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/Support/MathExtras.h"
#include "gtest/gtest.h"
#include <map>
#include <random>

using namespace mlir;
using namespace mlir::tai;

namespace {
class IndexExprTest : public ContextTest {
protected:
  IndexExprTest() : b(UnknownLoc::get(&context), &context) {}

  int64_t pick(int64_t low, int64_t high) {
    return std::uniform_int_distribution<int64_t>(low, high)(random);
  }
  bool chance(int percent) { return pick(1, 100) <= percent; }

  /// A kernel with a loop over `extents` that the builder stands in.
  void start(int64_t lower0, int64_t upper0, int64_t lower1, int64_t upper1) {
    std::string text;
    llvm::raw_string_ostream(text)
        << "tai.kernel @k(%a: i16, %b: i32, %c: i64) {\n"
        << "%l0 = arith.constant " << lower0 << " : index\n"
        << "%u0 = arith.constant " << upper0 << " : index\n"
        << "%l1 = arith.constant " << lower1 << " : index\n"
        << "%u1 = arith.constant " << upper1 << " : index\n"
        << "tai.parallel_for (%i, %j) = (%l0, %l1) to (%u0, %u1) {\n}\n"
        << "tai.return\n}";
    module = parseSourceString<ModuleOp>(text, &context);
    ASSERT_TRUE(module);
    auto kernel = module->lookupSymbol<KernelOp>("k");
    arguments.assign(kernel.getBody().getArguments().begin(),
                     kernel.getBody().getArguments().end());
    kernel->walk([&](ParallelForOp op) { loop = op; });
    lower = {lower0, lower1}, upper = {upper0, upper1};
    b.setInsertionPoint(loop.getBody().front().getTerminator());
  }

  Value constant(int64_t value, Type type) {
    return arith::ConstantOp::create(b, b.getIntegerAttr(type, value));
  }

  Type randomType() {
    switch (pick(0, 5)) {
    case 0:
      return b.getI8Type();
    case 1:
      return b.getI16Type();
    case 2:
    case 3:
      return b.getI32Type();
    case 4:
      return b.getI64Type();
    default:
      return b.getIndexType();
    }
  }

  static unsigned widthOf(Type type) {
    return type.isIndex() ? 64 : type.getIntOrFloatBitWidth();
  }

  Value castTo(Value value, Type type) {
    Type from = value.getType();
    if (from == type)
      return value;
    if (from.isIndex() || type.isIndex()) {
      if (chance(10))
        return arith::IndexCastUIOp::create(b, type, value);
      return arith::IndexCastOp::create(b, type, value);
    }
    if (widthOf(from) > widthOf(type))
      return arith::TruncIOp::create(b, type, value);
    if (chance(15))
      return arith::ExtUIOp::create(b, type, value);
    return arith::ExtSIOp::create(b, type, value);
  }

  Value randomConstant(Type type) {
    int64_t value = pick(-3, 9);
    if (chance(15))
      value = static_cast<int64_t>(uint64_t(1) << pick(0, widthOf(type) - 1));
    return constant(
        llvm::SignExtend64(static_cast<uint64_t>(value), widthOf(type)), type);
  }

  /// Ones below a bit, or from it on; some other numbers.
  Value randomMask(Type type) {
    int64_t ones = (int64_t(1) << pick(0, 5)) - 1;
    return constant(chance(20) ? pick(-9, 9) : chance(30) ? ~ones : ones, type);
  }

  /// Python's quotient or remainder, as the frontend writes it.
  Value roundDown(bool isQuotient, Value x, Value y) {
    using Predicate = arith::CmpIPredicate;
    Value rest = arith::RemSIOp::create(b, x, y);
    Value zero = constant(0, x.getType());
    APInt number;
    Value wrong;
    if (matchPattern(y, m_ConstantInt(&number)) &&
        number.isStrictlyPositive()) {
      wrong = arith::CmpIOp::create(b, Predicate::slt, rest, zero);
    } else {
      Value bits = arith::XOrIOp::create(b, rest, y);
      wrong = arith::AndIOp::create(
          b, arith::CmpIOp::create(b, Predicate::ne, rest, zero),
          arith::CmpIOp::create(b, Predicate::slt, bits, zero));
    }
    if (!isQuotient)
      return arith::SelectOp::create(b, wrong,
                                     arith::AddIOp::create(b, rest, y), rest);
    Value quotient = arith::DivSIOp::create(b, x, y);
    Value less = arith::SubIOp::create(b, quotient, constant(1, x.getType()));
    return arith::SelectOp::create(b, wrong, less, quotient);
  }

  /// Nearly the same: signs, operands and their order may be others.
  Value almostRoundDown(bool isQuotient, Value x, Value y) {
    using Predicate = arith::CmpIPredicate;
    Type type = x.getType();
    auto oneOf = [&](std::initializer_list<Predicate> list) {
      return list.begin()[pick(0, static_cast<int64_t>(list.size()) - 1)];
    };
    Value rest = arith::RemSIOp::create(b, x, chance(90) ? y : x);
    Value zero = constant(chance(85) ? 0 : 1, type);
    auto isNegative = [&](Value value) -> Value {
      Predicate predicate = chance(80) ? Predicate::slt
                                       : oneOf({Predicate::sle, Predicate::sgt,
                                                Predicate::ult});
      return arith::CmpIOp::create(b, predicate, value, zero);
    };
    Value wrong = isNegative(rest);
    if (chance(60)) {
      Value one = chance(85) ? rest : x, other = chance(85) ? y : x;
      if (chance(40))
        std::swap(one, other);
      Value bits = chance(85) ? arith::XOrIOp::create(b, one, other).getResult()
                              : arith::AddIOp::create(b, one, other);
      Value differs = isNegative(bits);
      Value isThere = arith::CmpIOp::create(
          b, chance(85) ? Predicate::ne : Predicate::eq, rest, zero);
      if (chance(40))
        std::swap(isThere, differs);
      wrong = chance(90)
                  ? arith::AndIOp::create(b, isThere, differs).getResult()
                  : arith::OrIOp::create(b, isThere, differs);
    }
    if (!isQuotient) {
      Value one = rest, other = chance(85) ? y : x;
      if (chance(40))
        std::swap(one, other);
      Value more = chance(90) ? arith::AddIOp::create(b, one, other).getResult()
                              : arith::SubIOp::create(b, one, other);
      return arith::SelectOp::create(b, wrong, more, rest);
    }
    Value quotient = arith::DivSIOp::create(b, x, y);
    Value base = chance(90) ? quotient : x;
    int64_t by = chance(85) ? 1 : 2;
    Value less =
        chance(50)
            ? arith::SubIOp::create(b, base, constant(by, type)).getResult()
            : arith::AddIOp::create(b, base, constant(-by, type));
    if (chance(10))
      less = arith::MulIOp::create(b, quotient, y);
    return arith::SelectOp::create(b, wrong, less, quotient);
  }

  /// A truth value as a number, by its sign or without one.
  Value randomBit(Type type) {
    Value bit = arith::CmpIOp::create(
        b, arith::CmpIPredicate::slt,
        loop.getInductionVars()[static_cast<size_t>(pick(0, 1))],
        constant(pick(0, 4), b.getIndexType()));
    if (type.isIndex())
      return chance(50)
                 ? arith::IndexCastOp::create(b, type, bit).getResult()
                 : arith::IndexCastUIOp::create(b, type, bit).getResult();
    return chance(50) ? arith::ExtSIOp::create(b, type, bit).getResult()
                      : arith::ExtUIOp::create(b, type, bit).getResult();
  }

  Value randomLeaf(Type type) {
    if (chance(4))
      return randomBit(type);
    switch (pick(0, 9)) {
    case 0:
    case 1:
      return randomConstant(type);
    case 2:
      return castTo(arguments[static_cast<size_t>(pick(0, 2))], type);
    default:
      return castTo(loop.getInductionVars()[static_cast<size_t>(pick(0, 1))],
                    type);
    }
  }

  Value randomValue(Type type, int depth) {
    if (depth == 0 || chance(10))
      return randomLeaf(type);
    if (!pool.empty() && chance(15))
      return castTo(pool[static_cast<size_t>(
                        pick(0, static_cast<int64_t>(pool.size()) - 1))],
                    type);
    Type inner = chance(20) ? randomType() : type;
    Value x = randomValue(inner, depth - 1);
    Value y = randomValue(inner, chance(50) ? 0 : depth - 1);
    Value divisor = chance(75) ? constant(pick(1, 7), inner) : y;
    auto create = [&]() -> Value {
      switch (pick(0, 19)) {
      case 16:
        return arith::AndIOp::create(b, x, randomMask(inner));
      case 17:
        return arith::ShLIOp::create(b, x, constant(pick(0, 4), inner));
      case 18:
        return chance(70) ? arith::ShRSIOp::create(b, x, divisor).getResult()
                          : arith::ShRUIOp::create(b, x, divisor).getResult();
      case 19:
        return arith::OrIOp::create(
            b, arith::ShLIOp::create(b, x, constant(pick(0, 4), inner)),
            chance(50) ? arith::AndIOp::create(b, y, randomMask(inner)) : y);
      case 0:
      case 1:
      case 2:
        return arith::AddIOp::create(b, x, y);
      case 3:
      case 4:
        return arith::SubIOp::create(b, x, y);
      case 5:
        return arith::MulIOp::create(b, x, y);
      case 6:
      case 7:
        return arith::MulIOp::create(b, x, randomConstant(inner));
      case 8:
        return arith::MinSIOp::create(b, x, y);
      case 9:
        return arith::MaxSIOp::create(b, x, y);
      case 10:
        return arith::FloorDivSIOp::create(b, x, divisor);
      case 11:
        return chance(50) ? arith::DivSIOp::create(b, x, divisor).getResult()
                          : arith::DivUIOp::create(b, x, divisor).getResult();
      case 12:
        return chance(50) ? arith::RemSIOp::create(b, x, divisor).getResult()
                          : arith::RemUIOp::create(b, x, divisor).getResult();
      case 13:
        return almostRoundDown(chance(50), x, divisor);
      default:
        return roundDown(chance(50), x, divisor);
      }
    };
    Value made = create();
    // A promise of the program, which some values do not keep.
    if (isa<arith::AddIOp, arith::SubIOp, arith::MulIOp, arith::ShLIOp>(
            made.getDefiningOp()) &&
        chance(10))
      made.getDefiningOp()->setAttr(
          "overflowFlags",
          arith::IntegerOverflowFlagsAttr::get(
              &context, arith::IntegerOverflowFlags::nsw));
    pool.push_back(made);
    return castTo(made, type);
  }

  /// The values of one iteration; none of those that are not defined.
  using Env = std::map<void *, std::optional<APInt>>;

  /// True if an op divides by zero, or wraps though it is said not to.
  static bool breaksPromise(Operation *op, ArrayRef<Attribute> operands) {
    if (isa<arith::FloorDivSIOp, arith::DivSIOp, arith::DivUIOp, arith::RemSIOp,
            arith::RemUIOp>(op))
      return cast<IntegerAttr>(operands[1]).getValue().isZero();
    auto flags = dyn_cast<arith::ArithIntegerOverflowFlagsInterface>(op);
    if (!flags || !flags.hasNoSignedWrap())
      return false;
    APInt x = cast<IntegerAttr>(operands[0]).getValue().sext(160);
    APInt y = cast<IntegerAttr>(operands[1]).getValue().sext(160);
    APInt exact = isa<arith::AddIOp>(op)   ? x + y
                  : isa<arith::SubIOp>(op) ? x - y
                  : isa<arith::MulIOp>(op) ? x * y
                                           : x.shl(y.urem(APInt(160, 64)));
    return !exact.isSignedIntN(widthOf(op->getResult(0).getType()));
  }

  std::optional<APInt> compute(Value value, Env &env) {
    auto known = env.find(value.getAsOpaquePointer());
    if (known != env.end())
      return known->second;
    Operation *op = value.getDefiningOp();
    std::optional<APInt> result;
    SmallVector<Attribute> operands;
    for (Value operand : op->getOperands()) {
      std::optional<APInt> number = compute(operand, env);
      // Dividing by zero is undefined.
      if (!number)
        return env[value.getAsOpaquePointer()] = std::nullopt;
      operands.push_back(IntegerAttr::get(operand.getType(), *number));
    }
    if (breaksPromise(op, operands))
      return env[value.getAsOpaquePointer()] = std::nullopt;
    SmallVector<OpFoldResult> folded;
    if (succeeded(op->fold(operands, folded)) && folded.size() == 1) {
      if (auto attr = dyn_cast<Attribute>(folded.front()))
        result = cast<IntegerAttr>(attr).getValue();
      else
        result = compute(cast<Value>(folded.front()), env);
    }
    return env[value.getAsOpaquePointer()] = result;
  }

  /// All iterations for some arguments.
  std::vector<Env> enumerate(ArrayRef<int64_t> values) {
    std::vector<Env> all;
    for (int64_t i = lower[0]; i < upper[0]; ++i)
      for (int64_t j = lower[1]; j < upper[1]; ++j) {
        Env env;
        for (auto [k, at] : {std::pair{0, i}, std::pair{1, j}})
          env[loop.getInductionVars()[k].getAsOpaquePointer()] =
              APInt(64, at, true);
        for (auto [argument, value] : llvm::zip(arguments, values)) {
          unsigned width = widthOf(argument.getType());
          env[argument.getAsOpaquePointer()] =
              APInt(width, value, true, /*implicitTrunc=*/true);
        }
        all.push_back(std::move(env));
      }
    return all;
  }

  SmallVector<int64_t> randomArguments() {
    SmallVector<int64_t> values;
    for (Value argument : arguments) {
      unsigned width = widthOf(argument.getType());
      switch (pick(0, 5)) {
      case 0:
        values.push_back(llvm::minIntN(width));
        break;
      case 1:
        values.push_back(llvm::maxIntN(width) - pick(0, 2));
        break;
      default:
        values.push_back(pick(-3, 12));
        break;
      }
    }
    return values;
  }

  std::optional<int64_t> numberOf(Value value, Env &env) {
    std::optional<APInt> number = compute(value, env);
    return number ? std::optional(number->getSExtValue()) : std::nullopt;
  }

  std::mt19937_64 random{20240601};
  OwningOpRef<ModuleOp> module;
  ParallelForOp loop;
  SmallVector<Value> arguments;
  SmallVector<Value> pool;
  SmallVector<int64_t, 2> lower, upper;
  ImplicitLocOpBuilder b;
};

using ValueOf = llvm::function_ref<int64_t(Value)>;

std::optional<int64_t> evaluate(const IndexExpr &expr, ValueOf valueOf);

/// The low 64 bits of a node; none where it divides by zero.
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

std::string print(ModuleOp module) {
  std::string text;
  llvm::raw_string_ostream os(text);
  module.print(os);
  return text;
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
          // Leaves that are not defined are of choices that are not taken.
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
  // Most of the expressions are random, so that few are injective.
  EXPECT_GT(exact, 3000);
  EXPECT_GT(wrapped, 300);
  EXPECT_GT(equal, 20);
  EXPECT_GT(distinct, 50);
  EXPECT_GT(injective, 200);
  EXPECT_GT(apart, 100);
  EXPECT_GT(evaluated, 10000);
}

// Digits of one number, in i32 as programs write them, tell iterations apart.
TEST_F(IndexExprTest, DigitsDetermineTheirNumber) {
  for (bool isConstant : {true, false}) {
    start(0, 24, 0, 5);
    Type i32 = b.getI32Type();
    Value i = arith::IndexCastOp::create(b, i32, loop.getInductionVars()[0]);
    Value j = loop.getInductionVars()[1];
    Value m = isConstant ? constant(7, i32) : arguments[1];
    Value quotient = roundDown(true, i, m), rest = roundDown(false, i, m);
    IndexBuilder builder;
    ValueRange ivs = loop.getInductionVars();
    EXPECT_TRUE(
        isInjectiveOver(builder, builder.get({rest, quotient, j}), ivs));
    EXPECT_FALSE(isInjectiveOver(builder, builder.get({rest, j}), ivs));
    EXPECT_FALSE(isInjectiveOver(builder, builder.get({quotient, j}), ivs));
    Value joined =
        arith::AddIOp::create(b, arith::MulIOp::create(b, quotient, m), rest);
    IndexExpr expr = builder.get(joined);
    EXPECT_EQ(expr.compare(builder.get(i)), 0);
    EXPECT_EQ(expr.isExact(), isConstant);
    SmallVector<Value> places{rest, quotient, j};
    EXPECT_FALSE(mayMeet(loop, {places, {}}, {places, {}}));
    places.pop_back();
    EXPECT_TRUE(mayMeet(loop, {places, {}}, {places, {}}));
  }
}

// Two numbers with the same digits are the same number, whether all digits are
// there, and whether the arithmetic of the numbers may wrap.
TEST_F(IndexExprTest, DigitsOfTwoNumbers) {
  int apart = 0, together = 0;
  for (int round = 0; round != 1500; ++round) {
    int64_t lower0 = chance(60) ? 0 : pick(-9, 3), lower1 = pick(-1, 1);
    start(lower0, lower0 + pick(2, 11), lower1, lower1 + pick(1, 3));
    Type types[] = {b.getI16Type(), b.getI32Type(), b.getI64Type(),
                    b.getIndexType()};
    Type type = types[pick(0, 3)];
    auto ofLoop = [&](size_t k) {
      Value iv = loop.getInductionVars()[k];
      return type.isIndex() ? iv : arith::IndexCastOp::create(b, type, iv);
    };
    auto multiply = [&](Value value, int64_t factor) -> Value {
      return arith::MulIOp::create(b, value, constant(factor, type));
    };
    Value shared = arith::AddIOp::create(b, multiply(ofLoop(0), pick(-1, 3)),
                                         multiply(ofLoop(1), pick(-2, 3)));
    if (chance(30))
      shared = arith::AddIOp::create(b, shared, castTo(arguments[0], type));
    int64_t distance = chance(40) ? 0 : pick(-3, 3);
    Value numbers[] = {
        shared, arith::AddIOp::create(b, shared, constant(distance, type))};
    Value low =
        chance(70) ? constant(pick(1, 6), type) : castTo(arguments[1], type);
    Value high = constant(pick(1, 4), type);
    bool isFloor = chance(75), isLong = chance(40);
    int64_t dropped = chance(80) ? -1 : pick(0, isLong ? 2 : 1);
    SmallVector<Value> digits[2];
    for (int k = 0; k != 2; ++k) {
      auto divide = [&](bool isQuotient) -> Value {
        if (isFloor)
          return roundDown(isQuotient, numbers[k], low);
        return isQuotient
                   ? arith::DivSIOp::create(b, numbers[k], low).getResult()
                   : arith::RemSIOp::create(b, numbers[k], low).getResult();
      };
      Value quotient = divide(true);
      digits[k] = {divide(false)};
      if (isLong)
        digits[k].push_back(roundDown(false, quotient, high));
      digits[k].push_back(isLong ? roundDown(true, quotient, high) : quotient);
      if (dropped >= 0)
        digits[k].erase(digits[k].begin() + dropped);
    }
    bool isApart = !mayMeet(loop, {digits[0], {}}, {digits[1], {}});
    bool meets = false;
    for (int sample = 0; sample != 3; ++sample) {
      SmallVector<int64_t> values{pick(-4, 9), pick(-5, 5), 0};
      std::vector<Env> envs = enumerate(values);
      for (size_t x = 0; x != envs.size(); ++x)
        for (size_t y = 0; y != envs.size(); ++y) {
          auto isEqual = [&](auto pair) {
            auto [first, second] = pair;
            auto number = numberOf(first, envs[x]);
            return number && number == numberOf(second, envs[y]);
          };
          meets |=
              x != y && llvm::all_of(llvm::zip(digits[0], digits[1]), isEqual);
        }
    }
    ASSERT_FALSE(isApart && meets) << print(*module);
    apart += isApart, together += meets;
  }
  EXPECT_GT(apart, 300);
  EXPECT_GT(together, 300);
}

// A division rounds down where the remainder of these two numbers and the
// divisor have different signs, in any order; where the condition asks of other
// numbers, it is no such division.
TEST_F(IndexExprTest, ConditionsOfDivisionsThatRoundDown) {
  start(0, 24, 0, 5);
  Type i32 = b.getI32Type();
  Value x = arith::IndexCastOp::create(b, i32, loop.getInductionVars()[0]);
  Value m = arguments[1], zero = constant(0, i32);
  Value other = arith::IndexCastOp::create(b, i32, loop.getInductionVars()[1]);
  Value rest = arith::RemSIOp::create(b, x, m);
  Value restByOther = arith::RemSIOp::create(b, x, other);
  Value restOfOther = arith::RemSIOp::create(b, other, m);
  Value quotient = arith::DivSIOp::create(b, x, m);
  auto differ = [&](Value asked, Value lhs, Value rhs) -> Value {
    return arith::AndIOp::create(
        b, arith::CmpIOp::create(b, arith::CmpIPredicate::ne, asked, zero),
        arith::CmpIOp::create(b, arith::CmpIPredicate::slt,
                              arith::XOrIOp::create(b, lhs, rhs), zero));
  };
  Value conditions[] = {differ(rest, rest, m),
                        differ(rest, m, rest),
                        differ(rest, rest, other),
                        differ(rest, other, rest),
                        differ(rest, m, other),
                        differ(rest, other, m),
                        differ(restByOther, restByOther, m),
                        differ(restOfOther, restOfOther, m)};
  IndexBuilder builder;
  IndexExpr downQuotient = builder.get(roundDown(true, x, m));
  IndexExpr downRest = builder.get(roundDown(false, x, m));
  for (auto [number, condition] : llvm::enumerate(conditions)) {
    Value less = arith::SubIOp::create(b, quotient, constant(1, i32));
    Value more = arith::AddIOp::create(b, rest, m);
    EXPECT_EQ(builder.get(arith::SelectOp::create(b, condition, less,
                                                  quotient)) == downQuotient,
              number < 2)
        << number;
    EXPECT_EQ(builder.get(arith::SelectOp::create(b, condition, more, rest)) ==
                  downRest,
              number < 2)
        << number;
  }
}

TEST_F(IndexExprTest, ThreeDigits) {
  start(0, 24, 0, 1);
  Value i = loop.getInductionVars()[0];
  auto number = [&](int64_t value) {
    return constant(value, b.getIndexType());
  };
  Value high = arith::FloorDivSIOp::create(b, i, number(12));
  Value middle = arith::RemSIOp::create(
      b, arith::FloorDivSIOp::create(b, i, number(3)), number(4));
  Value low = arith::RemSIOp::create(b, i, number(3));
  IndexBuilder builder;
  ValueRange ivs = loop.getInductionVars().take_front();
  EXPECT_TRUE(isInjectiveOver(builder, builder.get({high, middle, low}), ivs));
  EXPECT_FALSE(isInjectiveOver(builder, builder.get({middle, low}), ivs));
}

// The digits of a number that is built from digits are these.
TEST_F(IndexExprTest, DigitsOfDigits) {
  start(0, 8, 0, 4);
  Value i = loop.getInductionVars()[0], j = loop.getInductionVars()[1];
  Value four = constant(4, b.getIndexType());
  Value number = arith::AddIOp::create(b, arith::MulIOp::create(b, i, four), j);
  IndexBuilder builder;
  EXPECT_EQ(builder.get(arith::DivUIOp::create(b, number, four)),
            builder.get(i));
  EXPECT_EQ(builder.get(arith::RemSIOp::create(b, number, four)),
            builder.get(j));
}

// A quotient has a multiple of the divisor outside, so that a number that is
// built from its high digits and the low ones of a summand is itself.
TEST_F(IndexExprTest, MultiplesOfTheDivisor) {
  start(0, 4, 0, 8);
  for (bool isIndex : {true, false}) {
    Type type = isIndex ? Type(b.getIndexType()) : b.getI32Type();
    auto number = [&](int64_t value) { return constant(value, type); };
    Value i = castTo(loop.getInductionVars()[0], type);
    Value j = castTo(loop.getInductionVars()[1], type);
    Value whole = arith::AddIOp::create(
        b, arith::MulIOp::create(b, i, number(8)), j);
    IndexBuilder builder;
    Value high = arith::MulIOp::create(b, roundDown(true, whole, number(4)),
                                       number(4));
    Value flat =
        arith::AddIOp::create(b, high, roundDown(false, j, number(4)));
    EXPECT_EQ(builder.get(flat), builder.get(whole));
    ValueRange ivs = loop.getInductionVars();
    EXPECT_TRUE(isInjectiveOver(builder, builder.get(flat), ivs));
    // Blocks of four that overlap.
    Value mixed =
        arith::AddIOp::create(b, high, roundDown(false, j, number(5)));
    EXPECT_FALSE(isInjectiveOver(builder, builder.get(mixed), ivs));
    // The constant of the dividend stays below the divisor.
    Value next = arith::AddIOp::create(b, whole, number(13));
    Value three = arith::AddIOp::create(
        b, roundDown(true, arith::AddIOp::create(b, whole, number(1)), number(4)),
        number(3));
    EXPECT_EQ(builder.get(roundDown(true, next, number(4))),
              builder.get(three));
  }
  // A sum of an argument may wrap: its digits are not those of the terms.
  Value n = arguments[1], four = constant(4, n.getType());
  Value i = castTo(loop.getInductionVars()[0], n.getType());
  Value sum =
      arith::AddIOp::create(b, arith::MulIOp::create(b, i, four), n);
  Value apart = arith::AddIOp::create(b, i, roundDown(true, n, four));
  IndexBuilder builder;
  EXPECT_FALSE(builder.get(roundDown(true, sum, four)) == builder.get(apart));
}

// Nothing is known of the numbers of 128 bits, of which the low bits are used.
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
  // A constant of more than 64 bits is no number of an expression.
  Value huge = arith::ConstantOp::create(
      b, IntegerAttr::get(wide, APInt::getOneBitSet(128, 100)));
  EXPECT_FALSE(getIndexExpr(huge).isConstant());
}

// The index of a loop that compares without a sign has both signs, where its
// bounds have.
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

// Masks and shifts are digits, and a union of digits is their number.
TEST_F(IndexExprTest, DigitsOfBits) {
  start(0, 24, 0, 4);
  Value i = loop.getInductionVars()[0], j = loop.getInductionVars()[1];
  auto number = [&](int64_t value) {
    return constant(value, b.getIndexType());
  };
  IndexBuilder builder;
  Value high = arith::ShRSIOp::create(b, i, number(2));
  Value low = arith::AndIOp::create(b, i, number(3));
  ValueRange ivs = loop.getInductionVars();
  EXPECT_TRUE(isInjectiveOver(builder, builder.get({high, low, j}), ivs));
  EXPECT_FALSE(isInjectiveOver(builder, builder.get({low, j}), ivs));
  Value joined =
      arith::OrIOp::create(b, low, arith::ShLIOp::create(b, high, number(2)));
  EXPECT_EQ(builder.get(joined), builder.get(i));
  Value both =
      arith::OrIOp::create(b, arith::ShLIOp::create(b, i, number(2)), j);
  EXPECT_TRUE(isInjectiveOver(builder, builder.get(both), ivs));
  // 2 i and j overlap.
  Value mixed =
      arith::OrIOp::create(b, arith::ShLIOp::create(b, i, number(1)), j);
  EXPECT_FALSE(isInjectiveOver(builder, builder.get(mixed), ivs));
  EXPECT_EQ(builder.get(arith::AndIOp::create(b, both, number(-4))),
            builder.get(arith::ShLIOp::create(b, i, number(2))));
}

// A product of 32 bits takes values again; 3 has an inverse, and 4 has not.
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

// Expressions stay small: the squares of squares name i exponentially often, as
// do the sums of sums of which the depth is cut.
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

// x + 1 of 32 bits, extended, is not the extended x, plus one.
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
