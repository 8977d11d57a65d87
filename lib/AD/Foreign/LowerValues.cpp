//===- LowerValues.cpp - Complex numbers, and LLVM's arithmetic -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Derivative rules are about real numbers: a complex number becomes two of
// them, also where a loop carries it. Arithmetic of the LLVM dialect becomes
// that of arith and math.
//===----------------------------------------------------------------------===//

#include "mlir/Conversion/ComplexToStandard/ComplexToStandard.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Complex/IR/Complex.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/Transforms/Patterns.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/Transforms/DialectConversion.h"
#include "tai/AD/Foreign/Foreign.h"

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Complex numbers
//===----------------------------------------------------------------------===//

/// Changes loops and branches so that they carry and yield the real and
/// imaginary parts of a complex number as two values.
static LogicalResult splitCarried(func::FuncOp function) {
  MLIRContext *context = function.getContext();
  TypeConverter converter;
  converter.addConversion([](Type type) { return type; });
  converter.addConversion(
      [](ComplexType type, SmallVectorImpl<Type> &types) -> LogicalResult {
        types.append(2, type.getElementType());
        return success();
      });
  converter.addSourceMaterialization(
      [](OpBuilder &b, ComplexType type, ValueRange parts, Location loc) {
        return complex::CreateOp::create(b, loc, type, parts[0], parts[1])
            .getResult();
      });
  converter.addTargetMaterialization([](OpBuilder &b, TypeRange,
                                        ValueRange values,
                                        Location loc) -> SmallVector<Value> {
    if (values.size() != 1)
      return {};
    return {complex::ReOp::create(b, loc, values[0]),
            complex::ImOp::create(b, loc, values[0])};
  });
  RewritePatternSet patterns(context);
  ConversionTarget target(*context);
  target.markUnknownOpDynamicallyLegal([](Operation *) { return true; });
  scf::populateSCFStructuralTypeConversionsAndLegality(converter, patterns,
                                                       target);
  return applyPartialConversion(function, target, std::move(patterns));
}

static void splitSelects(func::FuncOp function) {
  SmallVector<arith::SelectOp> selects;
  function.walk([&](arith::SelectOp op) {
    if (isa<ComplexType>(op.getType()))
      selects.push_back(op);
  });
  for (arith::SelectOp op : selects) {
    ImplicitLocOpBuilder b(op.getLoc(), op);
    auto choose = [&](auto part) -> Value {
      return arith::SelectOp::create(b, op.getCondition(),
                                     part(op.getTrueValue()),
                                     part(op.getFalseValue()));
    };
    Value re = choose([&](Value z) { return complex::ReOp::create(b, z); });
    Value im = choose([&](Value z) { return complex::ImOp::create(b, z); });
    Value made = complex::CreateOp::create(b, op.getType(), re, im);
    op.replaceAllUsesWith(made);
    op.erase();
  }
}

static bool isComplexArray(Value value) {
  auto type = dyn_cast<MemRefType>(value.getType());
  return type && isa<ComplexType>(type.getElementType()) &&
         isa_and_present<memref::AllocOp, memref::AllocaOp>(
             value.getDefiningOp());
}

bool mlir::tai::hasComplexArrays(func::FuncOp function) {
  return function
      .walk([](Operation *op) {
        return op->getNumResults() == 1 && isComplexArray(op->getResult(0))
                   ? WalkResult::interrupt()
                   : WalkResult::advance();
      })
      .wasInterrupted();
}

/// True if all accesses of an array are those that `splitArrays` knows.
static bool canSplit(Value array) {
  return llvm::all_of(array.getUsers(), [&](Operation *user) {
    if (auto copy = dyn_cast<memref::CopyOp>(user))
      return isComplexArray(copy.getSource()) &&
             isComplexArray(copy.getTarget());
    return isa<memref::LoadOp, memref::StoreOp, memref::DeallocOp,
               memref::DimOp>(user);
  });
}

/// Replaces each array of complex numbers that the function makes by one of
/// real and one of imaginary parts.
static void splitArrays(func::FuncOp function) {
  SmallVector<Operation *> makers;
  bool canAll = true;
  function.walk([&](Operation *op) {
    if (op->getNumResults() == 1 && isComplexArray(op->getResult(0))) {
      makers.push_back(op);
      canAll &= canSplit(op->getResult(0));
    }
  });
  if (!canAll)
    return;
  DenseMap<Value, std::array<Value, 2>> parts;
  for (Operation *op : makers) {
    OpBuilder b(op);
    Value array = op->getResult(0);
    auto type = cast<MemRefType>(array.getType());
    auto element = cast<ComplexType>(type.getElementType()).getElementType();
    for (Value &part : parts[array]) {
      Operation *made = b.clone(*op);
      made->getResult(0).setType(
          MemRefType::Builder(type).setElementType(element));
      part = made->getResult(0);
    }
  }
  for (Operation *maker : makers) {
    Value array = maker->getResult(0);
    std::array<Value, 2> split = parts[array];
    for (Operation *user : llvm::make_early_inc_range(array.getUsers())) {
      ImplicitLocOpBuilder b(user->getLoc(), user);
      if (auto load = dyn_cast<memref::LoadOp>(user)) {
        Value made = complex::CreateOp::create(
            b, load.getType(),
            memref::LoadOp::create(b, split[0], load.getIndices()),
            memref::LoadOp::create(b, split[1], load.getIndices()));
        load.replaceAllUsesWith(made);
      } else if (auto store = dyn_cast<memref::StoreOp>(user)) {
        Value value = store.getValueToStore();
        memref::StoreOp::create(b, complex::ReOp::create(b, value), split[0],
                                store.getIndices());
        memref::StoreOp::create(b, complex::ImOp::create(b, value), split[1],
                                store.getIndices());
      } else if (auto copy = dyn_cast<memref::CopyOp>(user)) {
        for (int part : {0, 1})
          memref::CopyOp::create(b, parts[copy.getSource()][part],
                                 parts[copy.getTarget()][part]);
      } else if (auto size = dyn_cast<memref::DimOp>(user)) {
        size.getSourceMutable().assign(split[0]);
        continue;
      } else {
        for (Value part : split)
          memref::DeallocOp::create(b, part);
      }
      user->erase();
    }
  }
  for (Operation *maker : makers)
    maker->erase();
}

LogicalResult mlir::tai::splitComplex(func::FuncOp function) {
  bool any = false;
  function.walk([&](Operation *op) {
    any |= isa_and_present<complex::ComplexDialect>(op->getDialect());
  });
  if (!any)
    return success();
  splitArrays(function);
  if (failed(splitCarried(function)))
    return failure();
  splitSelects(function);
  MLIRContext *context = function.getContext();
  RewritePatternSet patterns(context);
  populateComplexToStandardConversionPatterns(patterns);
  ConversionTarget target(*context);
  target.markUnknownOpDynamicallyLegal([](Operation *) { return true; });
  target.addIllegalDialect<complex::ComplexDialect>();
  target.addLegalOp<complex::CreateOp, complex::ReOp, complex::ImOp,
                    complex::ConstantOp>();
  if (failed(applyPartialConversion(function, target, std::move(patterns))))
    return failure();
  // Powers and signs are lowered to a choice between complex numbers.
  splitSelects(function);
  return success();
}

//===----------------------------------------------------------------------===//
// LLVM
//===----------------------------------------------------------------------===//

namespace {
struct OpPair {
  StringLiteral from, to;
};
} // namespace

/// Pairs of an LLVM dialect op and the arith or math op that computes the same,
/// with equal operands and results.
static constexpr OpPair kArithmetic[] = {
    {"llvm.fadd", "arith.addf"},
    {"llvm.fsub", "arith.subf"},
    {"llvm.fmul", "arith.mulf"},
    {"llvm.fdiv", "arith.divf"},
    {"llvm.frem", "arith.remf"},
    {"llvm.fneg", "arith.negf"},
    {"llvm.fpext", "arith.extf"},
    {"llvm.fptrunc", "arith.truncf"},
    {"llvm.select", "arith.select"},
    {"llvm.sitofp", "arith.sitofp"},
    {"llvm.uitofp", "arith.uitofp"},
    {"llvm.intr.copysign", "math.copysign"},
    {"llvm.intr.cos", "math.cos"},
    {"llvm.intr.exp", "math.exp"},
    {"llvm.intr.exp2", "math.exp2"},
    {"llvm.intr.fabs", "math.absf"},
    {"llvm.intr.fma", "math.fma"},
    {"llvm.intr.fmuladd", "math.fma"},
    {"llvm.intr.log", "math.log"},
    {"llvm.intr.log10", "math.log10"},
    {"llvm.intr.log2", "math.log2"},
    {"llvm.intr.maximum", "arith.maximumf"},
    {"llvm.intr.maxnum", "arith.maxnumf"},
    {"llvm.intr.minimum", "arith.minimumf"},
    {"llvm.intr.minnum", "arith.minnumf"},
    {"llvm.intr.pow", "math.powf"},
    {"llvm.intr.sin", "math.sin"},
    {"llvm.intr.sqrt", "math.sqrt"},
    {"llvm.intr.tan", "math.tan"},
    {"llvm.intr.tanh", "math.tanh"},
};

void mlir::tai::liftArithmetic(func::FuncOp function) {
  SmallVector<std::pair<Operation *, StringRef>> ops;
  function.walk([&](Operation *op) {
    if (!isa_and_present<LLVM::LLVMDialect>(op->getDialect()) ||
        op->getNumResults() != 1 ||
        !isa<FloatType>(getElementTypeOrSelf(op->getResult(0).getType())))
      return;
    StringRef name = op->getName().getStringRef();
    for (const OpPair &pair : kArithmetic)
      if (pair.from == name)
        ops.push_back({op, pair.to});
    if (auto constant = dyn_cast<LLVM::ConstantOp>(op))
      if (isa<FloatAttr, DenseFPElementsAttr>(constant.getValue()))
        ops.push_back({op, arith::ConstantOp::getOperationName()});
  });
  for (auto [op, name] : ops) {
    OpBuilder b(op);
    OperationState state(op->getLoc(), name, op->getOperands(),
                         op->getResultTypes());
    if (auto constant = dyn_cast<LLVM::ConstantOp>(op))
      state.addAttribute("value", constant.getValue());
    Operation *made = b.create(state);
    op->replaceAllUsesWith(made);
    op->erase();
  }
}
