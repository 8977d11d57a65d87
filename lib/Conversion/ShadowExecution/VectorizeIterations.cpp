//===- VectorizeIterations.cpp - Iterations as lanes of vectors -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// LLVM cannot vectorise loops with the branches and calls of shadow execution.
// So this pass makes vectors of the floats of several iterations: the lanes of
// a result then share a test of their errors, and their shadows are loaded and
// stored together.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/Index/IndexBuilder.h"
#include "tai/Conversion/Passes.h"
#include "tai/Dialect/Tai/IR/Ownership.h"

namespace mlir::tai {
#define GEN_PASS_DEF_VECTORIZEITERATIONS
#include "tai/Conversion/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// The number of vector lanes: the f64 shadows of this many f32 are one
/// register of AVX-512, or two of AVX.
static constexpr int64_t kLanes = 8;

namespace {
/// A serial loop whose iterations become the lanes of vectors, if possible.
class Lanes {
public:
  explicit Lanes(scf::ForOp loop)
      : loop(loop), builder(loop),
        type(VectorType::get({kLanes}, builder.getF32Type())) {}

  /// True if the loop can be vectorised: each operation has a vector form, and
  /// no iteration depends on another.
  bool check();
  void vectorize();

private:
  bool check(Block &block);
  bool check(Operation &op);
  std::optional<int64_t> getStride(Value value);
  std::optional<int64_t> computeStride(Operation *op);
  bool isOneGroup(Operation *op);
  bool isConsecutive(Value address);

  void emit(Block &block);
  void emit(Operation &op);
  Value getVector(Value value);
  Value getScalar(Value value) { return scalars.lookupOrDefault(value); }

  /// The original loop, and the loop over vectors of iterations that precedes
  /// it.
  scf::ForOp loop, vectorLoop;
  OpBuilder builder;
  VectorType type;
  ArrayRef<LLVM::AccessGroupAttr> groups;
  bool hasVectors = false;
  /// For integers, and for addresses in bytes, the increment from one iteration
  /// to the next; nullopt if it varies, and for floats.
  DenseMap<Value, std::optional<int64_t>> strides;
  IndexBuilder expressions;
  /// scalars: the values in the first lane. vectors: the vectors of the values
  /// in all lanes.
  IRMapping scalars;
  DenseMap<Value, Value> vectors;
};
} // namespace

static bool isPlainFloatOp(Operation &op) {
  return isa<arith::AddFOp, arith::SubFOp, arith::MulFOp, arith::DivFOp,
             arith::NegFOp, arith::MaximumFOp, arith::MinimumFOp,
             arith::MaxNumFOp, arith::MinNumFOp, math::AbsFOp, math::SqrtOp>(
      op);
}

static bool isPlainIntegerOp(Operation &op) {
  return isa_and_present<arith::ArithDialect>(op.getDialect()) &&
         isMemoryEffectFree(&op) && op.getNumResults() == 1 &&
         op.getNumRegions() == 0 && op.getResult(0).getType().isIntOrIndex() &&
         llvm::all_of(op.getOperandTypes(),
                      [](Type type) { return type.isIntOrIndex(); });
}

std::optional<int64_t> Lanes::getStride(Value value) {
  if (value == loop.getInductionVar())
    return 1;
  if (loop.isDefinedOutsideOfLoop(value))
    return 0;
  auto [found, isNew] = strides.try_emplace(value);
  if (!isNew)
    return found->second;
  Operation *op = value.getDefiningOp();
  std::optional<int64_t> stride = op ? computeStride(op) : std::nullopt;
  strides[value] = stride;
  return stride;
}

std::optional<int64_t> Lanes::computeStride(Operation *op) {
  if (!isPlainIntegerOp(*op) && !isa<LLVM::GEPOp, LLVM::LoadOp>(op))
    return matchPattern(op, m_Constant()) ? std::optional<int64_t>(0)
                                          : std::nullopt;
  if (llvm::all_of(op->getOperands(),
                   [&](Value operand) { return getStride(operand) == 0; }))
    return 0;
  // The address has a base and one index, from whose strides its stride
  // follows.
  if (auto address = dyn_cast<LLVM::GEPOp>(op)) {
    if (!address.getElemType().isF32() || op->getNumOperands() != 2)
      return std::nullopt;
    std::optional<int64_t> base = getStride(op->getOperand(0));
    std::optional<int64_t> index = getStride(op->getOperand(1));
    int64_t bytes;
    if (!base || !index || llvm::MulOverflow(*index, int64_t(4), bytes) ||
        llvm::AddOverflow(*base, bytes, bytes))
      return std::nullopt;
    return bytes;
  }
  if (!op->getResult(0).getType().isIntOrIndex())
    return std::nullopt;
  // Indices are assumed not to overflow in 32 bits; if they did, they would be
  // out of range.
  IndexExpr expr = expressions.get(op->getResult(0));
  Value iv = loop.getInductionVar();
  bool isLinear = llvm::all_of(expr.terms, [&](const auto &term) {
    return term.first.getValue() == iv || term.first.allOf([&](Value value) {
      return value != iv && getStride(value) == 0;
    });
  });
  if (!isLinear || expr.width < 32)
    return std::nullopt;
  return expr.getCoefficient(iv);
}

bool Lanes::isOneGroup(Operation *op) {
  auto access = dyn_cast<LLVM::AccessGroupOpInterface>(op);
  ArrayAttr own = access ? access.getAccessGroupsOrNull() : ArrayAttr();
  return own && llvm::any_of(own, [&](Attribute group) {
           return llvm::is_contained(groups, group);
         });
}

bool Lanes::isConsecutive(Value address) { return getStride(address) == 4; }

bool Lanes::check(Operation &op) {
  if (auto branch = dyn_cast<scf::IfOp>(op))
    return getStride(branch.getCondition()) == 0 &&
           llvm::all_of(branch.getResultTypes(),
                        [](Type type) { return type.isF32(); }) &&
           check(*branch.thenBlock()) &&
           (!branch.elseBlock() || check(*branch.elseBlock()));
  if (auto load = dyn_cast<LLVM::LoadOp>(op)) {
    if (load.getVolatile_() ||
        load.getOrdering() != LLVM::AtomicOrdering::not_atomic)
      return false;
    if (getStride(load.getAddr()) == 0)
      return load.getInvariant() || isOneGroup(load);
    return load.getType().isF32() && isOneGroup(load) &&
           isConsecutive(load.getAddr());
  }
  if (auto store = dyn_cast<LLVM::StoreOp>(op)) {
    hasVectors = true;
    return !store.getVolatile_() &&
           store.getOrdering() == LLVM::AtomicOrdering::not_atomic &&
           store.getValue().getType().isF32() && isOneGroup(store) &&
           isConsecutive(store.getAddr());
  }
  if (isPlainFloatOp(op))
    return op.getResult(0).getType().isF32();
  if (auto compare = dyn_cast<arith::CmpFOp>(op))
    return compare.getLhs().getType().isF32();
  if (auto select = dyn_cast<arith::SelectOp>(op);
      select && select.getType().isF32())
    return getStride(select.getCondition()) == 0 ||
           select.getCondition().getDefiningOp<arith::CmpFOp>();
  if (matchPattern(&op, m_Constant()))
    return true;
  // For a value that is not linear in the iteration, only the first lane is
  // computed, and unused: check() rejects users that need the other lanes.
  return (isPlainIntegerOp(op) || isa<LLVM::GEPOp>(op)) &&
         llvm::all_of(op.getOperands(), [&](Value operand) {
           Operation *source = operand.getDefiningOp();
           return getStride(operand) || (source && isPlainIntegerOp(*source));
         });
}

bool Lanes::check(Block &block) {
  return llvm::all_of(block.without_terminator(),
                      [&](Operation &op) { return check(op); });
}

bool Lanes::check() {
  auto annotation =
      loop->getAttrOfType<LLVM::LoopAnnotationAttr>("llvm.loop_annotation");
  if (!annotation || loop.getNumResults() || loop.getUnsignedCmp() ||
      !matchPattern(loop.getStep(), m_One()))
    return false;
  groups = annotation.getParallelAccesses();
  std::optional<int64_t> lower = getConstantIntValue(loop.getLowerBound());
  std::optional<int64_t> upper = getConstantIntValue(loop.getUpperBound());
  if (lower && upper && *upper - *lower < kLanes)
    return false;
  return !groups.empty() && check(*loop.getBody()) && hasVectors;
}

/// Returns the vector that holds a float or a boolean for all lanes.
Value Lanes::getVector(Value value) {
  Value &vector = vectors[value];
  if (vector)
    return vector;
  OpBuilder::InsertionGuard guard(builder);
  Value scalar = getScalar(value);
  Location loc = value.getLoc();
  if (loop.isDefinedOutsideOfLoop(value))
    builder.setInsertionPoint(vectorLoop);
  else
    builder.setInsertionPointAfterValue(scalar);
  FloatAttr number;
  if (matchPattern(value, m_Constant(&number)))
    return vector = arith::ConstantOp::create(
               builder, loc, DenseElementsAttr::get(type, number.getValue()));
  Value none = LLVM::PoisonOp::create(builder, loc, type);
  Value zero = LLVM::ConstantOp::create(builder, loc, builder.getI32Type(), 0);
  Value first = LLVM::InsertElementOp::create(builder, loc, none, scalar, zero);
  return vector = LLVM::ShuffleVectorOp::create(
             builder, loc, first, none, SmallVector<int32_t>(kLanes, 0));
}

/// Copies the alias information of a scalar access to a vector access.
static void copyAliases(Operation *from, Operation *to) {
  cast<LLVM::AccessGroupOpInterface>(to).setAccessGroups(
      cast<LLVM::AccessGroupOpInterface>(from).getAccessGroupsOrNull());
  auto known = cast<LLVM::AliasAnalysisOpInterface>(from);
  auto made = cast<LLVM::AliasAnalysisOpInterface>(to);
  made.setAliasScopes(known.getAliasScopesOrNull());
  made.setNoAliasScopes(known.getNoAliasScopesOrNull());
}

void Lanes::emit(Operation &op) {
  Location loc = op.getLoc();
  if (auto branch = dyn_cast<scf::IfOp>(op)) {
    SmallVector<Type> types(branch.getNumResults(), type);
    auto made =
        scf::IfOp::create(builder, loc, types, getScalar(branch.getCondition()),
                          /*addThenBlock=*/true,
                          /*addElseBlock=*/branch.elseBlock() != nullptr);
    for (auto [from, to] :
         llvm::zip(branch->getRegions(), made->getRegions())) {
      if (from.empty())
        continue;
      OpBuilder::InsertionGuard guard(builder);
      // The two arms of a branch do not share vectors that are made in one of
      // them.
      DenseMap<Value, Value> before = vectors;
      if (!to.front().empty())
        to.front().back().erase();
      builder.setInsertionPointToEnd(&to.front());
      emit(from.front());
      SmallVector<Value> yields;
      for (Value value : from.front().getTerminator()->getOperands())
        yields.push_back(getVector(value));
      scf::YieldOp::create(builder, loc, yields);
      vectors = std::move(before);
    }
    for (auto [from, to] : llvm::zip(branch.getResults(), made.getResults()))
      vectors[from] = to;
    return;
  }
  auto load = dyn_cast<LLVM::LoadOp>(op);
  if (load && getStride(load.getAddr()) != 0) {
    auto made =
        LLVM::LoadOp::create(builder, loc, type, getScalar(load.getAddr()), 4);
    copyAliases(load, made);
    vectors[load] = made;
    return;
  }
  if (auto store = dyn_cast<LLVM::StoreOp>(op)) {
    auto made = LLVM::StoreOp::create(builder, loc, getVector(store.getValue()),
                                      getScalar(store.getAddr()), 4);
    return copyAliases(store, made);
  }
  bool isFloatOp =
      isPlainFloatOp(op) || isa<arith::CmpFOp>(op) ||
      (isa<arith::SelectOp>(op) && op.getResult(0).getType().isF32());
  if (!isFloatOp) {
    builder.clone(op, scalars);
    return;
  }
  IRMapping mapping;
  for (Value operand : op.getOperands()) {
    bool isUniform = !operand.getType().isF32() && getStride(operand) == 0;
    mapping.map(operand, isUniform ? getScalar(operand) : getVector(operand));
  }
  Operation *made = builder.clone(op, mapping);
  Value result = made->getResult(0);
  result.setType(type.clone(result.getType()));
  vectors[op.getResult(0)] = result;
}

void Lanes::emit(Block &block) {
  for (Operation &op : block.without_terminator())
    emit(op);
}

void Lanes::vectorize() {
  Location loc = loop.getLoc();
  Value lower = loop.getLowerBound(), upper = loop.getUpperBound();
  auto constant = [&](int64_t value) -> Value {
    return arith::ConstantOp::create(
        builder, loc, builder.getIntegerAttr(lower.getType(), value));
  };
  Value count = arith::SubIOp::create(builder, loc, upper, lower);
  count = arith::MaxSIOp::create(builder, loc, count, constant(0));
  count = arith::AndIOp::create(builder, loc, count, constant(-kLanes));
  Value end = arith::AddIOp::create(builder, loc, lower, count);
  vectorLoop = scf::ForOp::create(builder, loc, lower, end, constant(kLanes));
  loop.getLowerBoundMutable().assign(end);
  scalars.map(loop.getInductionVar(), vectorLoop.getInductionVar());
  builder.setInsertionPointToStart(vectorLoop.getBody());
  emit(*loop.getBody());
}

namespace {
struct VectorizeIterations
    : tai::impl::VectorizeIterationsBase<VectorizeIterations> {
  using Base::Base;

  void runOnOperation() override {
    SmallVector<scf::ForOp> loops;
    walkOwned(getOperation(), [&](Operation *owned) {
      owned->walk([&](scf::ForOp loop) { loops.push_back(loop); });
    });
    for (scf::ForOp loop : loops)
      if (Lanes lanes(loop); lanes.check())
        lanes.vectorize();
  }
};
} // namespace
