//===- GuardDivisions.cpp - Divisions of integers that cannot trap --------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Division by zero, and of the smallest integer by -1, traps on the CPU and is
// undefined on a GPU. Here both have the same result as in NumPy. Divisions
// that cannot trap cost nothing: most divisors are constants or extents.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "tai/Analysis/Index/IntegerRanges.h"
#include "tai/Dialect/Check/IR/Check.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_GUARDDIVISIONS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

static constexpr StringLiteral kByZero = "a whole number is divided by zero";

static bool isSignedDivision(Operation *op) {
  return isa<arith::DivSIOp, arith::RemSIOp, arith::FloorDivSIOp,
             arith::CeilDivSIOp>(op);
}

static bool isDivision(Operation *op) {
  return isSignedDivision(op) ||
         isa<arith::DivUIOp, arith::RemUIOp, arith::CeilDivUIOp>(op);
}

/// Returns the error message "the smallest i32 is divided by -1, and ...".
static std::string describeOverflow(Type type) {
  std::string text;
  llvm::raw_string_ostream(text)
      << "the smallest " << getElementTypeOrSelf(type)
      << " is divided by -1, and has no negative";
  return text;
}

namespace {
/// Guards one division.
class Guard {
public:
  Guard(Operation *op, IntegerRanges &ranges, bool checked)
      : op(op), type(op->getResult(0).getType()), checked(checked),
        dividend(ranges.get(op->getOperand(0))),
        divisor(ranges.get(op->getOperand(1))), builder(op) {}

  LogicalResult run();

private:
  Value constant(const APInt &value);
  Value equals(Value value, const APInt &to);
  /// In debug mode, makes the kernel report `message` where the condition
  /// `broken` holds.
  void check(Value broken, StringRef message);

  Operation *op;
  Type type;
  bool checked;
  ConstantIntRanges dividend, divisor;
  OpBuilder builder;
};
} // namespace

Value Guard::constant(const APInt &value) {
  TypedAttr attr =
      builder.getIntegerAttr(getElementTypeOrSelf(type), value.getSExtValue());
  if (auto shaped = dyn_cast<ShapedType>(type))
    attr = DenseElementsAttr::get(shaped, Attribute(attr));
  return arith::ConstantOp::create(builder, op->getLoc(), attr);
}

Value Guard::equals(Value value, const APInt &to) {
  return arith::CmpIOp::create(builder, op->getLoc(), arith::CmpIPredicate::eq,
                               value, constant(to));
}

void Guard::check(Value broken, StringRef message) {
  if (!checked)
    return;
  Location loc = op->getLoc();
  if (isa<VectorType>(broken.getType()))
    broken = vector::ReductionOp::create(builder, loc,
                                         vector::CombiningKind::OR, broken);
  Value yes = arith::ConstantIntOp::create(builder, loc, 1, 1);
  Value holds = arith::XOrIOp::create(builder, loc, broken, yes);
  AssertOp::create(builder, loc, holds, builder.getStringAttr(message),
                   ValueRange());
}

LogicalResult Guard::run() {
  unsigned width = divisor.smin().getBitWidth();
  APInt zero = APInt::getZero(width), one(width, 1);
  APInt minusOne = APInt::getAllOnes(width);
  APInt smallest = APInt::getSignedMinValue(width);
  auto mayBe = [](const ConstantIntRanges &range, const APInt &value) {
    return range.umin().ule(value) && value.ule(range.umax()) &&
           range.smin().sle(value) && value.sle(range.smax());
  };
  bool byZero = mayBe(divisor, zero);
  bool overflows = isSignedDivision(op) && mayBe(divisor, minusOne) &&
                   mayBe(dividend, smallest);
  if (divisor.getConstantValue() == zero)
    return op->emitError(kByZero);
  if (overflows && divisor.getConstantValue() == minusOne &&
      dividend.getConstantValue() == smallest)
    return op->emitError(describeOverflow(type));
  if (!byZero && !overflows)
    return success();

  Location loc = op->getLoc();
  Value isZero, isUnsafe;
  if (byZero) {
    isUnsafe = isZero = equals(op->getOperand(1), zero);
    check(isZero, kByZero);
  }
  if (overflows) {
    Value isOverflow =
        arith::AndIOp::create(builder, loc, equals(op->getOperand(1), minusOne),
                              equals(op->getOperand(0), smallest));
    check(isOverflow, describeOverflow(type));
    isUnsafe = isUnsafe
                   ? arith::OrIOp::create(builder, loc, isUnsafe, isOverflow)
                         .getResult()
                   : isOverflow;
  }
  // Where the division is unsafe, its divisor becomes one: the quotient is then
  // the dividend, such as the smallest integer, and the remainder zero.
  op->setOperand(1, arith::SelectOp::create(builder, loc, isUnsafe,
                                            constant(one), op->getOperand(1)));
  // A remainder by one is zero already.
  if (!byZero || isa<arith::RemSIOp, arith::RemUIOp>(op))
    return success();
  builder.setInsertionPointAfter(op);
  Value result = op->getResult(0);
  auto chosen =
      arith::SelectOp::create(builder, loc, isZero, constant(zero), result);
  result.replaceAllUsesExcept(chosen, chosen);
  return success();
}

namespace {
struct GuardDivisions : tai::impl::GuardDivisionsBase<GuardDivisions> {
  using Base::Base;

  void runOnOperation() override {
    bool good = true;
    auto run = [&](Operation *function) {
      SmallVector<Operation *> divisions;
      function->walk([&](Operation *op) {
        if (isDivision(op))
          divisions.push_back(op);
      });
      if (divisions.empty() || !isTaiCode(function))
        return;
      IntegerRanges ranges;
      for (Operation *op : divisions)
        good &= succeeded(Guard(op, ranges, debug).run());
    };
    if (auto module = dyn_cast<ModuleOp>(getOperation()))
      for (Operation &function : *module.getBody())
        run(&function);
    else
      run(getOperation());
    if (!good)
      signalPassFailure();
  }
};
} // namespace
