//===- Scalarize.cpp - Small vectors become scalars -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Small vectors keep the IR compact while it is differentiated. At lower levels
// they would keep LLVM from vectorising over iterations, so they are scalarised
// here, in one walk: dialect conversion would visit and rebuild every op
// several times, which costs compile time.
//
//===----------------------------------------------------------------------===//

#include "Scalarizer.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/UB/IR/UBOps.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "tai/Transforms/Passes.h"
#include "llvm/ADT/TypeSwitch.h"

namespace mlir::tai {
#define GEN_PASS_DEF_SCALARIZE
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

static bool isVector(Value value) { return isa<VectorType>(value.getType()); }

static int64_t getNumComponents(Type type) {
  auto vector = dyn_cast<VectorType>(type);
  return vector ? vector.getNumElements() : 1;
}

Components Scalarizer::get(Value value) {
  auto found = parts.find(value);
  return found == parts.end() ? Components{value} : found->second;
}

void Scalarizer::set(Value result, Components components) {
  if (isVector(result) || isa<LocalType>(result.getType()))
    parts[result] = std::move(components);
  else
    result.replaceAllUsesWith(components.front());
}

Value Scalarizer::index(int64_t value) {
  Value &constant = indexConstants[value];
  if (!constant) {
    auto builder = OpBuilder::atBlockBegin(&function.getFunctionBody().front());
    constant =
        arith::ConstantIndexOp::create(builder, function.getLoc(), value);
  }
  return constant;
}

Components Scalarizer::indicesOf(VectorType type, int64_t position) {
  Components indices(type.getRank());
  for (int64_t d = type.getRank(); d-- > 0;) {
    indices[d] = index(position % type.getDimSize(d));
    position /= type.getDimSize(d);
  }
  return indices;
}

//===----------------------------------------------------------------------===//
// Structure: ops that carry values
//===----------------------------------------------------------------------===//

/// Inserts an argument for each component after each vector argument of a
/// function. The vector arguments are erased at the end.
void Scalarizer::expandArguments(Block &block) {
  for (unsigned i = 0; i < block.getNumArguments(); ++i) {
    BlockArgument argument = block.getArgument(i);
    auto type = dyn_cast<VectorType>(argument.getType());
    if (!type)
      continue;
    Components components;
    for (int64_t c = 0; c != type.getNumElements(); ++c)
      components.push_back(
          block.insertArgument(++i, type.getElementType(), argument.getLoc()));
    parts[argument] = std::move(components);
    deadArguments.push_back(argument);
  }
}

/// Operands, results and block arguments of the `scf` ops correspond one to
/// one, so that all are expanded in the same way.
LogicalResult Scalarizer::processStructure(Operation *op) {
  auto hasVectorArgument = [](Region &region) {
    return !region.empty() &&
           llvm::any_of(region.front().getArguments(), isVector);
  };
  if (llvm::none_of(op->getOperands(), isVector) &&
      llvm::none_of(op->getResults(), isVector) &&
      llvm::none_of(op->getRegions(), hasVectorArgument)) {
    for (Region &region : op->getRegions())
      for (Block &block : region)
        if (failed(processBlock(block)))
          return failure();
    return success();
  }

  OperationState state(op->getLoc(), op->getName());
  for (Value operand : op->getOperands())
    llvm::append_range(state.operands, get(operand));
  for (Type type : op->getResultTypes())
    state.types.append(getNumComponents(type), getElementTypeOrSelf(type));
  state.attributes.append(op->getAttrs().begin(), op->getAttrs().end());
  for (Region &region : op->getRegions()) {
    auto moved = std::make_unique<Region>();
    moved->takeBody(region);
    state.regions.push_back(std::move(moved));
  }
  OpBuilder builder(op);
  Operation *expanded = builder.create(state);
  unsigned next = 0;
  for (Value result : op->getResults()) {
    int64_t count = getNumComponents(result.getType());
    set(result, Components(expanded->getResults().slice(next, count)));
    next += count;
  }
  dead.push_back(op);
  for (Region &region : expanded->getRegions())
    for (Block &block : region) {
      expandArguments(block);
      if (failed(processBlock(block)))
        return failure();
    }
  return success();
}

/// Values that are passed to or returned by functions keep their type.
LogicalResult Scalarizer::processBoundary(Operation *op) {
  OpBuilder builder(op);
  for (OpOperand &operand : op->getOpOperands())
    if (auto type = dyn_cast<VectorType>(operand.get().getType()))
      operand.set(vector::FromElementsOp::create(builder, op->getLoc(), type,
                                                 get(operand.get())));
  builder.setInsertionPointAfter(op);
  for (Value result : op->getResults())
    if (isVector(result)) {
      auto elements =
          vector::ToElementsOp::create(builder, op->getLoc(), result);
      parts[result] = Components(elements.getResults());
    }
  return success();
}

//===----------------------------------------------------------------------===//
// Memory
//===----------------------------------------------------------------------===//

LogicalResult Scalarizer::processAccess(Operation *op) {
  OpBuilder builder(op);
  Location loc = op->getLoc();
  Value whole = isa<LoadOp>(op) ? op->getResult(0) : op->getOperand(0);
  auto type = cast<VectorType>(whole.getType());
  Type scalar = type.getElementType();
  Components values = get(whole);
  Components results;
  for (int64_t i = 0, e = type.getNumElements(); i != e; ++i) {
    Components components = indicesOf(type, i);
    Operation *part =
        llvm::TypeSwitch<Operation *, Operation *>(op)
            .Case([&](LoadOp load) {
              return LoadOp::create(builder, loc, scalar, load.getFieldAttr(),
                                    load.getIndices(), components);
            })
            .Case([&](StoreOp store) {
              return StoreOp::create(builder, loc, values[i],
                                     store.getFieldAttr(), store.getIndices(),
                                     components);
            })
            .Case([&](AtomicOp atomic) {
              return AtomicOp::create(builder, loc, atomic.getKind(), values[i],
                                      atomic.getFieldAttr(),
                                      atomic.getIndices(), components,
                                      atomic.getExclusive());
            });
    part->setDiscardableAttrs(op->getDiscardableAttrDictionary());
    if (part->getNumResults())
      results.push_back(part->getResult(0));
  }
  if (op->getNumResults())
    set(op->getResult(0), std::move(results));
  dead.push_back(op);
  return success();
}

void Scalarizer::processLocal(Operation *op) {
  OpBuilder builder(op);
  Location loc = op->getLoc();
  Components results;
  if (auto alloca = dyn_cast<AllocaOp>(op)) {
    auto local = cast<LocalType>(alloca.getLocal().getType());
    auto type = cast<VectorType>(local.getElementType());
    for (int64_t i = 0; i != type.getNumElements(); ++i)
      results.push_back(AllocaOp::create(
          builder, loc,
          LocalType::get(op->getContext(), type.getElementType())));
  } else if (auto load = dyn_cast<LocalLoadOp>(op)) {
    Type scalar = getElementTypeOrSelf(load.getValue().getType());
    Components locals = get(load.getLocal());
    for (Value local : locals)
      results.push_back(LocalLoadOp::create(builder, loc, scalar, local));
  } else {
    auto store = cast<LocalStoreOp>(op);
    Components locals = get(store.getLocal());
    Components values = get(store.getValue());
    for (auto [value, local] : llvm::zip(values, locals))
      LocalStoreOp::create(builder, loc, value, local);
  }
  if (op->getNumResults())
    set(op->getResult(0), std::move(results));
  dead.push_back(op);
}

/// For tai.print and tai.assert: passes the components of all values in a row,
/// and an attribute with the number of components of each value.
void Scalarizer::processMessage(Operation *op) {
  auto print = dyn_cast<PrintOp>(op);
  auto assertion = dyn_cast<AssertOp>(op);
  SmallVector<Value> values(print ? print.getArgs() : assertion.getArgs());
  SmallVector<int32_t> shapes;
  SmallVector<Value> components;
  for (Value value : values) {
    shapes.push_back(getNumComponents(value.getType()));
    llvm::append_range(components, get(value));
  }
  if (print) {
    print.getArgsMutable().assign(components);
    print.setShapes(shapes);
  } else {
    assertion.getArgsMutable().assign(components);
    assertion.setShapes(shapes);
  }
}

/// An array of vectors is an array of scalars with more dimensions. The
/// argument changes its type; `tai.element_rank` has the number of additional
/// dimensions, of which the caller does not know.
LogicalResult Scalarizer::processArrayAccess(Operation *op) {
  auto load = dyn_cast<memref::LoadOp>(op);
  auto store = dyn_cast<memref::StoreOp>(op);
  Value array = load ? load.getMemRef() : store.getMemRef();
  Value whole = load ? load.getResult() : store.getValueToStore();
  SmallVector<Value> indices(load ? load.getIndices() : store.getIndices());
  auto type = cast<VectorType>(whole.getType());
  OpBuilder builder(op);
  Components results;
  Components values = get(whole);
  for (int64_t i = 0, e = type.getNumElements(); i != e; ++i) {
    SmallVector<Value> at(indices);
    llvm::append_range(at, indicesOf(type, i));
    Operation *part;
    if (load)
      part = memref::LoadOp::create(builder, op->getLoc(), array, at);
    else
      part =
          memref::StoreOp::create(builder, op->getLoc(), values[i], array, at);
    part->setDiscardableAttrs(op->getDiscardableAttrDictionary());
    if (load)
      results.push_back(part->getResult(0));
  }
  if (load)
    set(load.getResult(), std::move(results));
  dead.push_back(op);
  return success();
}

//===----------------------------------------------------------------------===//
// Elementwise ops
//===----------------------------------------------------------------------===//

void Scalarizer::processElementwise(Operation *op) {
  OpBuilder builder(op);
  int64_t count = 1;
  for (Type type : op->getResultTypes())
    count = std::max(count, getNumComponents(type));
  SmallVector<SmallVector<Value>> operands;
  for (Value operand : op->getOperands())
    operands.push_back(get(operand));
  SmallVector<Components> results(op->getNumResults());
  for (int64_t i = 0; i != count; ++i) {
    OperationState state(op->getLoc(), op->getName());
    for (auto &components : operands)
      state.operands.push_back(components.size() == 1 ? components[0]
                                                      : components[i]);
    for (Type type : op->getResultTypes())
      state.types.push_back(getElementTypeOrSelf(type));
    state.attributes.append(op->getAttrs().begin(), op->getAttrs().end());
    Operation *part = builder.create(state);
    for (auto [r, result] : llvm::enumerate(part->getResults()))
      results[r].push_back(result);
  }
  for (auto [result, components] : llvm::zip(op->getResults(), results))
    set(result, std::move(components));
  dead.push_back(op);
}

/// Returns the components of a constant; all components of a splat are one op.
static Components expandConstant(arith::ConstantOp op, DenseElementsAttr dense,
                                 OpBuilder &builder) {
  Components components;
  if (dense.isSplat()) {
    Value scalar = arith::ConstantOp::create(
        builder, op.getLoc(),
        cast<TypedAttr>(dense.getSplatValue<Attribute>()));
    components.assign(dense.getNumElements(), scalar);
    return components;
  }
  for (Attribute value : dense.getValues<Attribute>())
    components.push_back(arith::ConstantOp::create(builder, op.getLoc(),
                                                   cast<TypedAttr>(value)));
  return components;
}

//===----------------------------------------------------------------------===//
// The walk
//===----------------------------------------------------------------------===//

LogicalResult Scalarizer::process(Operation *op) {
  if (isa_and_nonnull<scf::SCFDialect>(op->getDialect()))
    return processStructure(op);
  if (isa<ParallelForOp>(op) || op->hasTrait<RecordsLaunches>())
    return processBlock(op->getRegion(0).front());

  if (auto stop = dyn_cast<StopGradientOp>(op)) {
    set(stop.getResult(), get(stop.getValue()));
    dead.push_back(op);
    return success();
  }
  if (auto derived = dyn_cast<DeriveAsOp>(op)) {
    set(derived.getResult(), get(derived.getValue()));
    dead.push_back(op);
    return success();
  }

  auto isVectorLocal = [](Value value) {
    auto local = dyn_cast<LocalType>(value.getType());
    return local && isa<VectorType>(local.getElementType());
  };
  // Arrays of vectors that are arguments become arrays of scalars; an array of
  // vectors that the function itself makes is refused.
  for (Type type : op->getResultTypes())
    if (auto array = dyn_cast<BaseMemRefType>(type);
        array && isa<VectorType>(array.getElementType()))
      return op->emitOpError("makes an array of vectors, which is not lowered; "
                             "make one of numbers with more dimensions");
  if (llvm::none_of(op->getOperands(), isVector) &&
      llvm::none_of(op->getResults(), isVector) &&
      llvm::none_of(op->getResults(), isVectorLocal))
    return success();

  if (auto constant = dyn_cast<arith::ConstantOp>(op)) {
    auto dense = dyn_cast<DenseElementsAttr>(constant.getValue());
    if (dense) {
      OpBuilder builder(op);
      set(op->getResult(0), expandConstant(constant, dense, builder));
      dead.push_back(op);
      return success();
    }
  }
  if (isa<LoadOp, StoreOp, AtomicOp>(op))
    return processAccess(op);
  if (isa<AllocaOp, LocalLoadOp, LocalStoreOp>(op)) {
    processLocal(op);
    return success();
  }
  if (isa<PrintOp, AssertOp>(op)) {
    processMessage(op);
    return success();
  }
  if (isa<memref::LoadOp, memref::StoreOp>(op))
    return processArrayAccess(op);
  if (isa<ReturnOp, LaunchOp, func::ReturnOp, func::CallOp>(op))
    return processBoundary(op);
  if (expandMatrixOp(op, *this)) {
    dead.push_back(op);
    return success();
  }
  if (std::optional<LogicalResult> result = expandVectorOp(op, *this)) {
    dead.push_back(op);
    return *result;
  }
  if (isa<ub::PoisonOp>(op)) {
    OpBuilder builder(op);
    auto type = cast<VectorType>(op->getResult(0).getType());
    Value scalar =
        ub::PoisonOp::create(builder, op->getLoc(), type.getElementType());
    set(op->getResult(0), Components(type.getNumElements(), scalar));
    dead.push_back(op);
    return success();
  }
  if (OpTrait::hasElementwiseMappableTraits(op) ||
      op->hasTrait<OpTrait::Elementwise>() || isa<arith::SelectOp>(op)) {
    processElementwise(op);
    return success();
  }
  return op->emitOpError("cannot be taken apart into scalars");
}

LogicalResult Scalarizer::processBlock(Block &block) {
  for (Operation &op : llvm::make_early_inc_range(block))
    if (failed(process(&op)))
      return failure();
  return success();
}

/// Gives arrays of vectors their new type, an array of scalars.
static void flattenArrays(FunctionOpInterface function) {
  SmallVector<Type> inputs(function.getArgumentTypes());
  bool changed = false;
  for (auto [i, input] : llvm::enumerate(inputs)) {
    auto memref = dyn_cast<MemRefType>(input);
    auto vector =
        memref ? dyn_cast<VectorType>(memref.getElementType()) : VectorType();
    if (!vector)
      continue;
    SmallVector<int64_t> shape(memref.getShape());
    llvm::append_range(shape, vector.getShape());
    input = MemRefType::get(shape, vector.getElementType(), AffineMap(),
                            memref.getMemorySpace());
    function.getArgument(i).setType(input);
    function.setArgAttr(
        i, "tai.element_rank",
        IntegerAttr::get(IntegerType::get(function.getContext(), 64),
                         vector.getRank()));
    changed = true;
  }
  if (changed)
    function.setType(FunctionType::get(function.getContext(), inputs,
                                       function.getResultTypes()));
}

LogicalResult Scalarizer::run() {
  flattenArrays(function);
  Region &body = function.getFunctionBody();
  if (!body.hasOneBlock())
    return function->emitOpError("expects a body of one block; "
                                 "'lift-cf-to-scf' brings branches to 'scf'");
  Block &entry = body.front();
  SmallVector<Operation *> arguments;
  for (BlockArgument argument : entry.getArguments()) {
    if (!isVector(argument) || argument.use_empty())
      continue;
    auto builder = OpBuilder::atBlockBegin(&entry);
    auto elements =
        vector::ToElementsOp::create(builder, function.getLoc(), argument);
    parts[argument] = Components(elements.getResults());
    arguments.push_back(elements);
  }
  for (Operation &op : llvm::make_early_inc_range(entry))
    if (!llvm::is_contained(arguments, &op) && failed(process(&op)))
      return failure();

  // The dead ops are erased backwards, because uses come after definitions.
  for (Operation *op : llvm::reverse(dead)) {
    op->dropAllUses();
    op->erase();
  }
  for (BlockArgument argument : llvm::reverse(deadArguments))
    argument.getOwner()->eraseArgument(argument.getArgNumber());
  return verify();
}

LogicalResult Scalarizer::verify() {
  WalkResult result = function->walk([](Operation *op) {
    if (isa<vector::ToElementsOp, vector::FromElementsOp, ReturnOp, LaunchOp,
            func::ReturnOp, func::CallOp>(op) ||
        (llvm::none_of(op->getOperands(), isVector) &&
         llvm::none_of(op->getResults(), isVector)))
      return WalkResult::advance();
    op->emitOpError("still uses a vector after scalarisation");
    return WalkResult::interrupt();
  });
  return failure(result.wasInterrupted());
}

namespace {
struct Scalarize : tai::impl::ScalarizeBase<Scalarize> {
  using Base::Base;

  void runOnOperation() override {
    WalkResult result = getOperation()->walk([](FunctionOpInterface function) {
      if (function.isExternal() || !isa<KernelOp, func::FuncOp>(function) ||
          !isTaiCode(function))
        return WalkResult::skip();
      compareSquares(function);
      bool done = succeeded(expandAppends(function)) &&
                  succeeded(Scalarizer(function).run());
      return done ? WalkResult::skip() : WalkResult::interrupt();
    });
    if (result.wasInterrupted())
      signalPassFailure();
  }
};
} // namespace
