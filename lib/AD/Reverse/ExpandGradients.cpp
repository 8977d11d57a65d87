//===- ExpandGradients.cpp - Derivatives where they are used --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Differentiates a copy of each function that a `tai.grad` names, so that one
// function can be differentiated by several choices of active arguments. The
// call of the derivative of the copy replaces the `tai.grad`.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/Pass/PassManager.h"
#include "tai/AD/Passes.h"
#include "tai/AD/Signature.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Interfaces/Differentiable.h"

namespace mlir::tai {
#define GEN_PASS_DEF_EXPANDGRADIENTS
#include "tai/AD/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

static constexpr StringLiteral kAdjoint = "tai.adjoint";
static constexpr StringLiteral kDifferentiate = "tai.differentiate";

namespace {
/// Returns the positions by which `op` differentiates the callee: active
/// arguments, then active results. They are the value of the attribute
/// `tai.gradients`.
SmallVector<int64_t> getPositions(GradOp op, func::FuncOp callee) {
  SmallVector<int64_t> positions = op.getActiveArguments(callee);
  for (int64_t i : op.getActiveResults(callee))
    positions.push_back(callee.getNumArguments() + i);
  return positions;
}

/// True if the function already has a derivative by the given positions, named
/// by its attributes.
bool hasDerivativeBy(func::FuncOp function, ArrayRef<int64_t> positions) {
  if (!function->hasAttr(kAdjoint))
    return false;
  FailureOr<AdjointSignature> signature =
      AdjointSignature::get(function, /*arrays=*/true);
  if (failed(signature))
    return false;
  SmallVector<int64_t> own(signature->arguments.begin(),
                           signature->arguments.end());
  for (unsigned i : signature->results)
    own.push_back(function.getNumArguments() + i);
  return ArrayRef(own) == positions;
}

/// Makes a private copy of `function`, to be differentiated by `positions`.
func::FuncOp copyFor(func::FuncOp function, ArrayRef<int64_t> positions,
                     SymbolTable &symbols) {
  std::string name = (function.getName() + "_by").str();
  bool areResults = false;
  for (int64_t i : positions) {
    bool isResult = i >= static_cast<int64_t>(function.getNumArguments());
    if (isResult && !areResults)
      name += "_of";
    areResults = isResult;
    name += "_" + std::to_string(isResult ? i - function.getNumArguments() : i);
  }
  func::FuncOp copy = function.clone();
  copy.setName(name);
  copy.setPrivate();
  copy->removeAttr(kAdjoint);
  copy->setAttr(kDifferentiate, UnitAttr::get(function.getContext()));
  copy->setAttr(getFunctionAttrName(copy, kGradients),
                DenseI64ArrayAttr::get(function.getContext(), positions));
  symbols.insert(copy);
  return copy;
}

/// Allocates memory for a value of `type`, at the start of the function around
/// `op`; if `op` is in a loop whose iterations may run in parallel, at the
/// start of the innermost such loop.
Value allocate(GradOp op, Type type) {
  Operation *scope = op->getParentOp();
  while (
      !isa<FunctionOpInterface, ParallelForOp, scf::ParallelOp, scf::ForallOp>(
          scope))
    scope = scope->getParentOp();
  OpBuilder builder = OpBuilder::atBlockBegin(&scope->getRegion(0).front());
  return memref::AllocaOp::create(builder, op.getLoc(), getShadowType(type));
}

/// Calls body(indices, position) for each component of a memref that `allocate`
/// has made.
template <typename Body>
void forEachComponent(OpBuilder &builder, Location loc, MemRefType type,
                      const Body &body) {
  SmallVector<int64_t> at(type.getRank(), 0);
  for (int64_t i = 0, e = type.getNumElements(); i != e; ++i) {
    SmallVector<Value> indices;
    for (int64_t position : at)
      indices.push_back(arith::ConstantIndexOp::create(builder, loc, position));
    body(indices, ArrayRef<int64_t>(at));
    for (unsigned d = at.size(); d-- > 0 && ++at[d] == type.getDimSize(d);)
      at[d] = 0;
  }
}

/// Stores `value`, a number or vector, to `memref`, component by component;
/// stores zeros if `value` is null.
void store(OpBuilder &builder, Location loc, Value value, Value memref) {
  auto type = cast<MemRefType>(memref.getType());
  Value zero;
  if (!value)
    zero = arith::ConstantOp::create(
        builder, loc, builder.getZeroAttr(type.getElementType()));
  forEachComponent(
      builder, loc, type, [&](ValueRange indices, ArrayRef<int64_t> at) {
        Value component = zero;
        if (value)
          component = at.empty()
                          ? value
                          : vector::ExtractOp::create(builder, loc, value, at)
                                .getResult();
        memref::StoreOp::create(builder, loc, component, memref, indices);
      });
}

/// Loads a number or vector of `type` from `memref`, component by component.
Value load(OpBuilder &builder, Location loc, Value memref, Type type) {
  SmallVector<Value> components;
  forEachComponent(builder, loc, cast<MemRefType>(memref.getType()),
                   [&](ValueRange indices, ArrayRef<int64_t>) {
                     components.push_back(
                         memref::LoadOp::create(builder, loc, memref, indices));
                   });
  if (!isa<VectorType>(type))
    return components.front();
  return vector::FromElementsOp::create(builder, loc, type, components);
}

/// Replaces `op` by a call of the function `derivative`, which differentiates
/// by all active arguments and results of `op`.
void replace(GradOp op, func::FuncOp callee, StringRef derivative) {
  OpBuilder builder(op);
  Location loc = op.getLoc();
  unsigned numInputs = callee.getNumArguments();
  SmallVector<Value> operands(op.getOperands().take_front(numInputs));
  OperandRange others = op.getOperands().drop_front(numInputs);
  SmallVector<std::pair<Value, Type>> gradients;
  for (int64_t i : op.getActiveArguments(callee)) {
    Type type = callee.getArgumentTypes()[i];
    if (isa<MemRefType>(type)) {
      operands.push_back(others.front());
      others = others.drop_front();
      continue;
    }
    Value memory = allocate(op, type);
    store(builder, loc, Value(), memory);
    operands.push_back(memory);
    gradients.push_back({memory, type});
  }
  for (Value seed : others) {
    Value memory = allocate(op, seed.getType());
    store(builder, loc, seed, memory);
    operands.push_back(memory);
  }
  func::CallOp::create(builder, loc, derivative, TypeRange(), operands);
  SmallVector<Value> results;
  for (auto [memory, type] : gradients)
    results.push_back(load(builder, loc, memory, type));
  op->replaceAllUsesWith(results);
  op->erase();
}

struct ExpandGradients : tai::impl::ExpandGradientsBase<ExpandGradients> {
  using Base::Base;

  void getDependentDialects(DialectRegistry &registry) const override {
    Base::getDependentDialects(registry);
    registerDifferentiableModels(registry);
    createPrepareForeign()->getDependentDialects(registry);
  }

  void runOnOperation() override {
    ModuleOp module = getOperation();
    SmallVector<GradOp> ops;
    module.walk([&](GradOp op) { ops.push_back(op); });
    if (ops.empty())
      return markAllAnalysesPreserved();
    SymbolTable symbols(module);
    // For each op, `sources` has the function to differentiate: the callee of
    // the op, or a copy of it for other positions.
    using Key = std::pair<Operation *, Attribute>;
    llvm::MapVector<Key, func::FuncOp> copies;
    SmallVector<func::FuncOp> sources;
    for (GradOp op : ops) {
      auto callee = symbols.lookup<func::FuncOp>(op.getCallee());
      if (!callee)
        return fail(op.emitOpError("names '@")
                    << op.getCallee() << "', which is not in this module");
      if (callee.walk([](GradOp) { return WalkResult::interrupt(); })
              .wasInterrupted())
        return fail(op.emitOpError("cannot differentiate '@")
                    << op.getCallee()
                    << "', which has a 'tai.grad' itself: higher derivatives "
                       "are not made");
      SmallVector<int64_t> positions = getPositions(op, callee);
      if (hasDerivativeBy(callee, positions)) {
        sources.push_back(callee);
        continue;
      }
      func::FuncOp &copy =
          copies[{callee, DenseI64ArrayAttr::get(&getContext(), positions)}];
      if (!copy)
        copy = copyFor(callee, positions, symbols);
      sources.push_back(copy);
    }
    if (!copies.empty()) {
      MakeAdjointOptions options;
      for (auto &[key, copy] : copies)
        options.kernels.push_back(copy.getName().str());
      PrepareForeignOptions prepare;
      prepare.kernels = options.kernels;
      OpPassManager manager(ModuleOp::getOperationName());
      manager.addPass(createPrepareForeign(prepare));
      manager.addPass(createMakeAdjoint(options));
      if (failed(runPipeline(manager, module)))
        return signalPassFailure();
    }
    for (auto &[key, copy] : copies)
      if (auto derivative = module.lookupSymbol<func::FuncOp>(
              copy->getAttrOfType<FlatSymbolRefAttr>(kAdjoint)))
        derivative.setPrivate();
    for (auto [op, source] : llvm::zip(ops, sources))
      replace(op, source,
              source->getAttrOfType<FlatSymbolRefAttr>(kAdjoint).getValue());
    // The copies of functions are erased, because the derivatives made from
    // them do not call them.
    for (auto &[key, copy] : copies)
      if (SymbolTable::symbolKnownUseEmpty(copy, module))
        copy.erase();
  }

private:
  void fail(const InFlightDiagnostic &) { signalPassFailure(); }
};
} // namespace
