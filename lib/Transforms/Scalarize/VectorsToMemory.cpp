//===- VectorsToMemory.cpp - Vectors that are indexed at run time ---------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// As scalars, a vector costs a select for each of its components wherever an
// index says at run time which of them is meant: stacks of a tree search, rows
// of a matrix that is eliminated. In memory it is one load or store.
//
// A vector is a value, memory is not: an old vector may still be needed when a
// component of the new one is written. Vectors that loops and branches connect
// share one buffer if none of them lives where another is written. Where one
// does, they become tensors, of which upstream's bufferization makes buffers,
// with copies.
//
//===----------------------------------------------------------------------===//

#include "MemoryVectors.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Arith/Transforms/BufferizableOpInterfaceImpl.h"
#include "mlir/Dialect/Bufferization/IR/Bufferization.h"
#include "mlir/Dialect/Bufferization/Transforms/OneShotAnalysis.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/SCF/Transforms/BufferizableOpInterfaceImpl.h"
#include "mlir/Dialect/Tensor/IR/Tensor.h"
#include "mlir/Dialect/Tensor/Transforms/BufferizableOpInterfaceImpl.h"
#include "mlir/Dialect/UB/IR/UBOps.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "mlir/Transforms/GreedyPatternRewriteDriver.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_VECTORSTOMEMORY
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Vectors from outside of a parallel loop
//===----------------------------------------------------------------------===//

static bool hasPositionAtRunTime(FunctionOpInterface function) {
  return function
      .walk([](Operation *op) { return WalkResult(failure(isAtRunTime(op))); })
      .wasInterrupted();
}

/// True if all control flow of the function is structured: no region has
/// several blocks.
static bool isStructured(FunctionOpInterface function) {
  return !function
              .walk([](Operation *op) {
                return WalkResult(
                    failure(llvm::any_of(op->getRegions(), [](Region &region) {
                      return !region.empty() && !region.hasOneBlock();
                    })));
              })
              .wasInterrupted();
}

/// Copies vectors from an outer scope for ops that could reuse their buffer:
/// the iterations of a parallel loop would otherwise share one buffer.
static void copyFromOutside(FunctionOpInterface function) {
  SmallVector<OpOperand *> uses;
  function.walk([&](Operation *op) {
    if (!isControlFlow(op) && !isa<scf::YieldOp, scf::ConditionOp>(op) &&
        !isa<vector::ExtractOp, vector::InsertOp, vector::ShapeCastOp>(op))
      return;
    for (OpOperand &operand : op->getOpOperands())
      if (isa<VectorType>(operand.get().getType()) &&
          getScope(operand.get()) != getScope(op))
        uses.push_back(&operand);
  });
  for (OpOperand *use : uses) {
    Value vector = use->get();
    ImplicitLocOpBuilder b(use->getOwner()->getLoc(), use->getOwner());
    if (Operation *op = vector.getDefiningOp();
        op && op->hasTrait<OpTrait::ConstantLike>()) {
      use->set(b.clone(*op)->getResult(0));
      continue;
    }
    auto elements = vector::ToElementsOp::create(b, vector);
    use->set(vector::FromElementsOp::create(b, vector.getType(),
                                            elements->getResults()));
  }
}

//===----------------------------------------------------------------------===//
// Buffers and tensors in the place of vectors
//===----------------------------------------------------------------------===//

namespace {
/// Replaces the chosen vectors of a function by tensors of one dimension, or,
/// if they share one, by their buffer.
class VectorReplacer {
public:
  VectorReplacer(FunctionOpInterface function, const MemoryVectors &vectors);
  void run();

private:
  enum class Kind { Read, Write, Cast, Other };
  /// An op that uses or defines chosen vectors, with the original types of
  /// these vectors.
  struct Access {
    Operation *op;
    Kind kind;
    SmallVector<std::pair<unsigned, VectorType>, 2> operands;
    SmallVector<Value, 1> results;
  };
  void collect(Operation *op, const MemoryVectors &vectors);
  /// The buffer of the vector, or null if the vector becomes a tensor.
  Value getBuffer(Value vector);
  void replaceRead(const Access &access);
  void replaceWrite(const Access &access);
  void replaceOther(const Access &access);
  void replaceDefinition(Value vector);

  const MemoryVectors &vectors;
  llvm::DenseMap<unsigned, Value> buffers;
  SmallVector<Access> accesses;
  /// carried: chosen vectors that loops and branches carry. given: chosen
  /// vectors that other ops define.
  SmallVector<Value> carried, given;
};
} // namespace

static RankedTensorType getTensorType(Value vector) {
  auto type = cast<VectorType>(vector.getType());
  return RankedTensorType::get({type.getNumElements()}, type.getElementType());
}

/// An attribute that marks the buffers of this pass while it runs.
static constexpr llvm::StringLiteral kBufferAttrName = "tai.of_vector";

static memref::AllocaOp createBuffer(OpBuilder &builder, Location loc,
                                     MemRefType type) {
  auto buffer = memref::AllocaOp::create(builder, loc, type);
  buffer->setAttr(kBufferAttrName, builder.getUnitAttr());
  return buffer;
}

static Value createRead(ImplicitLocOpBuilder &b, Value from, Value number) {
  if (isa<MemRefType>(from.getType()))
    return memref::LoadOp::create(b, from, number);
  return tensor::ExtractOp::create(b, from, number);
}

static Value createWrite(ImplicitLocOpBuilder &b, Value value, Value to,
                         Value number) {
  if (!isa<MemRefType>(to.getType()))
    return tensor::InsertOp::create(b, value, to, number);
  memref::StoreOp::create(b, value, to, number);
  return to;
}

Value VectorReplacer::getBuffer(Value vector) {
  std::optional<unsigned> number = vectors.getBuffer(vector);
  if (!number)
    return Value();
  Value &buffer = buffers[*number];
  if (!buffer) {
    Region *region = vector.getParentRegion();
    while (region->getParentOp() != getScope(vector))
      region = region->getParentRegion();
    auto builder = OpBuilder::atBlockBegin(&region->front());
    RankedTensorType type = getTensorType(vector);
    buffer =
        createBuffer(builder, vector.getLoc(),
                     MemRefType::get(type.getShape(), type.getElementType()));
  }
  return buffer;
}

VectorReplacer::VectorReplacer(FunctionOpInterface function,
                               const MemoryVectors &vectors)
    : vectors(vectors) {
  function.walk<WalkOrder::PreOrder>(
      [&](Operation *op) { collect(op, vectors); });
}

void VectorReplacer::collect(Operation *op, const MemoryVectors &vectors) {
  bool carries = isControlFlow(op);
  for (Region &region : op->getRegions())
    for (Block &block : region)
      for (BlockArgument argument : block.getArguments())
        if (vectors.contains(argument))
          (carries ? carried : given).push_back(argument);
  for (OpResult result : op->getResults())
    if (vectors.contains(result) && carries)
      carried.push_back(result);
  if (carries || (op->hasTrait<OpTrait::IsTerminator>() &&
                  isControlFlow(op->getParentOp())))
    return;

  Access access{op, Kind::Other, {}, {}};
  for (OpOperand &operand : op->getOpOperands())
    if (vectors.contains(operand.get()))
      access.operands.emplace_back(operand.getOperandNumber(),
                                   cast<VectorType>(operand.get().getType()));
  for (Value result : op->getResults())
    if (vectors.contains(result))
      access.results.push_back(result);
  if (access.operands.empty() && access.results.empty())
    return;
  if (isComponentRead(op))
    access.kind = Kind::Read;
  else if (isComponentWrite(op))
    access.kind = Kind::Write;
  else if (isa<vector::ShapeCastOp>(op))
    access.kind = Kind::Cast;
  accesses.push_back(std::move(access));
}

/// True if the index is certainly below `count`: a constant, or a select that
/// tests the index as an unsigned number, as the frontend emits it.
static bool isKnownBelow(Value index, int64_t count) {
  if (std::optional<int64_t> constant = getConstantIntValue(index))
    return *constant >= 0 && *constant < count;
  while (Operation *op = index.getDefiningOp()) {
    if (!isa<arith::IndexCastOp, arith::IndexCastUIOp>(op))
      break;
    index = op->getOperand(0);
  }
  auto select = index.getDefiningOp<arith::SelectOp>();
  auto test = select ? select.getCondition().getDefiningOp<arith::CmpIOp>()
                     : arith::CmpIOp();
  if (!test || test.getPredicate() != arith::CmpIPredicate::ult ||
      test.getLhs() != select.getTrueValue())
    return false;
  std::optional<int64_t> limit = getConstantIntValue(test.getRhs());
  std::optional<int64_t> other = getConstantIntValue(select.getFalseValue());
  return limit && *limit >= 0 && *limit <= count && other && *other >= 0 &&
         *other < count;
}

/// Emits the row-major number of a component; `isInRange` stays null if the
/// position is certainly in range.
static Value getNumber(ImplicitLocOpBuilder &b, ArrayRef<OpFoldResult> position,
                       VectorType type, Value &isInRange) {
  Value number;
  for (auto [at, extent] : llvm::zip_equal(position, type.getShape())) {
    Value index = getValueOrCreateConstantIndexOp(b, b.getLoc(), at);
    if (!isKnownBelow(index, extent)) {
      Value count = arith::ConstantIndexOp::create(b, extent);
      Value holds =
          arith::CmpIOp::create(b, arith::CmpIPredicate::ult, index, count);
      Value zero = arith::ConstantIndexOp::create(b, 0);
      index = arith::SelectOp::create(b, holds, index, zero);
      isInRange =
          isInRange ? arith::AndIOp::create(b, isInRange, holds) : holds;
    }
    if (!number) {
      number = index;
      continue;
    }
    Value row = arith::ConstantIndexOp::create(b, extent);
    row = arith::MulIOp::create(b, number, row);
    number = arith::AddIOp::create(b, row, index);
  }
  return number;
}

/// Replaces an extraction by a load. Indices out of range count as 0, as in
/// tai-scalarize.
void VectorReplacer::replaceRead(const Access &access) {
  auto op = cast<vector::ExtractOp>(access.op);
  ImplicitLocOpBuilder b(op.getLoc(), op);
  Value isInRange;
  Value number = getNumber(b, op.getMixedPosition(),
                           access.operands.front().second, isInRange);
  op.getResult().replaceAllUsesWith(createRead(b, op.getSource(), number));
  op.erase();
}

/// Replaces an insertion by a store; an index out of range stores nothing.
void VectorReplacer::replaceWrite(const Access &access) {
  auto op = cast<vector::InsertOp>(access.op);
  ImplicitLocOpBuilder b(op.getLoc(), op);
  Value isInRange;
  Value number = getNumber(b, op.getMixedPosition(),
                           access.operands.front().second, isInRange);
  Value value = op.getValueToStore();
  if (isInRange) {
    Value old = createRead(b, op.getDest(), number);
    value = arith::SelectOp::create(b, isInRange, value, old);
  }
  op.getResult().replaceAllUsesWith(
      createWrite(b, value, op.getDest(), number));
  op.erase();
}

/// Replaces the operands of an op that uses whole vectors: the op gets vectors
/// built from the components.
void VectorReplacer::replaceOther(const Access &access) {
  ImplicitLocOpBuilder b(access.op->getLoc(), access.op);
  for (auto [number, type] : access.operands) {
    SmallVector<Value> components;
    for (int64_t i = 0; i != type.getNumElements(); ++i)
      components.push_back(createRead(b, access.op->getOperand(number),
                                      arith::ConstantIndexOp::create(b, i)));
    access.op->setOperand(number,
                          vector::FromElementsOp::create(b, type, components));
  }
}

/// Replaces a vector, for its users, by a tensor or a buffer of its components.
void VectorReplacer::replaceDefinition(Value vector) {
  ImplicitLocOpBuilder b(vector.getLoc(), vector.getContext());
  b.setInsertionPointAfterValue(vector);
  auto type = cast<VectorType>(vector.getType());
  RankedTensorType tensorType = getTensorType(vector);
  SmallVector<Value> components;
  Operation *reader = nullptr;
  DenseElementsAttr constant;
  auto broadcast = vector.getDefiningOp<vector::BroadcastOp>();
  Value buffer = getBuffer(vector);
  if (vector.getDefiningOp<ub::PoisonOp>()) {
    Value empty = buffer;
    if (!buffer)
      empty = tensor::EmptyOp::create(b, tensorType.getShape(),
                                      tensorType.getElementType());
    vector.replaceAllUsesWith(empty);
    return;
  }
  if (auto elements = vector.getDefiningOp<vector::FromElementsOp>()) {
    components = llvm::to_vector(elements.getElements());
  } else if (broadcast && !isa<VectorType>(broadcast.getSourceType())) {
    components.assign(type.getNumElements(), broadcast.getSource());
  } else if (matchPattern(vector, m_Constant(&constant))) {
    for (Attribute value : constant.getValues<Attribute>())
      components.push_back(
          arith::ConstantOp::create(b, cast<TypedAttr>(value)));
  } else {
    auto elements = vector::ToElementsOp::create(b, vector);
    llvm::append_range(components, elements->getResults());
    reader = elements;
  }
  if (buffer) {
    for (auto [i, component] : llvm::enumerate(components))
      createWrite(b, component, buffer, arith::ConstantIndexOp::create(b, i));
    vector.replaceAllUsesExcept(buffer, reader);
    return;
  }
  Value tensor = tensor::FromElementsOp::create(b, tensorType, components);
  vector.replaceAllUsesExcept(tensor, reader);
}

void VectorReplacer::run() {
  for (Value value : given)
    replaceDefinition(value);
  // Loops need not carry buffers, because all values of a carried vector are in
  // the same buffer.
  for (Value value : carried) {
    if (Value buffer = getBuffer(value)) {
      value.setType(buffer.getType());
      value.replaceAllUsesWith(buffer);
    } else {
      value.setType(getTensorType(value));
    }
  }
  // Accesses are in program order, so that operands are replaced before their
  // users.
  for (const Access &access : accesses) {
    switch (access.kind) {
    case Kind::Read:
      replaceRead(access);
      break;
    case Kind::Write:
      replaceWrite(access);
      break;
    case Kind::Cast:
      access.op->getResult(0).replaceAllUsesWith(access.op->getOperand(0));
      access.op->erase();
      break;
    case Kind::Other:
      replaceOther(access);
      for (Value result : access.results)
        replaceDefinition(result);
      break;
    }
  }
}

//===----------------------------------------------------------------------===//
// Buffers in the place of tensors
//===----------------------------------------------------------------------===//

static LogicalResult copyBuffer(OpBuilder &builder, Location loc, Value from,
                                Value to) {
  ImplicitLocOpBuilder b(loc, builder);
  auto type = cast<MemRefType>(from.getType());
  Value zero = arith::ConstantIndexOp::create(b, 0);
  Value one = arith::ConstantIndexOp::create(b, 1);
  Value count = arith::ConstantIndexOp::create(b, type.getNumElements());
  scf::ForOp::create(b, zero, count, one, ValueRange(),
                     [&](OpBuilder &inner, Location, Value i, ValueRange) {
                       Value element =
                           memref::LoadOp::create(inner, loc, from, i);
                       memref::StoreOp::create(inner, loc, element, to, i);
                       scf::YieldOp::create(inner, loc);
                     });
  return success();
}

/// Turns tensors into buffers; fails where upstream's analysis leaves a tensor
/// in place.
static LogicalResult bufferizeTensors(FunctionOpInterface function) {
  bufferization::OneShotBufferizationOptions options;
  options.allowUnknownOps = true;
  // Loops may return allocations here; the check below refuses functions in
  // which a loop does.
  options.allowReturnAllocsFromLoops = true;
  options.allocationFn = [](OpBuilder &builder, Location loc, MemRefType type,
                            ValueRange, unsigned) -> FailureOr<Value> {
    return createBuffer(builder, loc, type).getResult();
  };
  options.memCpyFn = copyBuffer;
  bufferization::BufferizationState state;
  return bufferization::runOneShotBufferize(function, options, state);
}

/// Canonicalizes loops and branches, so that they no longer carry or yield
/// buffers that they do not change.
static LogicalResult simplifyControlFlow(FunctionOpInterface function) {
  MLIRContext *context = function.getContext();
  RewritePatternSet patterns(context);
  scf::ForOp::getCanonicalizationPatterns(patterns, context);
  scf::WhileOp::getCanonicalizationPatterns(patterns, context);
  scf::IfOp::getCanonicalizationPatterns(patterns, context);
  scf::IndexSwitchOp::getCanonicalizationPatterns(patterns, context);
  return applyPatternsGreedily(function.getFunctionBody(), std::move(patterns));
}

/// True if the buffers of this pass are only loaded from and stored to.
static bool isOfPlainAccesses(FunctionOpInterface function) {
  auto isTensor = [](Type type) { return isa<TensorType>(type); };
  WalkResult result = function.walk([&](Operation *op) {
    if (llvm::any_of(op->getResultTypes(), isTensor))
      return WalkResult::interrupt();
    if (op->hasAttr(kBufferAttrName))
      for (Operation *user : op->getUsers())
        if (!isa<memref::LoadOp, memref::StoreOp>(user))
          return WalkResult::interrupt();
    return WalkResult::advance();
  });
  return !result.wasInterrupted();
}

/// Moves the buffers of vectors out of loops. Iterations can share a buffer,
/// because its contents are undefined at the beginning of an iteration.
static void hoistBuffers(FunctionOpInterface function) {
  SmallVector<Operation *> buffers;
  function.walk([&](memref::AllocaOp op) {
    if (op->hasAttr(kBufferAttrName))
      buffers.push_back(op);
  });
  for (Operation *buffer : buffers) {
    buffer->removeAttr(kBufferAttrName);
    Operation *top = buffer;
    while (isControlFlow(top->getParentOp()))
      top = top->getParentOp();
    Block &start = top->getParentRegion()->front();
    buffer->moveBefore(&start, start.begin());
  }
}

namespace {
struct VectorsToMemory : tai::impl::VectorsToMemoryBase<VectorsToMemory> {
  using Base::Base;

  void getDependentDialects(DialectRegistry &registry) const override {
    Base::getDependentDialects(registry);
    arith::registerBufferizableOpInterfaceExternalModels(registry);
    scf::registerBufferizableOpInterfaceExternalModels(registry);
    tensor::registerBufferizableOpInterfaceExternalModels(registry);
  }

  void runOnOperation() override {
    walkOwned(getOperation(), [](Operation *owned) {
      auto function = dyn_cast<FunctionOpInterface>(owned);
      if (!function || !hasPositionAtRunTime(function) ||
          !isStructured(function))
        return;
      copyFromOutside(function);
      for (bool withCopies : {true, false}) {
        MemoryVectors vectors(function, withCopies);
        if (vectors.empty())
          return;
        OwningOpRef<Operation *> before(function->clone());
        VectorReplacer(function, vectors).run();
        if ((!vectors.needCopies() || succeeded(bufferizeTensors(function))) &&
            succeeded(simplifyControlFlow(function)) &&
            isOfPlainAccesses(function))
          return hoistBuffers(function);
        // The function is restored, to try again without vectors that need
        // copies, or to keep scalars.
        auto kept = cast<FunctionOpInterface>(*before);
        function.getFunctionBody().takeBody(kept.getFunctionBody());
      }
    });
  }
};
} // namespace
