//===- LowerLayout.cpp - Accesses to fields become memory accesses --------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Replaces tai.load, tai.store and tai.atomic, and accesses to the arrays that
// a kernel takes, by address arithmetic and accesses of the LLVM dialect: a
// pattern for each op. Atomics for which `tai-relax-atomics` chose a register
// or a private buffer are not lowered here: their address depends on the
// partition, which is known only in `convert-tai-to-scf`.
//
//===----------------------------------------------------------------------===//

#include "../AdjointAccess.h"
#include "AccessLowering.h"
#include "LocalArrays.h"
#include "StridedOrder.h"
#include "mlir/Dialect/Arith/Utils/Utils.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/IndexedAccess.h"
#include "tai/Conversion/Passes.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "tai/Transforms/Utils/IndexMath.h"
#include "tai/Transforms/Utils/LowerEach.h"

namespace mlir::tai {
#define GEN_PASS_DEF_LOWERLAYOUT
#include "tai/Conversion/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

namespace {
/// Lowers one access.
template <typename Op> struct AccessPattern : OpRewritePattern<Op> {
  AccessPattern(MLIRContext *context, AccessLowering &lowering)
      : OpRewritePattern<Op>(context), lowering(lowering) {}

  AccessLowering &lowering;
};

/// Base class of patterns for ops that name a field: looks up the field.
template <typename Op> struct FieldPattern : AccessPattern<Op> {
  using AccessPattern<Op>::AccessPattern;

  LogicalResult matchAndRewrite(Op op, PatternRewriter &rewriter) const final {
    FailureOr<const FieldInfo *> field = this->lowering.getField(op);
    return succeeded(field) ? lower(op, **field, rewriter) : failure();
  }

private:
  virtual LogicalResult lower(Op op, const FieldInfo &field,
                              PatternRewriter &rewriter) const = 0;
};
} // namespace

//===----------------------------------------------------------------------===//
// Elements of fields
//===----------------------------------------------------------------------===//

/// Returns the digits of the address of an access, for later analyses; null if
/// the program multiplies parts of an index by factors that could be taken for
/// strides of the field's digits. `near` are the indices without the offsets of
/// the field and without the constants `peeled`.
static DenseI64ArrayAttr getDigits(MLIRContext *context, const FieldInfo &field,
                                   ValueRange indices, ValueRange near,
                                   ArrayRef<int64_t> peeled) {
  for (auto [index, extent] : llvm::zip(indices, field.layout.shape))
    for (const auto &[atom, factor] : getIndexExpr(index).terms)
      if (std::abs(factor) > 1 && std::abs(factor) >= extent)
        return {};
  SmallVector<int64_t> digits;
  for (const IndexDigit &digit : field.storage.digits) {
    if (digit.extent == 1)
      continue;
    // A digit of a constant index has one value.
    std::optional<int64_t> index = getConstantIntValue(near[digit.dimension]);
    if (index && *index >= 0)
      digits.append(
          {int64_t(digit.stride), 1, *index / digit.divisor % digit.extent});
    else
      digits.append(
          {int64_t(digit.stride), digit.extent, -peeled[digit.dimension]});
  }
  if (field.numComponents != 1)
    digits.append({int64_t(field.scalarSize), int64_t(field.numComponents), 0});
  return DenseI64ArrayAttr::get(context, digits);
}

static Value emitAccess(OpBuilder &builder, LoadOp op, Value pointer,
                        AliasScopes scopes) {
  return emitLoad(builder, op.getLoc(), op.getAccessedValue().getType(),
                  pointer, scopes);
}

static Value emitAccess(OpBuilder &builder, StoreOp op, Value pointer,
                        AliasScopes scopes) {
  emitStore(builder, op.getLoc(), op.getAccessedValue(), pointer, scopes);
  return {};
}

static Value emitAccess(OpBuilder &builder, AtomicOp op, Value pointer,
                        AliasScopes scopes) {
  Value operand = op.getAccessedValue();
  if (op.getExclusive())
    return emitPlainUpdate(builder, op.getLoc(), op.getKind(), operand, pointer,
                           scopes);
  return emitAtomicUpdate(builder, op.getLoc(), op.getKind(), operand, pointer,
                          scopes);
}

namespace {
/// Lowers an access to an element of a field.
template <typename Op> struct LowerElement final : FieldPattern<Op> {
  using FieldPattern<Op>::FieldPattern;

  LogicalResult lower(Op op, const FieldInfo &field,
                      PatternRewriter &rewriter) const override {
    AccessLowering &lowering = this->lowering;
    Location loc = op.getLoc();
    ValueRange indices = op.getIndices(), components = op.getComponents();
    Type type = op.getAccessedValue().getType();
    if (isa<VectorType>(type))
      return op->emitOpError("reaches layout lowering with ")
             << type << "; expects scalars, as tai-scalarize makes them";

    SmallVector<Value> zeroBased = emitZeroBased(rewriter, loc, field, indices);
    Value inRange = lowering.checkElement(op, field, zeroBased);
    // A later pass makes the parallel loop perform this update, in place of the
    // op. Until that pass runs, the op remains, so its indices are checked here
    // as those of any other access are.
    if (isDoneByLoop(op)) {
      if (inRange) {
        auto branch = scf::IfOp::create(rewriter, loc, inRange);
        rewriter.moveOpBefore(op, branch.thenBlock(),
                              branch.thenBlock()->begin());
      }
      return success();
    }

    AliasScopes scopes = lowering.getFieldScopes(op, field);
    scopes.alignment = getAlignment(field, components);
    bool isNear = lowering.isOnDevice();
    SmallVector<Value> near(zeroBased);
    SmallVector<int64_t> peeled;
    if (isNear) {
      peeled = peelConstants(rewriter, loc, field, near);
      scopes.digits =
          getDigits(rewriter.getContext(), field, indices, near, peeled);
    }
    Value base = lowering.getFieldBase(field);
    auto access = [&](OpBuilder &b) -> Value {
      Value pointer =
          isNear
              ? emitNearPointer(b, loc, field, base, near, peeled, components)
              : emitPointer(
                    b, loc, getStorageType(type), base,
                    emitElementOffset(b, loc, field, zeroBased, components));
      Value result = emitAccess(b, op, pointer, scopes);
      if (lowering.marksAdjoint(op))
        for (Operation *user : pointer.getUsers())
          if (isa<LLVM::AliasAnalysisOpInterface>(user))
            user->setAttr(kAdjointAccess, rewriter.getUnitAttr());
      return result;
    };
    // Reads need no test of activity: the memory of inactive cells is zero.
    bool asks = !field.sparse.empty() && !isa<LoadOp>(op) &&
                !op->hasAttr(kActiveAttrName);
    lowering.replaceGuarded(rewriter, op, inRange, [&](OpBuilder &b) {
      if (!asks)
        return access(b);
      Value isActive = lowering.emitActivation(b, loc, field, zeroBased);
      return emitWhere(b, op, isActive, access);
    });
    return success();
  }
};
} // namespace

//===----------------------------------------------------------------------===//
// Cells of sparse levels
//===----------------------------------------------------------------------===//

/// Returns the sparse level that a topology op refers to: the level `up` levels
/// up, 1 being the innermost, or the nearest sparse level above that. Null
/// where all cells exist.
static const SparseInfo *findSparse(const FieldInfo &field, int64_t up) {
  int64_t level = int64_t(field.layout.path.levels.size()) - up;
  for (const SparseInfo &sparse : llvm::reverse(field.sparse))
    if (int64_t(sparse.level) <= level)
      return &sparse;
  return nullptr;
}

/// Emits a test that each index is in the range of the field; null if
/// unchecked.
static Value checkIndices(OpBuilder &builder, AccessLowering &lowering,
                          Operation *op, const FieldInfo &field,
                          ValueRange zeroBased, ValueRange shown) {
  SmallVector<OpFoldResult> extents =
      getAsIndexOpFoldResult(builder.getContext(), field.layout.shape);
  return lowering.checkRange(op, zeroBased, extents,
                             describeField(field.layout), shown);
}

static Value emitOnCell(OpBuilder &builder, IsActiveOp op,
                        const SparseInfo &sparse, CellRef cell) {
  return sparse.type.emitIsActive(builder, op.getLoc(), cell);
}

static Value emitOnCell(OpBuilder &builder, ActivateOp op,
                        const SparseInfo &sparse, CellRef cell) {
  sparse.type.emitActivate(builder, op.getLoc(), cell);
  return {};
}

static Value emitOnCell(OpBuilder &builder, DeactivateOp op,
                        const SparseInfo &sparse, CellRef cell) {
  sparse.type.emitDeactivate(builder, op.getLoc(), cell);
  return {};
}

namespace {
/// Lowers an op that tests or changes whether the cell of an element is active.
template <typename Op> struct LowerCell final : FieldPattern<Op> {
  using FieldPattern<Op>::FieldPattern;

  LogicalResult lower(Op op, const FieldInfo &field,
                      PatternRewriter &rewriter) const override {
    AccessLowering &lowering = this->lowering;
    Location loc = op.getLoc();
    const SparseInfo *sparse = findSparse(field, op.getLevel());
    ValueRange indices = op->getOperands();
    SmallVector<Value> zeroBased = emitZeroBased(rewriter, loc, field, indices);
    Value inRange =
        checkIndices(rewriter, lowering, op, field, zeroBased, indices);
    lowering.replaceGuarded(rewriter, op, inRange, [&](OpBuilder &b) -> Value {
      if (!sparse)
        return isa<IsActiveOp>(op)
                   ? arith::ConstantIntOp::create(b, loc, 1, 1).getResult()
                   : Value();
      Value tree = lowering.getTreeBase(field);
      CellRef cell = sparse->at(
          tree, emitCellNumber(b, loc, field, sparse->level, zeroBased));
      return emitOnCell(b, op, *sparse, cell);
    });
    return success();
  }
};

struct LowerLength final : FieldPattern<LengthOp> {
  using FieldPattern::FieldPattern;

  LogicalResult lower(LengthOp op, const FieldInfo &field,
                      PatternRewriter &rewriter) const override {
    Location loc = op.getLoc();
    ValueRange indices = op.getIndices();
    unsigned dimension = getListDimension(field);
    SmallVector<Value> zeroBased(indices);
    zeroBased.insert(zeroBased.begin() + dimension,
                     arith::ConstantIndexOp::create(
                         rewriter, loc, field.layout.offset[dimension]));
    zeroBased = emitZeroBased(rewriter, loc, field, zeroBased);
    Value inRange =
        checkIndices(rewriter, lowering, op, field, zeroBased, indices);
    lowering.replaceGuarded(rewriter, op, inRange, [&](OpBuilder &b) {
      Value list = emitListNumber(b, loc, field, indices);
      return emitLength(b, loc, getInnermostList(field),
                        lowering.getTreeBase(field), list);
    });
    return success();
  }
};

struct LowerVisitsAll final : FieldPattern<VisitsAllOp> {
  using FieldPattern::FieldPattern;

  LogicalResult lower(VisitsAllOp op, const FieldInfo &field,
                      PatternRewriter &rewriter) const override {
    if (field.sparse.empty())
      rewriter.replaceOpWithNewOp<arith::ConstantIntOp>(op, 1, 1);
    else
      rewriter.replaceOpWithNewOp<ListIsCurrentOp>(op, rewriter.getI1Type(),
                                                   lowering.getTreeBase(field),
                                                   field.sparse.back().node);
    return success();
  }
};
} // namespace

//===----------------------------------------------------------------------===//
// Elements of arrays
//===----------------------------------------------------------------------===//

/// Emits the address of the element at `indices` of a row-major, contiguous
/// array.
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

static bool isProduct(arith::AtomicRMWKind kind) {
  return kind == arith::AtomicRMWKind::mulf ||
         kind == arith::AtomicRMWKind::muli;
}

/// Returns the LLVM atomic instruction for a kind of update; LLVM has none for
/// products.
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

static Value emitAccess(OpBuilder &builder, memref::LoadOp op, Value pointer,
                        AliasScopes scopes) {
  return emitLoad(builder, op.getLoc(), op.getType(), pointer, scopes);
}

static Value emitAccess(OpBuilder &builder, memref::StoreOp op, Value pointer,
                        AliasScopes scopes) {
  emitStore(builder, op.getLoc(), op.getValueToStore(), pointer, scopes);
  return {};
}

static Value emitAccess(OpBuilder &builder, memref::AtomicRMWOp op,
                        Value pointer, AliasScopes scopes) {
  if (isProduct(op.getKind()))
    return emitAtomicUpdate(builder, op.getLoc(), AtomicKind::Mul,
                            op.getValue(), pointer, scopes);
  auto update = LLVM::AtomicRMWOp::create(
      builder, op.getLoc(), *toAtomicBinOp(op.getKind()), pointer,
      op.getValue(), LLVM::AtomicOrdering::monotonic);
  update.setAliasScopesAttr(scopes.own);
  update.setNoaliasScopesAttr(scopes.others);
  return update;
}

namespace {
/// Lowers an access to an element of an array that the kernel takes.
template <typename Op> struct LowerArrayElement final : AccessPattern<Op> {
  using AccessPattern<Op>::AccessPattern;

  LogicalResult matchAndRewrite(Op op,
                                PatternRewriter &rewriter) const override {
    AccessLowering &lowering = this->lowering;
    Location loc = op.getLoc();
    auto array = cast<TypedValue<MemRefType>>(op.getMemref());
    MemRefType type = array.getType();
    SmallVector<OpFoldResult> extents;
    for (int64_t i = 0; i != type.getRank(); ++i)
      extents.push_back(
          type.isDynamicDim(i)
              ? OpFoldResult(
                    memref::DimOp::create(rewriter, loc, array, i).getResult())
              : OpFoldResult(rewriter.getIndexAttr(type.getDimSize(i))));
    ValueRange indices = op.getIndices();
    Value inRange =
        lowering.checkRange(op, indices, extents, describeArray(type), indices);
    lowering.replaceGuarded(rewriter, op, inRange, [&](OpBuilder &b) {
      AliasScopes scopes = lowering.getArrayScopes(op);
      Value pointer = emitArrayPointer(b, loc, array, indices, extents);
      return emitAccess(b, op, pointer, scopes);
    });
    return success();
  }
};
} // namespace

//===----------------------------------------------------------------------===//
// The pass
//===----------------------------------------------------------------------===//

/// True for arrays with the layout of kernel arguments. Arrays of any other
/// layout belong to functions outside tai, and are not lowered.
static bool isRowMajor(Value array) {
  auto type = cast<MemRefType>(array.getType());
  Type element = type.getElementType();
  if (auto vector = dyn_cast<VectorType>(element))
    element = vector.getElementType();
  return type.getLayout().isIdentity() && !type.getMemorySpace() &&
         element.isIntOrIndexOrFloat();
}

static LogicalResult lowerAccesses(FunctionOpInterface function,
                                   FieldTable &fields, AccessLowering &lowering,
                                   bool onDevice) {
  if (failed(lowerLocalArrays(function, onDevice)))
    return failure();
  SmallVector<Operation *> accesses, arrays, cells;
  // All fields of the function are looked up first: an access names the scopes
  // of all the others.
  WalkResult result = function->walk([&](Operation *op) {
    if (isa<LoadOp, StoreOp, AtomicOp>(op)) {
      accesses.push_back(op);
      if (failed(lowering.getField(op)))
        return WalkResult::interrupt();
    } else if (auto load = dyn_cast<memref::LoadOp>(op)) {
      if (isRowMajor(load.getMemref()))
        arrays.push_back(op);
    } else if (auto store = dyn_cast<memref::StoreOp>(op)) {
      if (isRowMajor(store.getMemref()))
        arrays.push_back(op);
    } else if (auto atomic = dyn_cast<memref::AtomicRMWOp>(op)) {
      if (!isRowMajor(atomic.getMemref()))
        return WalkResult::advance();
      if (!toAtomicBinOp(atomic.getKind()) && !isProduct(atomic.getKind())) {
        op->emitOpError("of kind '")
            << arith::stringifyAtomicRMWKind(atomic.getKind())
            << "' cannot be lowered";
        return WalkResult::interrupt();
      }
      arrays.push_back(op);
    } else if (isa<ActivateOp, DeactivateOp, IsActiveOp, LengthOp, VisitsAllOp>(
                   op)) {
      cells.push_back(op);
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
  RewritePatternSet patterns(function.getContext());
  patterns.add<LowerElement<LoadOp>, LowerElement<StoreOp>,
               LowerElement<AtomicOp>, LowerCell<IsActiveOp>,
               LowerCell<ActivateOp>, LowerCell<DeactivateOp>, LowerLength,
               LowerVisitsAll, LowerArrayElement<memref::LoadOp>,
               LowerArrayElement<memref::StoreOp>,
               LowerArrayElement<memref::AtomicRMWOp>>(function.getContext(),
                                                       lowering);
  FrozenRewritePatternSet lowerings(std::move(patterns));
  return success(succeeded(lowerEach(accesses, lowerings)) &&
                 succeeded(lowerEach(cells, lowerings)) &&
                 succeeded(lowerEach(arrays, lowerings)));
}

/// Collects the names of the fields that are adjoints of others.
static DenseSet<Attribute> collectAdjoints(Operation *table) {
  DenseSet<Attribute> names;
  for (FieldOp field : table->getRegion(0).getOps<FieldOp>())
    if (FlatSymbolRefAttr adjoint = field.getAdjointAttr())
      names.insert(adjoint.getAttr());
  return names;
}

namespace {
struct LowerLayout : tai::impl::LowerLayoutBase<LowerLayout> {
  using Base::Base;

  void runOnOperation() override {
    Operation *table = SymbolTable::getNearestSymbolTable(getOperation());
    if (!table)
      return;
    FieldTable fields(table);
    DenseSet<Attribute> adjoints = collectAdjoints(table);
    // Functions of one module may be inlined into one another, so their access
    // groups must differ; only a run over the whole module can ensure that.
    if (isa<ModuleOp>(getOperation()))
      groups.reuse();
    else
      groups.forget();
    WalkResult result = getOperation()->walk([&](FunctionOpInterface function) {
      if (function.isExternal() || !isa<KernelOp, func::FuncOp>(function) ||
          !isTaiCode(function))
        return WalkResult::skip();
      // From here on, accesses in a host function are plain memory accesses.
      if (isa<func::FuncOp>(function))
        markLowered(function);
      // The indices of a host program are always checked, because it has few
      // accesses, and no other check.
      bool isChecked = boundsCheck || isa<func::FuncOp>(function);
      AccessLowering lowering(function, fields, groups, adjoints, isChecked,
                              onDevice);
      if (failed(lowerAccesses(function, fields, lowering, onDevice)))
        return WalkResult::interrupt();
      return WalkResult::skip();
    });
    if (result.wasInterrupted())
      signalPassFailure();
  }

private:
  AccessGroups groups;
};
} // namespace
