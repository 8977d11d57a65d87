//===- FloatFactsTest.cpp - Ranges of floats against samples --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Random arithmetic on floats of several types, inside branches. Each fact
// about a value must hold for all samples that reach the value's place and are
// finite: a NaN has no range, and neither has an overflow.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/FloatFacts.h"
#include "../Utils/ContextTest.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Parser/Parser.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/ADT/TypeSwitch.h"
#include "gtest/gtest.h"
#include <cmath>
#include <random>

using namespace mlir;
using namespace mlir::tai;

namespace {
using Numbers = SmallVector<double, 2>;

class FloatFactsTest : public ContextTest {
protected:
  int64_t pick(int64_t low, int64_t high) {
    return std::uniform_int_distribution<int64_t>(low, high)(random);
  }
  bool chance(int percent) { return pick(1, 100) <= percent; }
  template <typename T> T any(std::initializer_list<T> list) {
    return list.begin()[pick(0, static_cast<int64_t>(list.size()) - 1)];
  }

  //===--------------------------------------------------------------------===//
  // Programs
  //===--------------------------------------------------------------------===//

  std::string emit(const Twine &op) {
    std::string result = "%" + std::to_string(++names);
    text += result + " = " + op.str() + "\n";
    return result;
  }
  std::string anyOf(const std::vector<std::string> &list) {
    return list[static_cast<size_t>(
        pick(0, static_cast<int64_t>(list.size()) - 1))];
  }
  std::string number() {
    return any<std::string>({"0.0", "-0.0", "1.0", "-1.0", "0.5", "2.0", "-3.0",
                             "0.125", "1.0e-3"});
  }
  std::string constant(const std::string &type) {
    return emit("arith.constant " + number() + " : " + type);
  }
  std::string compare(const std::string &lhs, const std::string &rhs,
                      const std::string &type) {
    return emit("arith.cmpf " +
                any<std::string>({"oeq", "ogt", "oge", "olt", "ole", "one",
                                  "ueq", "ugt", "uge", "ult", "ule", "une"}) +
                ", " + lhs + ", " + rhs + " : " + type);
  }
  std::string makeCondition() {
    if (chance(25)) {
      std::string first = makeCondition(), second = makeCondition();
      return emit(any<std::string>({"arith.andi ", "arith.ori "}) + first +
                  ", " + second + " : i1");
    }
    if (chance(8))
      return "%c";
    std::string value = anyOf(scalars), bound = constant(type);
    if (chance(15))
      bound = anyOf(scalars);
    if (chance(30))
      std::swap(value, bound);
    return compare(value, bound, type);
  }

  void makeScalar() {
    std::string x = anyOf(scalars), y = anyOf(scalars), suffix = " : " + type;
    std::string result;
    switch (pick(0, 22)) {
    case 0:
    case 1:
      result = emit(any<std::string>({"arith.addf ", "arith.subf "}) + x +
                    ", " + (chance(50) ? y : constant(type)) + suffix);
      break;
    case 2:
      result = emit("arith.negf " + x + suffix);
      break;
    case 3:
      result = emit("arith.mulf " + x + ", " + x + suffix);
      break;
    case 4:
      result = emit("arith.mulf " + x + ", " + y + suffix);
      break;
    case 5:
    case 6:
      result = emit("arith.divf " + (chance(50) ? x : constant(type)) + ", " +
                    y + suffix);
      break;
    case 7:
      result = emit("math.fma " + x + ", " + (chance(50) ? x : y) + ", " +
                    constant(type) + suffix);
      break;
    case 8:
      result = emit(any<std::string>({"arith.maximumf ", "arith.minimumf ",
                                      "arith.maxnumf ", "arith.minnumf "}) +
                    x + ", " + (chance(50) ? y : constant(type)) + suffix);
      break;
    case 9:
      result = emit("math.clampf " + x + " to [" + constant(type) + ", " + y +
                    "]" + suffix);
      break;
    case 10:
    case 11: {
      std::string bound = chance(70) ? constant(type) : y;
      std::string condition = compare(x, bound, type);
      result = emit("arith.select " + condition + ", " + (chance(60) ? x : y) +
                    ", " + (chance(60) ? bound : x) + suffix);
      break;
    }
    case 12:
      result = emit("math.absf " + x + suffix);
      break;
    case 13:
      result =
          emit(any<std::string>({"math.sqrt ", "math.exp ", "math.exp2 ",
                                 "math.expm1 ", "math.sin ", "math.cos ",
                                 "math.tanh ", "math.erf ", "math.cosh ",
                                 "math.rsqrt ", "math.log ", "math.log1p ",
                                 "math.cbrt ", "math.acos ", "math.tan "}) +
               x + suffix);
      break;
    case 14: {
      std::string power =
          chance(15) ? std::string("%n")
                     : emit("arith.constant " + Twine(pick(-2, 4)) + " : i32");
      result = emit("math.fpowi " + x + ", " + power + suffix + ", i32");
      break;
    }
    case 15:
      result = emit("math.powf " + x + ", " + y + suffix);
      break;
    case 16:
      result = emit("arith.uitofp %n : i32 to " + type);
      break;
    case 17: {
      std::string other = type == "f64" ? "f32" : "f64";
      std::string to = type == "f64" ? "arith.truncf " : "arith.extf ";
      std::string back = type == "f64" ? "arith.extf " : "arith.truncf ";
      std::string between = emit(to + x + suffix + " to " + other);
      result = emit(back + between + " : " + other + " to " + type);
      break;
    }
    case 18:
      result = emit("tai.norm " + anyOf(vectors) + " : vector<2x" + type + ">");
      break;
    case 19: {
      std::string v = anyOf(vectors), w = chance(60) ? v : anyOf(vectors);
      result = emit("tai.dot " + v + ", " + w + " : vector<2x" + type + ">");
      break;
    }
    case 20:
      result = emit("tai.sum " + anyOf(vectors) + " : vector<2x" + type + ">");
      break;
    case 21:
      result =
          emit("vector.extract " + anyOf(vectors) + "[" + Twine(pick(0, 1)) +
               "] : " + type + " from vector<2x" + type + ">");
      break;
    default:
      result = emit("tai.stop_gradient " + x + suffix);
    }
    scalars.push_back(result);
  }

  void makeVector() {
    std::string of = "vector<2x" + type + ">";
    std::string v = anyOf(vectors), w = anyOf(vectors);
    switch (pick(0, 4)) {
    case 0:
      vectors.push_back(emit("vector.broadcast " + anyOf(scalars) + " : " +
                             type + " to " + of));
      return;
    case 1:
      vectors.push_back(emit("vector.from_elements " + anyOf(scalars) + ", " +
                             anyOf(scalars) + " : " + of));
      return;
    case 2:
      vectors.push_back(emit("arith.constant dense<[" + number() + ", " +
                             number() + "]> : " + of));
      return;
    case 3: {
      std::string condition =
          emit("arith.cmpf ogt, " + v + ", " + w + " : " + of);
      vectors.push_back(emit("arith.select " + condition + ", " + v + ", " + w +
                             " : vector<2xi1>, " + of));
      return;
    }
    default:
      vectors.push_back(emit("arith.divf " + v + ", " + w + " : " + of));
    }
  }

  void make() {
    names = 0;
    type = any<std::string>(
        {"f16", "bf16", "f32", "f32", "f32", "f64", "f64", "f64"});
    text = "tai.kernel @kernel(%x: " + type + ", %y: " + type +
           ", %n: i32, %c: i1) {\n";
    scalars = {"%x", "%y"};
    vectors = {emit("vector.from_elements %x, %y : vector<2x" + type + ">")};
    for (int64_t count = pick(1, 6); count > 0; --count) {
      if (chance(30))
        makeVector();
      else
        makeScalar();
    }
    int64_t depth = pick(0, 3);
    std::string ends;
    for (int64_t d = 0; d != depth; ++d) {
      text += "scf.if " + makeCondition() + " {\n";
      bool isElse = chance(40);
      if (isElse)
        text += "} else {\n";
      ends += "}\n";
      if (chance(40))
        makeScalar();
    }
    text += "tai.print \"{}\"(" + scalars.back() + ") : " + type + "\n";
    text += ends + "tai.return\n}";
    module = parseSourceString<ModuleOp>(text, &context);
    ASSERT_TRUE(module) << text;
    kernel = module->lookupSymbol<KernelOp>("kernel");
    kernel.walk([&](PrintOp op) { print = op; });
  }

  //===--------------------------------------------------------------------===//
  // Samples
  //===--------------------------------------------------------------------===//

  static double roundTo(double value, Type type) {
    APFloat number(value);
    bool ignored;
    number.convert(cast<FloatType>(type).getFloatSemantics(),
                   APFloat::rmNearestTiesToEven, &ignored);
    number.convert(APFloat::IEEEdouble(), APFloat::rmNearestTiesToEven,
                   &ignored);
    return number.convertToDouble();
  }

  Numbers get(Value value) {
    auto known = values.find(value);
    if (known != values.end())
      return known->second;
    Numbers result = compute(value.getDefiningOp());
    if (Type element = getElementTypeOrSelf(value.getType());
        isa<FloatType>(element))
      for (double &number : result) {
        number = roundTo(number, element);
        isFinite &= std::isfinite(number);
      }
    values[value] = result;
    return result;
  }

  static bool holds(arith::CmpFPredicate predicate, double x, double y) {
    return arith::applyCmpPredicate(predicate, APFloat(x), APFloat(y));
  }

  Numbers compute(Operation *op) {
    Attribute attr;
    if (matchPattern(op, m_Constant(&attr))) {
      if (auto number = dyn_cast<FloatAttr>(attr))
        return {number.getValueAsDouble()};
      if (auto number = dyn_cast<IntegerAttr>(attr))
        return {static_cast<double>(number.getValue().getSExtValue())};
      Numbers all;
      for (APFloat part :
           cast<DenseFPElementsAttr>(attr).getValues<APFloat>()) {
        bool ignored;
        part.convert(APFloat::IEEEdouble(), APFloat::rmNearestTiesToEven,
                     &ignored);
        all.push_back(part.convertToDouble());
      }
      return all;
    }
    SmallVector<Numbers> in;
    for (Value operand : op->getOperands())
      in.push_back(get(operand));
    auto each = [&](auto of) {
      Numbers all;
      for (size_t i = 0; i != in[0].size(); ++i)
        all.push_back(of(i));
      return all;
    };
    auto unary = [&](double (*of)(double)) {
      return each([&](size_t i) { return of(in[0][i]); });
    };
    return llvm::TypeSwitch<Operation *, Numbers>(op)
        .Case([&](arith::AddFOp) {
          return each([&](size_t i) { return in[0][i] + in[1][i]; });
        })
        .Case([&](arith::SubFOp) {
          return each([&](size_t i) { return in[0][i] - in[1][i]; });
        })
        .Case([&](arith::MulFOp) {
          return each([&](size_t i) { return in[0][i] * in[1][i]; });
        })
        .Case([&](arith::DivFOp) {
          return each([&](size_t i) { return in[0][i] / in[1][i]; });
        })
        .Case([&](math::FmaOp) {
          return each(
              [&](size_t i) { return std::fma(in[0][i], in[1][i], in[2][i]); });
        })
        .Case<arith::MaximumFOp, arith::MaxNumFOp>([&](auto) {
          return each([&](size_t i) { return std::max(in[0][i], in[1][i]); });
        })
        .Case<arith::MinimumFOp, arith::MinNumFOp>([&](auto) {
          return each([&](size_t i) { return std::min(in[0][i], in[1][i]); });
        })
        .Case([&](math::ClampFOp) {
          return each([&](size_t i) {
            return std::min(std::max(in[0][i], in[1][i]), in[2][i]);
          });
        })
        .Case([&](arith::SelectOp) {
          Numbers all;
          for (size_t i = 0; i != in[1].size(); ++i)
            all.push_back(in[0][in[0].size() == 1 ? 0 : i] ? in[1][i]
                                                           : in[2][i]);
          return all;
        })
        .Case([&](arith::CmpFOp compare) {
          return each([&](size_t i) {
            return holds(compare.getPredicate(), in[0][i], in[1][i]) ? 1.0
                                                                     : 0.0;
          });
        })
        .Case([&](arith::AndIOp) { return Numbers{in[0][0] * in[1][0]}; })
        .Case(
            [&](arith::OrIOp) { return Numbers{std::max(in[0][0], in[1][0])}; })
        .Case([&](arith::NegFOp) {
          return each([&](size_t i) { return -in[0][i]; });
        })
        .Case([&](math::AbsFOp) { return unary(std::fabs); })
        .Case([&](math::SqrtOp) { return unary(std::sqrt); })
        .Case([&](math::RsqrtOp) {
          return each([&](size_t i) { return 1 / std::sqrt(in[0][i]); });
        })
        .Case([&](math::ExpOp) { return unary(std::exp); })
        .Case([&](math::Exp2Op) { return unary(std::exp2); })
        .Case([&](math::ExpM1Op) { return unary(std::expm1); })
        .Case([&](math::SinOp) { return unary(std::sin); })
        .Case([&](math::CosOp) { return unary(std::cos); })
        .Case([&](math::TanOp) { return unary(std::tan); })
        .Case([&](math::TanhOp) { return unary(std::tanh); })
        .Case([&](math::ErfOp) { return unary(std::erf); })
        .Case([&](math::CoshOp) { return unary(std::cosh); })
        .Case([&](math::LogOp) { return unary(std::log); })
        .Case([&](math::Log1pOp) { return unary(std::log1p); })
        .Case([&](math::CbrtOp) { return unary(std::cbrt); })
        .Case([&](math::AcosOp) { return unary(std::acos); })
        .Case<math::FPowIOp, math::PowFOp>(
            [&](auto) { return Numbers{std::pow(in[0][0], in[1][0])}; })
        .Case([&](NormOp) { return Numbers{std::hypot(in[0][0], in[0][1])}; })
        .Case([&](DotOp) {
          return Numbers{in[0][0] * in[1][0] + in[0][1] * in[1][1]};
        })
        .Case([&](SumOp) { return Numbers{in[0][0] + in[0][1]}; })
        .Case([&](vector::BroadcastOp) { return Numbers{in[0][0], in[0][0]}; })
        .Case(
            [&](vector::FromElementsOp) { return Numbers{in[0][0], in[1][0]}; })
        .Case([&](vector::ExtractOp extract) {
          return Numbers{
              in[0][static_cast<size_t>(extract.getStaticPosition()[0])]};
        })
        .Default([&](Operation *) { return in[0]; });
  }

  /// True if the sample takes the branches that lead to `place`.
  bool reaches(Operation *place) {
    for (Operation *op = place; op->getParentOp() != kernel;
         op = op->getParentOp()) {
      auto branch = cast<scf::IfOp>(op->getParentOp());
      bool isThen = op->getParentRegion() == &branch.getThenRegion();
      if ((get(branch.getCondition())[0] != 0) != isThen)
        return false;
    }
    return true;
  }

  std::mt19937_64 random{20251128};
  std::string text, type;
  int names = 0;
  std::vector<std::string> scalars, vectors;
  OwningOpRef<ModuleOp> module;
  KernelOp kernel;
  PrintOp print;
  llvm::DenseMap<Value, Numbers> values;
  bool isFinite = true;
};
} // namespace

TEST_F(FloatFactsTest, AgreeWithSamples) {
  int bounded = 0, positive = 0, nonZero = 0, unit = 0, finite = 0, sampled = 0;
  const double samples[] = {0.0,  -0.0, 1.0,   -1.0,   0.5,   -0.25,  2.0,
                            -3.0, 7.5,  0.125, 1.0e-3, -40.0, 1.0e-9, 60.0};
  for (int round = 0; round != 1500; ++round) {
    make();
    SCOPED_TRACE(text);
    if (HasFatalFailure())
      return;
    FloatFacts facts(/*usesConditions=*/true), always;
    SmallVector<Value> all;
    kernel.walk([&](Operation *op) {
      for (Value result : op->getResults())
        if (isa<FloatType>(getElementTypeOrSelf(result.getType())) &&
            (op->getParentOp() == kernel ||
             op->getParentOp()->isAncestor(print)))
          all.push_back(result);
    });
    all.append(
        {kernel.getBody().getArgument(0), kernel.getBody().getArgument(1)});
    struct Facts {
      FloatFacts::Interval here, anywhere;
      bool isPositive, isNonNegative, isNonZero, isNonPositive, isInUnit;
      bool mayBeNonFinite;
    };
    SmallVector<Facts> known;
    for (Value value : all) {
      known.push_back(
          {facts.getRange(value, print), always.getRange(value),
           facts.isPositive(value, print), facts.isNonNegative(value, print),
           facts.isNonZero(value, print), facts.isNonPositive(value, print),
           facts.isInUnitInterval(value, print), always.mayBeNonFinite(value)});
      const Facts &last = known.back();
      bounded += std::isfinite(last.here.low) || std::isfinite(last.here.high);
      positive += last.isPositive, nonZero += last.isNonZero;
      unit += last.isInUnit, finite += !last.mayBeNonFinite;
    }
    for (double x : samples)
      for (double y : samples) {
        values.clear();
        isFinite = true;
        bool isIn = chance(50);
        KernelOp of = kernel;
        Type element = of.getBody().getArgument(0).getType();
        values[of.getBody().getArgument(0)] = {roundTo(x, element)};
        values[of.getBody().getArgument(1)] = {roundTo(y, element)};
        values[of.getBody().getArgument(2)] = {static_cast<double>(pick(0, 3))};
        values[of.getBody().getArgument(3)] = {isIn ? 1.0 : 0.0};
        bool isHere = reaches(print);
        for (Value value : all)
          if (isHere || value.getParentBlock()->getParentOp() == kernel)
            (void)get(value);
        for (auto [value, fact] : llvm::zip(all, known)) {
          auto at = values.find(value);
          if (at == values.end())
            continue;
          for (double number : at->second) {
            // Values computed earlier may not be finite either.
            if (!fact.mayBeNonFinite && type == "f64")
              ASSERT_TRUE(std::isfinite(number)) << x << " " << y;
            if (!isFinite)
              continue;
            ASSERT_TRUE(fact.anywhere.low <= number &&
                        number <= fact.anywhere.high)
                << x << " " << y << " " << number;
            if (!isHere)
              continue;
            ++sampled;
            ASSERT_TRUE(fact.here.low <= number && number <= fact.here.high)
                << x << " " << y << " " << number;
            if (fact.isPositive)
              ASSERT_GT(number, 0);
            if (fact.isNonNegative)
              ASSERT_GE(number, 0);
            if (fact.isNonZero)
              ASSERT_NE(number, 0);
            if (fact.isNonPositive)
              ASSERT_LE(number, 0);
            if (fact.isInUnit)
              ASSERT_LE(std::fabs(number), 1);
          }
        }
      }
    if (HasFatalFailure())
      return;
  }
  EXPECT_GT(bounded, 3000);
  EXPECT_GT(positive, 1000);
  EXPECT_GT(nonZero, 1000);
  EXPECT_GT(unit, 1000);
  EXPECT_GT(finite, 3000);
  EXPECT_GT(sampled, 100000);
}

// A number that is not finite has no range, and a constant of another kind
// none that is known.
TEST_F(FloatFactsTest, Constants) {
  auto parse = [&](StringRef constant, StringRef of) {
    std::string source = "tai.kernel @kernel() {\n%0 = arith.constant " +
                         constant.str() + " : " + of.str() + "\ntai.return\n}";
    module = parseSourceString<ModuleOp>(source, &context);
    Value value;
    module->walk([&](arith::ConstantOp op) { value = op; });
    return value;
  };
  FloatFacts facts;
  EXPECT_EQ(facts.getRange(parse("2.0", "f32")).high, 2.0);
  Value nan = parse("0x7FC00000", "f32");
  EXPECT_TRUE(std::isinf(facts.getRange(nan).low));
  EXPECT_FALSE(facts.isNonZero(nan));
  EXPECT_TRUE(facts.mayBeNonFinite(nan));
  Value infinite = parse("0x7F800000", "f32");
  EXPECT_FALSE(facts.isNonZero(infinite) && !facts.mayBeNonFinite(infinite));
  Value mixed = parse("dense<[1.0, -2.0]>", "vector<2xf64>");
  EXPECT_TRUE(facts.isNonZero(mixed));
  EXPECT_EQ(facts.getRange(mixed).low, -2.0);
  EXPECT_FALSE(facts.isNonZero(parse("dense<[1.0, 0.0]>", "vector<2xf64>")));
  EXPECT_FALSE(facts.isNonZero(parse("dense<0.0>", "vector<2xf64>")));
}

// Bits that are cast to a float may be any float.
TEST_F(FloatFactsTest, Bits) {
  module = parseSourceString<ModuleOp>(R"(
    tai.kernel @kernel(%n: i32, %v: vector<2xi32>) {
      %0 = arith.bitcast %n : i32 to f32
      %1 = vector.bitcast %v : vector<2xi32> to vector<2xf32>
      tai.return
    })",
                                       &context);
  FloatFacts facts;
  int found = 0;
  module->lookupSymbol<KernelOp>("kernel").walk([&](Operation *op) {
    if (op->getNumResults() == 1)
      found += facts.mayBeNonFinite(op->getResult(0));
  });
  EXPECT_EQ(found, 2);
}
