//===- Soft.cpp - Two ops that tai learns to differentiate ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A small dialect outside of tai's tree. `soft.plus` implements the interface
// of differentiable ops, `soft.read` that of accesses to fields;
// `vector.interleave`, which belongs to upstream and has no rule in tai, gets
// one by an external model. No pass of tai refers to these ops.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/Pass/Pass.h"
#include "mlir/Tools/Plugins/DialectPlugin.h"
#include "mlir/Tools/Plugins/PassPlugin.h"
#include "tai/AD/Reverse/AdjointBuilder.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Interfaces/Differentiable.h"
#include "tai/Interfaces/FieldAccess.h"

#include "SoftDialect.h.inc"
#define GET_OP_CLASSES
#include "SoftOps.h.inc"

#include "SoftDialect.cpp.inc"
#define GET_OP_CLASSES
#include "SoftOps.cpp.inc"

using namespace mlir;

void soft::SoftDialect::initialize() {
  addOperations<
#define GET_OP_LIST
#include "SoftOps.cpp.inc"
      >();
}

// The adjoint of x gets g / (1 + exp(-x)). `getPrimal` has x recomputed in the
// adjoint, and nothing that is not asked for is.
LogicalResult soft::PlusOp::buildAdjoint(tai::AdjointBuilder &b) {
  Value g = b.getAdjoint(getResult());
  Value minus = arith::NegFOp::create(b, b.getPrimal(getValue()));
  Value one = b.createConstant(getType(), 1.0);
  Value divisor = arith::AddFOp::create(b, one, math::ExpOp::create(b, minus));
  b.addAdjoint(getValue(), arith::DivFOp::create(b, g, divisor));
  return success();
}

tai::FieldAccess soft::ReadOp::getFieldAccess() {
  return tai::FieldAccess::Read;
}
Value soft::ReadOp::getAccessedValue() { return getValue(); }
void soft::ReadOp::getEffects(
    SmallVectorImpl<MemoryEffects::EffectInstance> &effects) {
  tai::addFieldEffects(effects, getFieldAccess(), getFieldAttr());
}

namespace {

/// vector.interleave %a, %b: component k of the result is component k / 2 of
/// one of them, in turn.
struct InterleaveModel
    : tai::DifferentiableOpInterface::ExternalModel<InterleaveModel,
                                                    vector::InterleaveOp> {
  LogicalResult buildAdjoint(Operation *op, tai::AdjointBuilder &b) const {
    SmallVector<Value> seeds = b.getAdjointComponents(op->getResult(0));
    for (auto [k, seed] : llvm::enumerate(seeds))
      b.addAdjointComponent(op->getOperand(k % 2), k / 2, seed);
    return success();
  }
};

/// soft.read in terms of tai, and soft.plus in terms of upstream:
/// max(x, 0) + log1p(exp(-|x|)).
struct LowerSoft : PassWrapper<LowerSoft, OperationPass<>> {
  MLIR_DEFINE_EXPLICIT_INTERNAL_INLINE_TYPE_ID(LowerSoft)
  StringRef getArgument() const final { return "lower-soft"; }
  StringRef getDescription() const final { return "lower soft to math"; }
  void getDependentDialects(DialectRegistry &registry) const final {
    registry.insert<arith::ArithDialect, math::MathDialect, tai::TaiDialect>();
  }

  void runOnOperation() final {
    getOperation()->walk([](soft::ReadOp op) {
      OpBuilder b(op);
      Value x = tai::LoadOp::create(b, op.getLoc(), op.getType(),
                                    op.getFieldAttr(), op.getIndices());
      op.replaceAllUsesWith(
          soft::PlusOp::create(b, op.getLoc(), x.getType(), x).getResult());
      op.erase();
    });
    getOperation()->walk([](soft::PlusOp op) {
      OpBuilder b(op);
      Location loc = op.getLoc();
      Value x = op.getValue();
      Value zero =
          arith::ConstantOp::create(b, loc, b.getFloatAttr(op.getType(), 0.0));
      Value minus =
          arith::NegFOp::create(b, loc, math::AbsFOp::create(b, loc, x));
      Value tail =
          math::Log1pOp::create(b, loc, math::ExpOp::create(b, loc, minus));
      Value ramp = arith::MaximumFOp::create(b, loc, x, zero);
      op.replaceAllUsesWith(
          arith::AddFOp::create(b, loc, ramp, tail).getResult());
      op.erase();
    });
  }
};
} // namespace

extern "C" LLVM_ATTRIBUTE_WEAK DialectPluginLibraryInfo
mlirGetDialectPluginInfo() {
  return {MLIR_PLUGIN_API_VERSION, "Soft", "0.1",
          [](DialectRegistry *registry) {
            registry->insert<soft::SoftDialect>();
            registry->addExtension(+[](MLIRContext *context,
                                       vector::VectorDialect *) {
              vector::InterleaveOp::attachInterface<InterleaveModel>(*context);
            });
          }};
}

extern "C" LLVM_ATTRIBUTE_WEAK PassPluginLibraryInfo mlirGetPassPluginInfo() {
  return {MLIR_PLUGIN_API_VERSION, "Soft", "0.1",
          [] { PassRegistration<LowerSoft>(); }};
}
