//===- WidenArithmetic.cpp - Arithmetic wider than storage ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Values of a kernel change their types in place, from narrow floats to the
// wide one. Operations whose types are determined by a field or an argument
// keep them, with casts around.
//
//===----------------------------------------------------------------------===//

#include "tai/Transforms/Simplify/WidenArithmetic.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/Pass/Pass.h"
#include "tai/Dialect/Tai/IR/Modes.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
class Widening {
public:
  Widening(KernelOp kernel, FloatType target)
      : kernel(kernel), target(target) {}

  void run();

private:
  bool isNarrow(Type type);
  Type widen(Type type);
  bool isOwnMemory(Value memory);
  bool keepsTypes(Operation *op);
  void widenAttributes(Operation *op);
  /// Makes all users of `value`, which is narrow, use a widened copy.
  void widenUses(OpBuilder &builder, Value value);
  void keep(Operation *op, ArrayRef<Type> operandTypes);

  KernelOp kernel;
  FloatType target;
};
} // namespace

bool Widening::isNarrow(Type type) {
  if (auto memory = dyn_cast<MemRefType>(type))
    return isNarrow(memory.getElementType());
  if (auto local = dyn_cast<LocalType>(type))
    return isNarrow(local.getElementType());
  auto element = dyn_cast<FloatType>(getElementTypeOrSelf(type));
  return element && element.getWidth() < target.getWidth();
}

Type Widening::widen(Type type) {
  if (!isNarrow(type))
    return type;
  if (auto memory = dyn_cast<MemRefType>(type))
    return MemRefType::get(memory.getShape(), widen(memory.getElementType()),
                           memory.getLayout(), memory.getMemorySpace());
  if (auto local = dyn_cast<LocalType>(type))
    return LocalType::get(type.getContext(), widen(local.getElementType()));
  if (auto vector = dyn_cast<VectorType>(type))
    return vector.clone(target);
  return target;
}

/// True for memory of an array that the kernel itself allocates.
bool Widening::isOwnMemory(Value memory) {
  return isa_and_nonnull<memref::AllocaOp, AllocaOp>(memory.getDefiningOp());
}

/// True if the types of the operation follow from types that this pass does not
/// change.
bool Widening::keepsTypes(Operation *op) {
  if (isa<memref::AllocaOp, AllocaOp, LocalLoadOp, LocalStoreOp>(op))
    return false;
  if (isa<memref::LoadOp, memref::StoreOp, memref::AtomicRMWOp>(op))
    return llvm::none_of(op->getOperands(),
                         [&](Value operand) { return isOwnMemory(operand); });
  if (isa<arith::BitcastOp, arith::ExtFOp, arith::TruncFOp, vector::BitCastOp,
          RandomOp, ReturnOp>(op) ||
      isa<FieldAccessOpInterface>(op))
    return true;
  if (isa<ParallelForOp, YieldOp, AssertOp, PrintOp, PreconditionOp>(op))
    return false;
  StringRef dialect = op->getName().getDialectNamespace();
  if (dialect == "tai")
    return !isMemoryEffectFree(op);
  return !llvm::is_contained({"arith", "math", "scf", "vector"}, dialect);
}

static Attribute widenNumber(Attribute attr, Type type, FloatType target) {
  auto widen = [&](APFloat value) {
    bool lost = false;
    value.convert(target.getFloatSemantics(), APFloat::rmNearestTiesToEven,
                  &lost);
    return value;
  };
  if (auto number = dyn_cast<FloatAttr>(attr))
    return FloatAttr::get(target, widen(number.getValue()));
  auto numbers = dyn_cast<DenseFPElementsAttr>(attr);
  if (!numbers)
    return attr;
  auto shaped = cast<ShapedType>(type);
  if (numbers.isSplat())
    return DenseElementsAttr::get(shaped,
                                  widen(numbers.getSplatValue<APFloat>()));
  SmallVector<APFloat> values;
  for (APFloat value : numbers.getValues<APFloat>())
    values.push_back(widen(value));
  return DenseElementsAttr::get(shaped, values);
}

void Widening::widenAttributes(Operation *op) {
  // A constant of the type to be widened gets a widened value; a constant of a
  // wider type stays as it is.
  if (auto constant = dyn_cast<arith::ConstantOp>(op);
      constant && getElementTypeOrSelf(constant.getType()) == target)
    constant.setValueAttr(cast<TypedAttr>(
        widenNumber(constant.getValue(), constant.getType(), target)));
}

void Widening::widenUses(OpBuilder &builder, Value value) {
  if (value.use_empty())
    return;
  auto cast = arith::ExtFOp::create(builder, value.getLoc(),
                                    widen(value.getType()), value);
  value.replaceAllUsesExcept(cast, cast);
}

/// Keeps the types of `op`: casts its operands back to `operandTypes`, and
/// widens its results.
void Widening::keep(Operation *op, ArrayRef<Type> operandTypes) {
  OpBuilder builder(op);
  // An extension to the wide type is redundant if its operand now has the wide
  // type.
  if (auto extension = dyn_cast<arith::ExtFOp>(op);
      extension && extension.getIn().getType() == widen(extension.getType())) {
    extension.replaceAllUsesWith(extension.getIn());
    extension.erase();
    return;
  }
  if (!isa<arith::ExtFOp, arith::TruncFOp>(op))
    for (auto [operand, type] :
         llvm::zip_equal(op->getOpOperands(), operandTypes))
      if (operand.get().getType() != type && !isa<MemRefType>(type))
        operand.set(arith::TruncFOp::create(builder, op->getLoc(), type,
                                            operand.get()));
  builder.setInsertionPointAfter(op);
  for (Value result : op->getResults())
    if (!isa<MemRefType>(result.getType()) && isNarrow(result.getType()))
      widenUses(builder, result);
}

void Widening::run() {
  // An op whose types do not change, and the types that its operands had before
  // other types changed.
  struct Kept {
    Operation *op;
    SmallVector<Type> operandTypes;
  };
  SmallVector<Kept> kept;
  SmallVector<Operation *> widened;
  kernel.getBody().walk([&](Operation *op) {
    if (keepsTypes(op))
      kept.push_back({op, SmallVector<Type>(op->getOperandTypes())});
    else
      widened.push_back(op);
  });
  for (Operation *op : widened) {
    for (Value result : op->getResults())
      result.setType(widen(result.getType()));
    for (Region &region : op->getRegions())
      for (BlockArgument argument : region.getArguments())
        argument.setType(widen(argument.getType()));
    widenAttributes(op);
  }
  OpBuilder builder(kernel.getContext());
  builder.setInsertionPointToStart(&kernel.getBody().front());
  for (BlockArgument argument : kernel.getBody().getArguments())
    if (!isa<MemRefType>(argument.getType()) && isNarrow(argument.getType()))
      widenUses(builder, argument);
  for (Kept &one : kept)
    keep(one.op, one.operandTypes);
}

namespace {
struct WidenArithmetic : PassWrapper<WidenArithmetic, OperationPass<KernelOp>> {
  MLIR_DEFINE_EXPLICIT_INTERNAL_INLINE_TYPE_ID(WidenArithmetic)

  StringRef getArgument() const override { return "tai-widen-arithmetic"; }
  StringRef getDescription() const override {
    return "compute in wider floats than fields hold, as kernels say";
  }
  void getDependentDialects(DialectRegistry &registry) const override {
    registry.insert<arith::ArithDialect>();
  }

  void runOnOperation() override {
    KernelOp kernel = getOperation();
    MLIRContext *context = &getContext();
    switch (Modes::of(kernel).precision.value_or(Precision::Default)) {
    case Precision::Default:
      return;
    case Precision::F64:
      return Widening(kernel, Float64Type::get(context)).run();
    case Precision::F32:
      return Widening(kernel, Float32Type::get(context)).run();
    }
  }
};
} // namespace

std::unique_ptr<Pass> tai::createWidenArithmetic() {
  return std::make_unique<WidenArithmetic>();
}

void tai::registerWidenArithmetic() { PassRegistration<WidenArithmetic>(); }
