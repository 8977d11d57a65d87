//===- Numbers.cpp - Operations on single numbers -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Numbers.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/IR/BuiltinAttributes.h"
#include "llvm/ADT/StringMap.h"
#include <cmath>

using namespace mlir;
using namespace mlir::tai;
using namespace mlir::tai::interpreter;
using llvm::APFloat;
using llvm::APInt;

static constexpr auto kNearest = APFloat::rmNearestTiesToEven;

unsigned interpreter::getWidth(Type type) {
  return type.isIndex() ? 64 : type.getIntOrFloatBitWidth();
}

Number interpreter::getZero(Type type) {
  if (auto floating = dyn_cast<FloatType>(type))
    return APFloat::getZero(floating.getFloatSemantics());
  return APInt::getZero(getWidth(type));
}

Number interpreter::getNumber(Attribute attribute) {
  if (auto floating = dyn_cast<FloatAttr>(attribute))
    return floating.getValue();
  return cast<IntegerAttr>(attribute).getValue();
}

double interpreter::toDouble(const Number &number) {
  APFloat value = std::get<APFloat>(number);
  bool ignored;
  value.convert(APFloat::IEEEdouble(), kNearest, &ignored);
  return value.convertToDouble();
}

Number interpreter::fromDouble(long double number, Type type) {
  // The host rounds to f64; for narrower types, the f64 is rounded once more.
  APFloat value(static_cast<double>(number));
  bool ignored;
  value.convert(cast<FloatType>(type).getFloatSemantics(), kNearest, &ignored);
  return value;
}

//===----------------------------------------------------------------------===//
// Memory
//===----------------------------------------------------------------------===//

int64_t interpreter::getByteSize(Type type) {
  return llvm::PowerOf2Ceil(llvm::divideCeil(getWidth(type), 8));
}

Number interpreter::readNumber(const char *from, Type type) {
  uint64_t bits = 0;
  std::memcpy(&bits, from, getByteSize(type));
  unsigned width = getWidth(type);
  APInt raw = APInt(64, bits).trunc(width);
  if (auto floating = dyn_cast<FloatType>(type))
    return APFloat(floating.getFloatSemantics(), raw);
  return raw;
}

void interpreter::writeNumber(const Number &number, char *to) {
  const APInt *whole = std::get_if<APInt>(&number);
  APInt bits = whole ? *whole : std::get<APFloat>(number).bitcastToAPInt();
  uint64_t raw = bits.getZExtValue();
  std::memcpy(to, &raw,
              llvm::PowerOf2Ceil(llvm::divideCeil(bits.getBitWidth(), 8)));
}

//===----------------------------------------------------------------------===//
// Helpers
//===----------------------------------------------------------------------===//

namespace {
using Operands = ArrayRef<Number>;

const APInt &whole(const Number &number) { return std::get<APInt>(number); }
const APFloat &real(const Number &number) { return std::get<APFloat>(number); }
APInt flag(bool value) { return APInt(1, value); }

template <APFloat::opStatus (APFloat::*Method)(const APFloat &,
                                               APFloat::roundingMode)>
APFloat rounded(const Number &a, const Number &b) {
  APFloat result = real(a);
  (result.*Method)(real(b), kNearest);
  return result;
}
} // namespace

Number interpreter::add(const Number &a, const Number &b) {
  if (std::holds_alternative<APInt>(a))
    return whole(a) + whole(b);
  return rounded<&APFloat::add>(a, b);
}
Number interpreter::subtract(const Number &a, const Number &b) {
  if (std::holds_alternative<APInt>(a))
    return whole(a) - whole(b);
  return rounded<&APFloat::subtract>(a, b);
}
Number interpreter::multiply(const Number &a, const Number &b) {
  if (std::holds_alternative<APInt>(a))
    return whole(a) * whole(b);
  return rounded<&APFloat::multiply>(a, b);
}

Number interpreter::combine(AtomicKind kind, const Number &a, const Number &b) {
  bool isFloat = std::holds_alternative<APFloat>(a);
  switch (kind) {
  case AtomicKind::Add:
    return add(a, b);
  case AtomicKind::Sub:
    return subtract(a, b);
  case AtomicKind::Mul:
    return multiply(a, b);
  case AtomicKind::Min:
    return isFloat ? Number(llvm::minimum(real(a), real(b)))
                   : Number(llvm::APIntOps::smin(whole(a), whole(b)));
  case AtomicKind::Max:
    return isFloat ? Number(llvm::maximum(real(a), real(b)))
                   : Number(llvm::APIntOps::smax(whole(a), whole(b)));
  case AtomicKind::MinU:
    return Number(llvm::APIntOps::umin(whole(a), whole(b)));
  case AtomicKind::MaxU:
    return Number(llvm::APIntOps::umax(whole(a), whole(b)));
  case AtomicKind::And:
    return whole(a) & whole(b);
  case AtomicKind::Or:
    return whole(a) | whole(b);
  case AtomicKind::Xor:
    return whole(a) ^ whole(b);
  }
  llvm_unreachable("unknown kind");
}

//===----------------------------------------------------------------------===//
// Integers
//===----------------------------------------------------------------------===//

/// Returns the result of integer arithmetic, or that it is undefined: it
/// overflows, although the flags of the operation promise that it does not.
static Outcome wrapping(Operation *op, const APInt &result, bool asSigned,
                        bool asUnsigned) {
  auto flagged = dyn_cast<arith::ArithIntegerOverflowFlagsInterface>(op);
  if (flagged && ((asSigned && flagged.hasNoSignedWrap()) ||
                  (asUnsigned && flagged.hasNoUnsignedWrap())))
    return Outcome::undefined("the result overflows, which the operation "
                              "promises it does not");
  return result;
}

static Outcome addInts(Operation *op, Operands a, Type) {
  bool asSigned, asUnsigned;
  (void)whole(a[0]).sadd_ov(whole(a[1]), asSigned);
  (void)whole(a[0]).uadd_ov(whole(a[1]), asUnsigned);
  return wrapping(op, whole(a[0]) + whole(a[1]), asSigned, asUnsigned);
}
static Outcome subtractInts(Operation *op, Operands a, Type) {
  bool asSigned, asUnsigned;
  (void)whole(a[0]).ssub_ov(whole(a[1]), asSigned);
  (void)whole(a[0]).usub_ov(whole(a[1]), asUnsigned);
  return wrapping(op, whole(a[0]) - whole(a[1]), asSigned, asUnsigned);
}
static Outcome multiplyInts(Operation *op, Operands a, Type) {
  bool asSigned, asUnsigned;
  (void)whole(a[0]).smul_ov(whole(a[1]), asSigned);
  (void)whole(a[0]).umul_ov(whole(a[1]), asUnsigned);
  return wrapping(op, whole(a[0]) * whole(a[1]), asSigned, asUnsigned);
}

/// Divisions that have no result return the result of NumPy: a division by zero
/// returns zero; the smallest integer divided by -1 returns itself, with
/// remainder zero.
template <APInt (*Divide)(const APInt &, const APInt &), bool isSigned,
          bool isRemainder = false>
static Outcome divide(Operation *, Operands a, Type type) {
  const APInt &dividend = whole(a[0]), &divisor = whole(a[1]);
  Outcome zero(APInt::getZero(dividend.getBitWidth()));
  zero.isTolerated = true;
  if (divisor.isZero()) {
    zero.problem = "a whole number is divided by zero";
    return zero;
  }
  if (isSigned && divisor.isAllOnes() && dividend.isMinSignedValue()) {
    llvm::raw_string_ostream(zero.problem)
        << "the smallest " << type << " is divided by -1, and has no negative";
    if (!isRemainder)
      zero.number = dividend;
    return zero;
  }
  return Divide(dividend, divisor);
}

static APInt quotient(const APInt &a, const APInt &b) { return a.sdiv(b); }
static APInt remainder(const APInt &a, const APInt &b) { return a.srem(b); }
static APInt unsignedQuotient(const APInt &a, const APInt &b) {
  return a.udiv(b);
}
static APInt unsignedRemainder(const APInt &a, const APInt &b) {
  return a.urem(b);
}
static APInt floorQuotient(const APInt &a, const APInt &b) {
  APInt result = a.sdiv(b);
  bool roundsUp = !a.srem(b).isZero() && a.isNegative() != b.isNegative();
  return roundsUp ? result - 1 : result;
}
static APInt ceilQuotient(const APInt &a, const APInt &b) {
  APInt result = a.sdiv(b);
  bool roundsDown = !a.srem(b).isZero() && a.isNegative() == b.isNegative();
  return roundsDown ? result + 1 : result;
}
static APInt unsignedCeilQuotient(const APInt &a, const APInt &b) {
  return a.urem(b).isZero() ? a.udiv(b) : a.udiv(b) + 1;
}

/// Computes a shift, whose result is undefined for shifts by the width of the
/// type or more.
template <APInt (*Shift)(const APInt &, unsigned)>
static Outcome shift(Operation *op, Operands a, Type) {
  unsigned width = whole(a[0]).getBitWidth();
  if (whole(a[1]).uge(width))
    return Outcome::undefined("a number of " + Twine(width) +
                              " bits is shifted by " +
                              Twine(whole(a[1]).getSExtValue()));
  unsigned bits = whole(a[1]).getZExtValue();
  APInt result = Shift(whole(a[0]), bits);
  bool isLeft = isa<arith::ShLIOp>(op);
  return wrapping(op, result, isLeft && result.ashr(bits) != whole(a[0]),
                  isLeft && result.lshr(bits) != whole(a[0]));
}
static APInt shiftLeft(const APInt &a, unsigned bits) { return a.shl(bits); }
static APInt shiftRight(const APInt &a, unsigned bits) { return a.lshr(bits); }
static APInt shiftSign(const APInt &a, unsigned bits) { return a.ashr(bits); }

static Outcome compareInts(Operation *op, Operands operands, Type) {
  const APInt &a = whole(operands[0]), &b = whole(operands[1]);
  switch (cast<arith::CmpIOp>(op).getPredicate()) {
  case arith::CmpIPredicate::eq:
    return flag(a == b);
  case arith::CmpIPredicate::ne:
    return flag(a != b);
  case arith::CmpIPredicate::slt:
    return flag(a.slt(b));
  case arith::CmpIPredicate::sle:
    return flag(a.sle(b));
  case arith::CmpIPredicate::sgt:
    return flag(a.sgt(b));
  case arith::CmpIPredicate::sge:
    return flag(a.sge(b));
  case arith::CmpIPredicate::ult:
    return flag(a.ult(b));
  case arith::CmpIPredicate::ule:
    return flag(a.ule(b));
  case arith::CmpIPredicate::ugt:
    return flag(a.ugt(b));
  case arith::CmpIPredicate::uge:
    return flag(a.uge(b));
  }
  llvm_unreachable("unknown predicate");
}

//===----------------------------------------------------------------------===//
// Floats
//===----------------------------------------------------------------------===//

static Outcome compareFloats(Operation *op, Operands operands, Type) {
  using Predicate = arith::CmpFPredicate;
  APFloat::cmpResult order = real(operands[0]).compare(real(operands[1]));
  bool less = order == APFloat::cmpLessThan;
  bool equal = order == APFloat::cmpEqual;
  bool greater = order == APFloat::cmpGreaterThan;
  bool unordered = order == APFloat::cmpUnordered;
  switch (cast<arith::CmpFOp>(op).getPredicate()) {
  case Predicate::AlwaysFalse:
    return flag(false);
  case Predicate::OEQ:
    return flag(equal);
  case Predicate::OGT:
    return flag(greater);
  case Predicate::OGE:
    return flag(greater || equal);
  case Predicate::OLT:
    return flag(less);
  case Predicate::OLE:
    return flag(less || equal);
  case Predicate::ONE:
    return flag(less || greater);
  case Predicate::ORD:
    return flag(!unordered);
  case Predicate::UEQ:
    return flag(equal || unordered);
  case Predicate::UGT:
    return flag(greater || unordered);
  case Predicate::UGE:
    return flag(greater || equal || unordered);
  case Predicate::ULT:
    return flag(less || unordered);
  case Predicate::ULE:
    return flag(less || equal || unordered);
  case Predicate::UNE:
    return flag(!equal);
  case Predicate::UNO:
    return flag(unordered);
  case Predicate::AlwaysTrue:
    return flag(true);
  }
  llvm_unreachable("unknown predicate");
}

static Outcome convertFloat(Operation *, Operands a, Type type) {
  APFloat result = real(a[0]);
  bool ignored;
  result.convert(cast<FloatType>(type).getFloatSemantics(), kNearest, &ignored);
  return result;
}

template <bool isSigned>
static Outcome toFloat(Operation *, Operands a, Type type) {
  APFloat result(cast<FloatType>(type).getFloatSemantics());
  result.convertFromAPInt(whole(a[0]), isSigned, kNearest);
  return result;
}

template <bool isSigned>
static Outcome toInteger(Operation *, Operands a, Type type) {
  llvm::APSInt result(getWidth(type), /*isUnsigned=*/!isSigned);
  bool ignored;
  if (real(a[0]).convertToInteger(result, APFloat::rmTowardZero, &ignored) ==
      APFloat::opInvalidOp) {
    SmallString<32> text;
    real(a[0]).toString(text);
    return Outcome::undefined("no integer of " + Twine(getWidth(type)) +
                              " bits stands for " + text);
  }
  return APInt(result);
}

static Outcome bitcast(Operation *, Operands a, Type type) {
  const APInt *from = std::get_if<APInt>(&a[0]);
  APInt bits = from ? *from : real(a[0]).bitcastToAPInt();
  if (auto floating = dyn_cast<FloatType>(type))
    return APFloat(floating.getFloatSemantics(), bits);
  return bits;
}

template <APFloat::roundingMode mode>
static Outcome toIntegral(Operation *, Operands a, Type) {
  APFloat result = real(a[0]);
  result.roundToIntegral(mode);
  return result;
}

/// Calls a function of the host on long double. The result is rounded to f64,
/// and for narrower types once more.
template <long double (*Function)(long double)>
static Outcome call(Operation *, Operands a, Type type) {
  return fromDouble(Function(toDouble(a[0])), type);
}
template <long double (*Function)(long double, long double)>
static Outcome call(Operation *, Operands a, Type type) {
  return fromDouble(Function(toDouble(a[0]), toDouble(a[1])), type);
}

static Outcome squareRoot(Operation *, Operands a, Type type) {
  // The host rounds square roots correctly to f64. For a type with at most half
  // the digits, rounding once more gives the correctly rounded square root,
  // too.
  return fromDouble(std::sqrt(toDouble(a[0])), type);
}

static Outcome clamp(Operation *, Operands a, Type) {
  return llvm::minimum(llvm::maximum(real(a[0]), real(a[1])), real(a[2]));
}

static Outcome multiplyAdd(Operation *, Operands a, Type) {
  APFloat result = real(a[0]);
  result.fusedMultiplyAdd(real(a[1]), real(a[2]), kNearest);
  return result;
}

static long double reciprocalRoot(long double x) { return 1 / std::sqrt(x); }

//===----------------------------------------------------------------------===//
// The table
//===----------------------------------------------------------------------===//

/// The functions that compute elementwise operations, by the name of the
/// operation.
static const llvm::StringMap<ScalarFunction> &getFunctions() {
  static const llvm::StringMap<ScalarFunction> functions = {
      {"arith.addi", addInts},
      {"arith.subi", subtractInts},
      {"arith.muli", multiplyInts},
      {"arith.divsi", divide<quotient, true>},
      {"arith.divui", divide<unsignedQuotient, false>},
      {"arith.floordivsi", divide<floorQuotient, true>},
      {"arith.ceildivsi", divide<ceilQuotient, true>},
      {"arith.ceildivui", divide<unsignedCeilQuotient, false>},
      {"arith.remsi", divide<remainder, true, true>},
      {"arith.remui", divide<unsignedRemainder, false, true>},
      {"arith.shli", shift<shiftLeft>},
      {"arith.shrui", shift<shiftRight>},
      {"arith.shrsi", shift<shiftSign>},
      {"arith.cmpi", compareInts},
      {"arith.cmpf", compareFloats},
      {"arith.extf", convertFloat},
      {"arith.truncf", convertFloat},
      {"arith.sitofp", toFloat<true>},
      {"arith.uitofp", toFloat<false>},
      {"arith.fptosi", toInteger<true>},
      {"arith.fptoui", toInteger<false>},
      {"arith.bitcast", bitcast},
      {"arith.andi",
       [](Operation *, Operands a, Type) -> Outcome {
         return whole(a[0]) & whole(a[1]);
       }},
      {"arith.ori",
       [](Operation *, Operands a, Type) -> Outcome {
         return whole(a[0]) | whole(a[1]);
       }},
      {"arith.xori",
       [](Operation *, Operands a, Type) -> Outcome {
         return whole(a[0]) ^ whole(a[1]);
       }},
      {"arith.minsi",
       [](Operation *, Operands a, Type) -> Outcome {
         return llvm::APIntOps::smin(whole(a[0]), whole(a[1]));
       }},
      {"arith.maxsi",
       [](Operation *, Operands a, Type) -> Outcome {
         return llvm::APIntOps::smax(whole(a[0]), whole(a[1]));
       }},
      {"arith.minui",
       [](Operation *, Operands a, Type) -> Outcome {
         return llvm::APIntOps::umin(whole(a[0]), whole(a[1]));
       }},
      {"arith.maxui",
       [](Operation *, Operands a, Type) -> Outcome {
         return llvm::APIntOps::umax(whole(a[0]), whole(a[1]));
       }},
      {"arith.extsi",
       [](Operation *, Operands a, Type type) -> Outcome {
         return whole(a[0]).sext(getWidth(type));
       }},
      {"arith.extui",
       [](Operation *, Operands a, Type type) -> Outcome {
         return whole(a[0]).zext(getWidth(type));
       }},
      {"arith.trunci",
       [](Operation *op, Operands a, Type type) -> Outcome {
         APInt result = whole(a[0]).trunc(getWidth(type));
         unsigned width = whole(a[0]).getBitWidth();
         return wrapping(op, result, result.sext(width) != whole(a[0]),
                         result.zext(width) != whole(a[0]));
       }},
      {"arith.index_cast",
       [](Operation *, Operands a, Type type) -> Outcome {
         return whole(a[0]).sextOrTrunc(getWidth(type));
       }},
      {"arith.index_castui",
       [](Operation *, Operands a, Type type) -> Outcome {
         return whole(a[0]).zextOrTrunc(getWidth(type));
       }},
      {"arith.addf",
       [](Operation *, Operands a, Type) -> Outcome {
         return add(a[0], a[1]);
       }},
      {"arith.subf",
       [](Operation *, Operands a, Type) -> Outcome {
         return subtract(a[0], a[1]);
       }},
      {"arith.mulf",
       [](Operation *, Operands a, Type) -> Outcome {
         return multiply(a[0], a[1]);
       }},
      {"arith.divf",
       [](Operation *, Operands a, Type) -> Outcome {
         return rounded<&APFloat::divide>(a[0], a[1]);
       }},
      {"arith.remf",
       [](Operation *, Operands a, Type) -> Outcome {
         APFloat result = real(a[0]);
         result.mod(real(a[1]));
         return result;
       }},
      {"arith.negf",
       [](Operation *, Operands a, Type) -> Outcome { return -real(a[0]); }},
      {"arith.minimumf",
       [](Operation *, Operands a, Type) -> Outcome {
         return llvm::minimum(real(a[0]), real(a[1]));
       }},
      {"arith.maximumf",
       [](Operation *, Operands a, Type) -> Outcome {
         return llvm::maximum(real(a[0]), real(a[1]));
       }},
      {"arith.minnumf",
       [](Operation *, Operands a, Type) -> Outcome {
         return llvm::minnum(real(a[0]), real(a[1]));
       }},
      {"arith.maxnumf",
       [](Operation *, Operands a, Type) -> Outcome {
         return llvm::maxnum(real(a[0]), real(a[1]));
       }},
      {"math.absf",
       [](Operation *, Operands a, Type) -> Outcome {
         return llvm::abs(real(a[0]));
       }},
      {"math.absi",
       [](Operation *, Operands a, Type) -> Outcome {
         return whole(a[0]).abs();
       }},
      {"math.copysign",
       [](Operation *, Operands a, Type) -> Outcome {
         return APFloat::copySign(real(a[0]), real(a[1]));
       }},
      {"math.ctpop",
       [](Operation *, Operands a, Type type) -> Outcome {
         return APInt(getWidth(type), whole(a[0]).popcount());
       }},
      {"math.ctlz",
       [](Operation *, Operands a, Type type) -> Outcome {
         return APInt(getWidth(type), whole(a[0]).countl_zero());
       }},
      {"math.cttz",
       [](Operation *, Operands a, Type type) -> Outcome {
         return APInt(getWidth(type), whole(a[0]).countr_zero());
       }},
      {"math.isnan",
       [](Operation *, Operands a, Type) -> Outcome {
         return flag(real(a[0]).isNaN());
       }},
      {"math.isinf",
       [](Operation *, Operands a, Type) -> Outcome {
         return flag(real(a[0]).isInfinity());
       }},
      {"math.isfinite",
       [](Operation *, Operands a, Type) -> Outcome {
         return flag(real(a[0]).isFinite());
       }},
      {"math.isnormal",
       [](Operation *, Operands a, Type) -> Outcome {
         return flag(real(a[0]).isNormal());
       }},
      {"math.floor", toIntegral<APFloat::rmTowardNegative>},
      {"math.ceil", toIntegral<APFloat::rmTowardPositive>},
      {"math.trunc", toIntegral<APFloat::rmTowardZero>},
      {"math.round", toIntegral<APFloat::rmNearestTiesToAway>},
      {"math.roundeven", toIntegral<APFloat::rmNearestTiesToEven>},
      {"math.sqrt", squareRoot},
      {"math.fma", multiplyAdd},
      {"math.clampf", clamp},
      {"math.rsqrt", call<reciprocalRoot>},
      {"math.cbrt", call<std::cbrt>},
      {"math.sin", call<std::sin>},
      {"math.cos", call<std::cos>},
      {"math.tan", call<std::tan>},
      {"math.asin", call<std::asin>},
      {"math.acos", call<std::acos>},
      {"math.atan", call<std::atan>},
      {"math.atan2", call<std::atan2>},
      {"math.sinh", call<std::sinh>},
      {"math.cosh", call<std::cosh>},
      {"math.tanh", call<std::tanh>},
      {"math.asinh", call<std::asinh>},
      {"math.acosh", call<std::acosh>},
      {"math.atanh", call<std::atanh>},
      {"math.exp", call<std::exp>},
      {"math.exp2", call<std::exp2>},
      {"math.expm1", call<std::expm1>},
      {"math.log", call<std::log>},
      {"math.log2", call<std::log2>},
      {"math.log10", call<std::log10>},
      {"math.log1p", call<std::log1p>},
      {"math.erf", call<std::erf>},
      {"math.erfc", call<std::erfc>},
      {"math.powf", call<std::pow>},
      {"math.fpowi",
       [](Operation *, Operands a, Type type) -> Outcome {
         return fromDouble(
             std::pow(static_cast<long double>(toDouble(a[0])), toIndex(a[1])),
             type);
       }},
      {"vector.fma", multiplyAdd},
  };
  return functions;
}

ScalarFunction interpreter::findScalarFunction(StringRef name) {
  return getFunctions().lookup(name);
}
