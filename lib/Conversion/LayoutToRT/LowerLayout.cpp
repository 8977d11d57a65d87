//===- LowerLayout.cpp - Accesses to fields become memory accesses --------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Replaces tai.load, tai.store and tai.atomic, and accesses to the arrays that
// a kernel takes, by address arithmetic and accesses of the LLVM dialect.
// Atomics for which `tai-relax-atomics` chose a register or a private buffer
// stay: their address depends on the partition, which only
// `convert-tai-to-scf` knows.
//
//===----------------------------------------------------------------------===//

#include "../../Transforms/Utils/Accumulate.h"
#include "../../Transforms/Utils/FieldAddress.h"
#include "../../Transforms/Utils/IndexMath.h"
#include "LocalArrays.h"
#include "StridedOrder.h"
#include "mlir/Dialect/Arith/Utils/Utils.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/ABI/Abi.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/IndexBounds.h"
#include "tai/Conversion/Passes.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "tai/Support/BoundsMode.h"

namespace mlir::tai {
#define GEN_PASS_DEF_LOWERLAYOUT
#include "tai/Conversion/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

namespace {
/// Groups of accesses that do not depend on those of other iterations. Each is
/// an attribute of its own that a context keeps for ever, with 4 KiB for the
/// first that a thread makes; so those of one module serve the next.
class AccessGroups {
public:
  /// Hands all groups out again.
  void reuse() { used = 0; }
  void forget() {
    groups.clear();
    used = 0;
  }

  /// The group of the independent loop around an access, if there is one.
  /// Arrays may be one another, but iterations do not communicate through them
  /// either.
  ArrayAttr get(Operation *op) {
    auto loop = op->getParentOfType<ParallelForOp>();
    if (!loop || !loop->hasAttr(kIndependentAttrName) ||
        loop->hasAttr(kKeepsOrderAttrName))
      return {};
    MLIRContext *context = op->getContext();
    auto group =
        loop->getAttrOfType<LLVM::AccessGroupAttr>(kAccessGroupAttrName);
    if (!group) {
      if (used == groups.size())
        groups.push_back(LLVM::AccessGroupAttr::get(context));
      group = groups[used++];
      loop->setAttr(kAccessGroupAttrName, group);
    }
    return ArrayAttr::get(context, {group});
  }

private:
  SmallVector<LLVM::AccessGroupAttr> groups;
  size_t used = 0;
};

/// Lowers the accesses of one kernel or function.
class AccessLowering {
public:
  AccessLowering(FunctionOpInterface function, FieldTable &fields,
                 AccessGroups &groups, bool boundsCheck, bool onDevice)
      : function(function), fields(fields), groups(groups),
        boundsCheck(boundsCheck), onDevice(onDevice) {}

  LogicalResult run();

private:
  LogicalResult lowerField(Operation *op);
  void lowerArray(Operation *op);

  LogicalResult lowerTopology(Operation *op);

  /// The address of the first component of the field, and of its tree, built
  /// once at the top of the function.
  Value getFieldBase(const FieldInfo &field);
  Value getTreeBase(const FieldInfo &field);

  /// Makes the cell of an element active, or only asks whether it is where the
  /// kernel keeps activity as it is. Yields whether it is then.
  Value emitActivation(OpBuilder &builder, Location loc, const FieldInfo &field,
                       ValueRange zeroBased);

  /// Runs `access` if `inRange` holds (always, if null) and replaces the
  /// results of `op` by what it yields, or zero.
  void guard(OpBuilder &builder, Operation *op, Value inRange,
             function_ref<Value(OpBuilder &)> access);

  /// Emits an assertion before `op` that each index is in its range; null if
  /// unchecked.
  Value checkRange(Operation *op, ValueRange zeroBased,
                   ArrayRef<OpFoldResult> extents, const Twine &what,
                   ValueRange shown);
  Value checkCasts(OpBuilder &builder, Location loc, ValueRange indices,
                   const Twine &what);

  FunctionOpInterface function;
  FieldTable &fields;
  AccessGroups &groups;
  bool boundsCheck, onDevice;
  llvm::DenseMap<const FieldInfo *, Value> bases;
  llvm::DenseMap<Operation *, Value> trees;
};
} // namespace

Value AccessLowering::getFieldBase(const FieldInfo &field) {
  Value &base = bases[&field];
  if (!base) {
    auto builder = OpBuilder::atBlockBegin(&function.getFunctionBody().front());
    base = emitFieldBase(builder, function.getLoc(), field);
  }
  return base;
}

Value AccessLowering::getTreeBase(const FieldInfo &field) {
  Value &base = trees[field.layout.tree];
  if (!base) {
    auto builder = OpBuilder::atBlockBegin(&function.getFunctionBody().front());
    base = emitTreeBase(builder, function.getLoc(), field);
  }
  return base;
}

Value AccessLowering::emitActivation(OpBuilder &builder, Location loc,
                                     const FieldInfo &field,
                                     ValueRange zeroBased) {
  const SparseInfo &sparse = field.sparse.back();
  Value tree = getTreeBase(field);
  Value cell = emitCellNumber(builder, loc, field, sparse.level, zeroBased);
  CellRef at = sparse.at(tree, cell);
  Value isActive = sparse.type.emitIsActive(builder, loc, at);
  if (auto kernel = dyn_cast<KernelOp>(function.getOperation());
      kernel && kernel.getKeepsActivity())
    return isActive;
  auto branch = scf::IfOp::create(builder, loc, builder.getI1Type(), isActive,
                                  /*addThenBlock=*/true, /*addElseBlock=*/true);
  OpBuilder inside = OpBuilder::atBlockBegin(branch.thenBlock());
  scf::YieldOp::create(inside, loc, isActive);
  OpBuilder outside = OpBuilder::atBlockBegin(branch.elseBlock());
  Value done = sparse.type.emitActivate(outside, loc, at);
  scf::YieldOp::create(outside, loc, done);
  return branch.getResult(0);
}

/// The casts of floats that an index is made of.
static SmallVector<Operation *> findCasts(ValueRange indices) {
  llvm::SetVector<Value> pending(indices.begin(), indices.end());
  SmallVector<Operation *> casts;
  for (size_t i = 0; i != pending.size(); ++i) {
    Operation *op = pending[i].getDefiningOp();
    if (isa_and_present<arith::FPToSIOp, arith::FPToUIOp>(op))
      casts.push_back(op);
    else if (op && op->getNumRegions() == 0 && isPure(op))
      for (Value operand : op->getOperands())
        if (operand.getType().isIntOrIndex())
          pending.insert(operand);
  }
  return casts;
}

/// An assertion that the floats in the indices stand for integers: of others
/// casts make some number, which may lie in range. Null where there are none.
Value AccessLowering::checkCasts(OpBuilder &builder, Location loc,
                                 ValueRange indices, const Twine &what) {
  Value all;
  for (Operation *op : findCasts(indices)) {
    Value value = op->getOperand(0);
    auto type = cast<FloatType>(value.getType());
    unsigned width = op->getResult(0).getType().getIntOrFloatBitWidth();
    bool isSigned = isa<arith::FPToSIOp>(op);
    // Powers of two, which floats have: one too many on both sides, and what
    // lies between rounds towards zero.
    auto limit = [&](double number) -> Value {
      APFloat bound(number);
      bool ignored;
      bound.convert(type.getFloatSemantics(), APFloat::rmTowardZero, &ignored);
      return arith::ConstantOp::create(builder, loc,
                                       builder.getFloatAttr(type, bound));
    };
    double high = std::ldexp(1.0, int(width - isSigned));
    double low = isSigned ? -high : 0;
    using Predicate = arith::CmpFPredicate;
    Value above =
        arith::CmpFOp::create(builder, loc, Predicate::OGE, value, limit(low));
    Value below =
        arith::CmpFOp::create(builder, loc, Predicate::OLT, value, limit(high));
    Value holds = arith::AndIOp::create(builder, loc, above, below);
    AssertOp::create(
        builder, loc, holds,
        builder.getStringAttr("{} is no index: as an integer it is out of "
                              "range for " +
                              what),
        value, builder.getI32IntegerAttr(TAI_FAIL_INDEX));
    all = all ? arith::AndIOp::create(builder, loc, all, holds).getResult()
              : holds;
  }
  return all;
}

Value AccessLowering::checkRange(Operation *op, ValueRange zeroBased,
                                 ArrayRef<OpFoldResult> extents,
                                 const Twine &what, ValueRange shown) {
  if (!boundsCheck || op->hasAttr(kInRangeAttrName))
    return {};
  OpBuilder builder(op);
  Location loc = op->getLoc();
  Value inRange = checkCasts(builder, loc, shown, what);
  for (auto [index, extent] : llvm::zip(zeroBased, extents)) {
    Value bound = getValueOrCreateConstantIndexOp(builder, loc, extent);
    Value holds = arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::ult,
                                        index, bound);
    inRange =
        inRange
            ? arith::AndIOp::create(builder, loc, inRange, holds).getResult()
            : holds;
  }
  if (!inRange)
    return {};
  std::string message = "index [";
  llvm::raw_string_ostream os(message);
  llvm::interleaveComma(shown, os, [&](Value) { os << "{}"; });
  os << "] is out of range for " << what;
  AssertOp::create(builder, loc, inRange, builder.getStringAttr(message), shown,
                   builder.getI32IntegerAttr(TAI_FAIL_INDEX));
  return inRange;
}

void AccessLowering::guard(OpBuilder &builder, Operation *op, Value inRange,
                           function_ref<Value(OpBuilder &)> access) {
  Location loc = op->getLoc();
  if (!inRange) {
    Value value = access(builder);
    if (op->getNumResults() && value)
      op->getResult(0).replaceAllUsesWith(value);
    return;
  }
  bool hasValue = op->getNumResults() && !op->getResult(0).use_empty();
  if (!hasValue) {
    auto branch = scf::IfOp::create(builder, loc, inRange);
    OpBuilder inside = branch.getThenBodyBuilder();
    access(inside);
    return;
  }
  auto branch = scf::IfOp::create(builder, loc, op->getResultTypes(), inRange,
                                  /*addThenBlock=*/true, /*addElseBlock=*/true);
  OpBuilder inside = OpBuilder::atBlockBegin(branch.thenBlock());
  scf::YieldOp::create(inside, loc, access(inside));
  OpBuilder outside = OpBuilder::atBlockBegin(branch.elseBlock());
  Value zero = arith::ConstantOp::create(
      outside, loc, outside.getZeroAttr(op->getResult(0).getType()));
  scf::YieldOp::create(outside, loc, zero);
  op->replaceAllUsesWith(branch.getResults());
}

/// How the address of an access is made up, for those who follow it; null if
/// the program computes an index from digits of its own that could be taken for
/// those of the field. From each index `peeled` has been taken away.
static DenseI64ArrayAttr getDigits(MLIRContext *context, const FieldInfo &field,
                                   ValueRange indices,
                                   ArrayRef<int64_t> peeled) {
  for (auto [index, extent] : llvm::zip(indices, field.layout.shape))
    for (auto [value, factor] : getLinearIndex(index).terms)
      if (std::abs(factor) > 1 && std::abs(factor) >= extent)
        return {};
  SmallVector<int64_t> digits;
  for (const IndexDigit &digit : field.storage.digits)
    if (digit.extent != 1)
      digits.append({int64_t(digit.stride), int64_t(digit.extent),
                     -peeled[digit.dimension]});
  if (field.numComponents != 1)
    digits.append({int64_t(field.scalarSize), int64_t(field.numComponents), 0});
  return DenseI64ArrayAttr::get(context, digits);
}

LogicalResult AccessLowering::lowerField(Operation *op) {
  OpBuilder builder(op);
  Location loc = op->getLoc();
  FlatSymbolRefAttr name = getNamedField(op);
  FailureOr<const FieldInfo *> found = fields.lookup(op, name);
  if (failed(found))
    return failure();
  const FieldInfo &field = **found;

  auto named = cast<FieldAccessOpInterface>(op);
  ValueRange indices = named.getIndices();
  ValueRange components = named.getComponents();
  Value stored = named.writesField() ? named.getAccessedValue() : Value();
  Type type = named.getAccessedValue().getType();
  if (isa<VectorType>(type))
    return op->emitOpError("reaches layout lowering with ")
           << type << "; expects scalars, as tai-scalarize makes them";

  SmallVector<Value> zeroBased = emitZeroBased(builder, loc, field, indices);
  SmallVector<OpFoldResult> extents =
      getAsIndexOpFoldResult(builder.getContext(), field.layout.shape);
  Value inRange =
      checkRange(op, zeroBased, extents, describeField(field.layout), indices);
  if (boundsCheck && !op->hasAttr(kInRangeAttrName) &&
      llvm::any_of(components, [](Value component) {
        return !getConstantIntValue(component);
      })) {
    extents = getAsIndexOpFoldResult(builder.getContext(), field.elementShape);
    Value inElement = checkRange(
        op, components, extents,
        "an element of field '@" + name.getValue() + "'", components);
    inRange = inRange ? arith::AndIOp::create(builder, loc, inRange, inElement)
                            .getResult()
                      : inElement;
  }

  // What stays is guarded all the same.
  if (isDoneByLoop(op)) {
    if (inRange) {
      auto branch = scf::IfOp::create(builder, loc, inRange);
      op->moveBefore(branch.thenBlock(), branch.thenBlock()->begin());
    }
    return success();
  }

  AliasScopes scopes = fields.getScopes(field);
  scopes.groups = groups.get(op);
  scopes.alignment = getAlignment(field, components);
  bool isNear = onDevice && isa<KernelOp>(function);
  SmallVector<Value> near(zeroBased);
  SmallVector<int64_t> peeled;
  if (isNear) {
    peeled = peelConstants(builder, loc, field, near);
    scopes.digits = getDigits(builder.getContext(), field, indices, peeled);
  }
  Value base = getFieldBase(field);
  auto access = [&](OpBuilder &b) -> Value {
    Value pointer =
        isNear ? emitNearPointer(b, loc, field, base, near, peeled, components)
               : emitPointer(
                     b, loc, getStorageType(type), base,
                     emitElementOffset(b, loc, field, zeroBased, components));
    if (isa<LoadOp>(op))
      return emitLoad(b, loc, type, pointer, scopes);
    if (isa<StoreOp>(op)) {
      emitStore(b, loc, stored, pointer, scopes);
      return {};
    }
    auto atomic = cast<AtomicOp>(op);
    if (atomic.getExclusive())
      return emitPlainUpdate(b, loc, atomic.getKind(), stored, pointer, scopes);
    return emitAtomicUpdate(b, loc, atomic.getKind(), stored, pointer, scopes);
  };
  // Memory of inactive cells is zero, so that reads need not ask.
  bool asks = !field.sparse.empty() && !isa<LoadOp>(op) &&
              !op->hasAttr(kActiveAttrName);
  if (asks) {
    bool hasValue = op->getNumResults() && !op->getResult(0).use_empty();
    auto activateAndAccess = [&](OpBuilder &b) -> Value {
      Value isActive = emitActivation(b, loc, field, zeroBased);
      if (!hasValue) {
        auto branch = scf::IfOp::create(b, loc, isActive);
        OpBuilder inside = branch.getThenBodyBuilder();
        access(inside);
        return {};
      }
      auto branch =
          scf::IfOp::create(b, loc, op->getResultTypes(), isActive,
                            /*addThenBlock=*/true, /*addElseBlock=*/true);
      OpBuilder inside = OpBuilder::atBlockBegin(branch.thenBlock());
      Value old = access(inside);
      scf::YieldOp::create(inside, loc, old);
      OpBuilder outside = OpBuilder::atBlockBegin(branch.elseBlock());
      Value zero = arith::ConstantOp::create(
          outside, loc, outside.getZeroAttr(op->getResult(0).getType()));
      scf::YieldOp::create(outside, loc, zero);
      return branch.getResult(0);
    };
    guard(builder, op, inRange, activateAndAccess);
  } else {
    guard(builder, op, inRange, access);
  }
  op->erase();
  return success();
}

/// The sparse level of the path that a topology op means: that `up` levels up,
/// 1 being the innermost, or the nearest above it. Null where all cells exist.
static const SparseInfo *findSparse(const FieldInfo &field, int64_t up) {
  int64_t level = int64_t(field.layout.path.levels.size()) - up;
  for (const SparseInfo &sparse : llvm::reverse(field.sparse))
    if (int64_t(sparse.level) <= level)
      return &sparse;
  return nullptr;
}

LogicalResult AccessLowering::lowerTopology(Operation *op) {
  OpBuilder builder(op);
  Location loc = op->getLoc();
  FlatSymbolRefAttr name = getNamedField(op);
  FailureOr<const FieldInfo *> found = fields.lookup(op, name);
  if (failed(found))
    return failure();
  const FieldInfo &field = **found;
  if (auto length = dyn_cast<LengthOp>(op)) {
    ValueRange indices = length.getIndices();
    unsigned dimension = getListDimension(field);
    SmallVector<Value> zeroBased(indices);
    zeroBased.insert(zeroBased.begin() + dimension,
                     arith::ConstantIndexOp::create(
                         builder, loc, field.layout.offset[dimension]));
    zeroBased = emitZeroBased(builder, loc, field, zeroBased);
    SmallVector<OpFoldResult> extents =
        getAsIndexOpFoldResult(builder.getContext(), field.layout.shape);
    Value inRange = checkRange(op, zeroBased, extents,
                               describeField(field.layout), indices);
    guard(builder, op, inRange, [&](OpBuilder &b) -> Value {
      Value list = emitListNumber(b, loc, field, indices);
      return emitLength(b, loc, getInnermostList(field), getTreeBase(field),
                        list);
    });
    op->erase();
    return success();
  }
  if (auto visits = dyn_cast<VisitsAllOp>(op)) {
    Value all =
        field.sparse.empty()
            ? arith::ConstantIntOp::create(builder, loc, 1, 1).getResult()
            : ListIsCurrentOp::create(builder, loc, builder.getI1Type(),
                                      getTreeBase(field),
                                      field.sparse.back().node)
                  .getResult();
    visits.replaceAllUsesWith(all);
    op->erase();
    return success();
  }
  int64_t up = op->getAttrOfType<IntegerAttr>("level").getInt();
  const SparseInfo *sparse = findSparse(field, up);
  SmallVector<Value> zeroBased =
      emitZeroBased(builder, loc, field, op->getOperands());
  SmallVector<OpFoldResult> extents =
      getAsIndexOpFoldResult(builder.getContext(), field.layout.shape);
  Value inRange = checkRange(op, zeroBased, extents,
                             describeField(field.layout), op->getOperands());
  guard(builder, op, inRange, [&](OpBuilder &b) -> Value {
    if (!sparse)
      return isa<IsActiveOp>(op)
                 ? arith::ConstantIntOp::create(b, loc, 1, 1).getResult()
                 : Value();
    Value tree = getTreeBase(field);
    CellRef cell = sparse->at(
        tree, emitCellNumber(b, loc, field, sparse->level, zeroBased));
    if (isa<IsActiveOp>(op))
      return sparse->type.emitIsActive(b, loc, cell);
    if (isa<ActivateOp>(op))
      sparse->type.emitActivate(b, loc, cell);
    else
      sparse->type.emitDeactivate(b, loc, cell);
    return {};
  });
  op->erase();
  return success();
}

/// The address of the element at `indices` of a row-major, contiguous array.
static Value emitArrayPointer(OpBuilder &builder, Location loc, Value array,
                              ValueRange indices,
                              ArrayRef<OpFoldResult> extents) {
  IndexMath math(builder, loc);
  Value offset = math.constant(0);
  for (auto [index, extent] : llvm::zip(indices, extents)) {
    Value size = getValueOrCreateConstantIndexOp(builder, loc, extent);
    offset = math.add(math.mul(offset, size), index);
  }
  Value address =
      memref::ExtractAlignedPointerAsIndexOp::create(builder, loc, array);
  Value base = LLVM::IntToPtrOp::create(
      builder, loc, LLVM::LLVMPointerType::get(builder.getContext()),
      math.toI64(address));
  Type scalar = cast<MemRefType>(array.getType()).getElementType();
  return emitPointer(builder, loc, getStorageType(scalar), base, offset);
}

/// The atomic instruction for a kind; LLVM has none for products.
static std::optional<LLVM::AtomicBinOp>
toAtomicBinOp(arith::AtomicRMWKind kind) {
  switch (kind) {
  case arith::AtomicRMWKind::addf:
    return LLVM::AtomicBinOp::fadd;
  case arith::AtomicRMWKind::addi:
    return LLVM::AtomicBinOp::add;
  case arith::AtomicRMWKind::andi:
    return LLVM::AtomicBinOp::_and;
  case arith::AtomicRMWKind::ori:
    return LLVM::AtomicBinOp::_or;
  case arith::AtomicRMWKind::xori:
    return LLVM::AtomicBinOp::_xor;
  case arith::AtomicRMWKind::assign:
    return LLVM::AtomicBinOp::xchg;
  case arith::AtomicRMWKind::maxnumf:
    return LLVM::AtomicBinOp::fmax;
  case arith::AtomicRMWKind::minnumf:
    return LLVM::AtomicBinOp::fmin;
  case arith::AtomicRMWKind::maxs:
    return LLVM::AtomicBinOp::max;
  case arith::AtomicRMWKind::mins:
    return LLVM::AtomicBinOp::min;
  case arith::AtomicRMWKind::maxu:
    return LLVM::AtomicBinOp::umax;
  case arith::AtomicRMWKind::minu:
    return LLVM::AtomicBinOp::umin;
  default:
    return std::nullopt;
  }
}

void AccessLowering::lowerArray(Operation *op) {
  OpBuilder builder(op);
  Location loc = op->getLoc();
  auto load = dyn_cast<memref::LoadOp>(op);
  auto store = dyn_cast<memref::StoreOp>(op);
  auto atomic = dyn_cast<memref::AtomicRMWOp>(op);
  Value array = load    ? load.getMemRef()
                : store ? store.getMemRef()
                        : atomic.getMemref();
  ValueRange indices = load    ? load.getIndices()
                       : store ? store.getIndices()
                               : atomic.getIndices();
  auto type = cast<MemRefType>(array.getType());

  SmallVector<OpFoldResult> extents;
  for (int64_t i = 0; i != type.getRank(); ++i)
    extents.push_back(
        type.isDynamicDim(i)
            ? OpFoldResult(
                  memref::DimOp::create(builder, loc, array, i).getResult())
            : OpFoldResult(builder.getIndexAttr(type.getDimSize(i))));
  Value inRange =
      checkRange(op, indices, extents, describeArray(type), indices);
  guard(builder, op, inRange, [&](OpBuilder &b) -> Value {
    Type scalar = type.getElementType();
    AliasScopes scopes = fields.getArrayScopes();
    scopes.groups = groups.get(op);
    Value pointer = emitArrayPointer(b, loc, array, indices, extents);
    if (load)
      return emitLoad(b, loc, scalar, pointer, scopes);
    if (store) {
      emitStore(b, loc, store.getValueToStore(), pointer, scopes);
      return {};
    }
    auto update = LLVM::AtomicRMWOp::create(
        b, loc, *toAtomicBinOp(atomic.getKind()), pointer, atomic.getValue(),
        LLVM::AtomicOrdering::monotonic);
    update.setAliasScopesAttr(scopes.own);
    update.setNoaliasScopesAttr(scopes.others);
    return update;
  });
  op->erase();
}

LogicalResult AccessLowering::run() {
  if (failed(lowerLocalArrays(function)))
    return failure();
  SmallVector<Operation *> accesses, arrays, topology;
  // All fields of the function are looked up first: an access names the scopes
  // of all the others.
  WalkResult result = function->walk([&](Operation *op) {
    if (isa<LoadOp, StoreOp, AtomicOp>(op)) {
      accesses.push_back(op);
      if (failed(fields.lookup(op, getNamedField(op))))
        return WalkResult::interrupt();
    } else if (isa<memref::LoadOp, memref::StoreOp>(op)) {
      arrays.push_back(op);
    } else if (auto atomic = dyn_cast<memref::AtomicRMWOp>(op)) {
      if (!toAtomicBinOp(atomic.getKind())) {
        op->emitOpError("of kind '")
            << arith::stringifyAtomicRMWKind(atomic.getKind())
            << "' cannot be lowered";
        return WalkResult::interrupt();
      }
      arrays.push_back(op);
    } else if (isa<ActivateOp, DeactivateOp, IsActiveOp, LengthOp, VisitsAllOp>(
                   op)) {
      topology.push_back(op);
    } else if (isa<AppendOp>(op)) {
      op->emitOpError("reaches layout lowering; expects a cell and a store, as "
                      "tai-scalarize makes them");
      return WalkResult::interrupt();
    }
    return WalkResult::advance();
  });
  if (result.wasInterrupted())
    return failure();
  function->walk([&](ParallelForOp loop) {
    if (loop->hasAttr(kIndependentAttrName) && needsOrderWithin(loop, fields))
      loop->setAttr(kKeepsOrderAttrName, UnitAttr::get(loop.getContext()));
  });
  for (Operation *op : accesses)
    if (failed(lowerField(op)))
      return failure();
  for (Operation *op : topology)
    if (failed(lowerTopology(op)))
      return failure();
  for (Operation *op : arrays)
    lowerArray(op);
  return success();
}

namespace {
struct LowerLayout : tai::impl::LowerLayoutBase<LowerLayout> {
  using Base::Base;

  void runOnOperation() override {
    Operation *table = SymbolTable::getNearestSymbolTable(getOperation());
    if (!table)
      return;
    FieldTable fields(table);
    // Functions of one module may be inlined into one another: they need groups
    // of their own, which only a run over all of them can give.
    if (isa<ModuleOp>(getOperation()))
      groups.reuse();
    else
      groups.forget();
    WalkResult result = getOperation()->walk([&](FunctionOpInterface function) {
      if (function.isExternal() || !isa<KernelOp, func::FuncOp>(function))
        return WalkResult::skip();
      AccessLowering lowering(function, fields, groups, boundsCheck, onDevice);
      return failed(lowering.run()) ? WalkResult::interrupt()
                                    : WalkResult::skip();
    });
    if (result.wasInterrupted())
      signalPassFailure();
  }

private:
  AccessGroups groups;
};
} // namespace
