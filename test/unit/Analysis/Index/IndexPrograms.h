//===- IndexPrograms.h - Random index arithmetic ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Index arithmetic in integers of several widths, in a loop over two indices,
// and its values in all iterations and for several arguments, including extreme
// ones. MLIR's folders compute these values.
//
//===----------------------------------------------------------------------===//

#ifndef TEST_UNIT_ANALYSIS_INDEXPROGRAMS_H
#define TEST_UNIT_ANALYSIS_INDEXPROGRAMS_H

#include "../../Utils/ContextTest.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Parser/Parser.h"
#include "tai/Analysis/Index/IndexQueries.h"
#include "tai/Analysis/IterationOrder.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/Support/MathExtras.h"
#include "gtest/gtest.h"
#include <map>
#include <random>

namespace mlir::tai {

class IndexPrograms : public ContextTest {
protected:
  IndexPrograms() : b(UnknownLoc::get(&context), &context) {}

  int64_t pick(int64_t low, int64_t high) {
    return std::uniform_int_distribution<int64_t>(low, high)(random);
  }
  bool chance(int percent) { return pick(1, 100) <= percent; }

  /// Creates a kernel with a loop over these ranges, with the builder in its
  /// body.
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

  /// A mask of the bits below or from a random bit on, or another number.
  Value randomMask(Type type) {
    int64_t ones = (int64_t(1) << pick(0, 5)) - 1;
    return constant(chance(20) ? pick(-9, 9) : chance(30) ? ~ones : ones, type);
  }

  /// Python's quotient or remainder, in the form that the frontend emits.
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

  /// Nearly the same form, possibly with different signs, operands or order.
  Value almostRoundDown(bool isQuotient, Value x, Value y) {
    using Predicate = arith::CmpIPredicate;
    Type type = x.getType();
    auto oneOf = [&](std::initializer_list<Predicate> list) {
      return list.begin()[pick(0, static_cast<int64_t>(list.size()) - 1)];
    };
    Value rest = arith::RemSIOp::create(b, x, chance(90) ? y : x);
    Value zero = constant(chance(85) ? 0 : 1, type);
    auto isNegative = [&](Value value) -> Value {
      Predicate predicate =
          chance(80) ? Predicate::slt
                     : oneOf({Predicate::sle, Predicate::sgt, Predicate::ult});
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

  /// A boolean as a number, extended with its sign or without.
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
        return chance(50)
                   ? arith::AndIOp::create(b, x, randomMask(inner)).getResult()
                   : arith::XOrIOp::create(b, x,
                                           chance(50) ? randomMask(inner)
                                                      : randomConstant(inner));
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
    // A no-wrap promise by the program, which some values break.
    if (isa<arith::AddIOp, arith::SubIOp, arith::MulIOp, arith::ShLIOp>(
            made.getDefiningOp()) &&
        chance(10))
      made.getDefiningOp()->setAttr(
          "overflowFlags", arith::IntegerOverflowFlagsAttr::get(
                               &context, arith::IntegerOverflowFlags::nsw));
    pool.push_back(made);
    return castTo(made, type);
  }

  /// The values of one iteration; nothing for undefined values.
  using Env = std::map<void *, std::optional<APInt>>;

  /// True if an op divides by zero, or wraps despite a no-wrap flag.
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
      // A value that depends on an undefined value is undefined.
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

  /// The values in all iterations, for given arguments.
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

inline std::string print(ModuleOp module) {
  std::string text;
  llvm::raw_string_ostream os(text);
  module.print(os);
  return text;
}

} // namespace mlir::tai

#endif // TEST_UNIT_ANALYSIS_INDEXPROGRAMS_H
