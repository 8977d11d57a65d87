//===- LeafOps.cpp - Locals, checks, output and random numbers ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/PatternMatch.h"
#include "tai/ABI/MeshAbi.h"
#include "tai/Conversion/TaiToHost/Lowering.h"
#include "tai/Dialect/Mesh/IR/Mesh.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"
#include "tai/Transforms/Utils/IndexMath.h"
#include "tai/Transforms/Utils/LowerEach.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// State shared by the lowerings of leaf ops in one function.
struct LeafLowering {
  LeafLowering(LLVM::LLVMFuncOp function, ModuleLowering &module)
      : function(function), frame(function.getArgument(0)), module(module),
        runtime(module.runtime) {}

  /// Returns the address of a tree, loaded once at the top of the function.
  Value getTree(StringAttr tree, Location loc);
  /// Returns the bit of an adjoint field in TaiFrame::zeroAdjoints, loaded once
  /// at the top of the function.
  Value getStartsAtZero(uint32_t number, Location loc);

  LLVM::LLVMFuncOp function;
  Value frame;
  ModuleLowering &module;
  RuntimeCalls &runtime;

private:
  llvm::DenseMap<StringAttr, Value> bases;
  llvm::DenseMap<uint32_t, Value> zeroBits;
};

/// Lowers one op.
template <typename Op> struct LeafPattern : OpRewritePattern<Op> {
  LeafPattern(MLIRContext *context, LeafLowering &leaf)
      : OpRewritePattern<Op>(context), leaf(leaf) {}

  LeafLowering &leaf;
};
} // namespace

//===----------------------------------------------------------------------===//
// Locals
//===----------------------------------------------------------------------===//

namespace {
/// Puts a local on the stack of the function, where LLVM promotes it to a
/// register; sets it to zero where the program creates it. Lowers the loads and
/// stores of the local as well.
struct LowerLocal final : LeafPattern<AllocaOp> {
  using LeafPattern::LeafPattern;

  LogicalResult matchAndRewrite(AllocaOp op,
                                PatternRewriter &rewriter) const override {
    Location loc = op.getLoc();
    Type type = cast<LocalType>(op.getLocal().getType()).getElementType();
    if (isa<VectorType>(type))
      return op.emitOpError("holds ")
             << type << "; expects a scalar, as tai-scalarize makes it";
    Value slot = emitStackSlots(rewriter, loc, 1);
    Value zero =
        arith::ConstantOp::create(rewriter, loc, rewriter.getZeroAttr(type));
    emitSlotStore(rewriter, loc, zero, slot);
    for (Operation *user : llvm::make_early_inc_range(op->getUsers())) {
      rewriter.setInsertionPoint(user);
      Location at = user->getLoc();
      if (auto load = dyn_cast<LocalLoadOp>(user)) {
        rewriter.replaceOp(load, emitSlotLoad(rewriter, at, type, slot));
      } else if (auto store = dyn_cast<LocalStoreOp>(user)) {
        emitSlotStore(rewriter, at, store.getValue(), slot);
        rewriter.eraseOp(store);
      } else {
        return user->emitOpError("cannot be lowered on a local variable");
      }
    }
    rewriter.eraseOp(op);
    return success();
  }
};

/// Lowers the creation of a stack together with its pushes and pops.
struct LowerStack final : LeafPattern<StackCreateOp> {
  using LeafPattern::LeafPattern;

  LogicalResult matchAndRewrite(StackCreateOp op,
                                PatternRewriter &) const override {
    return lowerStack(op, leaf.frame, leaf.runtime);
  }
};
} // namespace

//===----------------------------------------------------------------------===//
// Random numbers
//===----------------------------------------------------------------------===//

namespace {
struct LowerDraw final : LeafPattern<UnrealizedConversionCastOp> {
  using LeafPattern::LeafPattern;

  LogicalResult matchAndRewrite(UnrealizedConversionCastOp op,
                                PatternRewriter &rewriter) const override {
    if (!isDraw(op))
      return failure();
    rewriter.replaceOp(op, emitDraw(op, leaf.frame, rewriter, leaf.runtime));
    return success();
  }
};
} // namespace

//===----------------------------------------------------------------------===//
// Checks and output
//===----------------------------------------------------------------------===//

/// The numbers of components of the arguments that tai-scalarize split.
static ArrayRef<int32_t> getShapes(std::optional<ArrayRef<int32_t>> shapes) {
  return shapes.value_or(ArrayRef<int32_t>());
}

static LogicalResult checkScalars(Operation *op, ValueRange values) {
  for (Value value : values)
    if (!value.getType().isIntOrIndexOrFloat())
      return op->emitOpError("has an argument of type ")
             << value.getType()
             << "; expects scalars, as tai-scalarize makes them";
  return success();
}

namespace {
struct LowerAssert final : LeafPattern<AssertOp> {
  using LeafPattern::LeafPattern;

  LogicalResult matchAndRewrite(AssertOp op,
                                PatternRewriter &rewriter) const override {
    IntegerAttr failure = op.getFailureAttr();
    if (!failure && !leaf.module.debug) {
      rewriter.eraseOp(op);
      return success();
    }
    if (failed(checkScalars(op, op.getArgs())))
      return LogicalResult::failure();
    Location loc = op.getLoc();
    Value yes = arith::ConstantIntOp::create(rewriter, loc, 1, 1);
    Value broken = arith::XOrIOp::create(rewriter, loc, op.getCondition(), yes);
    auto branch = scf::IfOp::create(rewriter, loc, broken);
    OpBuilder inside = branch.getThenBodyBuilder();
    emitFail(leaf.runtime, inside, loc, leaf.frame,
             failure ? failure.getInt() : int64_t(TAI_FAIL_ASSERT),
             op.getMessage(), op.getArgs(), getShapes(op.getShapes()));
    rewriter.eraseOp(op);
    return success();
  }
};

struct LowerPrint final : LeafPattern<PrintOp> {
  using LeafPattern::LeafPattern;

  LogicalResult matchAndRewrite(PrintOp op,
                                PatternRewriter &rewriter) const override {
    if (failed(checkScalars(op, op.getArgs())))
      return failure();
    Location loc = op.getLoc();
    MessageValues values = emitMessageValues(
        leaf.runtime, rewriter, loc, op.getArgs(), getShapes(op.getShapes()));
    std::string text = op.getFormat().str();
    if (op.getNoNewline())
      text += TAI_SAME_LINE;
    Value format = leaf.runtime.string(rewriter, loc, text);
    leaf.runtime.tai_rt_print(rewriter, loc, leaf.frame, format, values.count,
                              values.kinds, values.shapes, values.slots);
    rewriter.eraseOp(op);
    return success();
  }
};
} // namespace

//===----------------------------------------------------------------------===//
// Trees and sparse levels
//===----------------------------------------------------------------------===//

Value LeafLowering::getTree(StringAttr tree, Location loc) {
  Value &base = bases[tree];
  if (!base) {
    auto builder = OpBuilder::atBlockBegin(&function.getBody().front());
    Value trees =
        runtime.frameMember(builder, loc, frame, offsetof(TaiFrame, trees),
                            runtime.getPointerType());
    int64_t index = module.treeIndex.lookup(tree);
    base = runtime.frameMember(builder, loc, trees, index * sizeof(void *),
                               runtime.getPointerType());
  }
  return base;
}

Value LeafLowering::getStartsAtZero(uint32_t number, Location loc) {
  Value &bit = zeroBits[number];
  if (!bit) {
    auto builder = OpBuilder::atBlockBegin(&function.getBody().front());
    Value all = runtime.frameMember(builder, loc, frame,
                                    offsetof(TaiFrame, zeroAdjoints),
                                    builder.getI64Type());
    Value own = arith::AndIOp::create(
        builder, loc, all,
        runtime.i64(builder, loc, static_cast<int64_t>(uint64_t(1) << number)));
    bit = arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::ne, own,
                                runtime.i64(builder, loc, 0));
  }
  return bit;
}

using Values = SmallVector<Value>;

static Value isNotZero(OpBuilder &builder, Location loc, Value number,
                       RuntimeCalls &runtime) {
  return arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::ne, number,
                               runtime.i32(builder, loc, 0));
}

static Values emitCall(OpBuilder &builder, ActiveCellsOp op, Value frame,
                       Value node, RuntimeCalls &runtime) {
  Location loc = op.getLoc();
  Value slot = emitStackSlots(builder, loc, 1);
  IntegerAttr reach = op.getReachAttr();
  Value count = reach ? runtime.tai_rt_gathered_cells(
                            builder, loc, frame, op.getBase(), node,
                            runtime.i64(builder, loc, reach.getInt()), slot)
                      : runtime.tai_rt_active_cells(builder, loc, frame,
                                                    op.getBase(), node, slot);
  Value list =
      LLVM::LoadOp::create(builder, loc, runtime.getPointerType(), slot);
  return {list, IndexMath(builder, loc).toIndex(count)};
}

static Values emitCall(OpBuilder &builder, ListIsCurrentOp op, Value frame,
                       Value node, RuntimeCalls &runtime) {
  Location loc = op.getLoc();
  Value all =
      runtime.tai_rt_list_is_current(builder, loc, frame, op.getBase(), node);
  return {isNotZero(builder, loc, all, runtime)};
}

static Values emitCall(OpBuilder &builder, ActivateCellOp op, Value frame,
                       Value node, RuntimeCalls &runtime) {
  Location loc = op.getLoc();
  Value cell = IndexMath(builder, loc).toI64(op.getCell());
  Value where = runtime.string(builder, loc, describePlace(loc));
  Value done = runtime.tai_rt_activate(builder, loc, frame, op.getBase(), node,
                                       cell, where);
  return {isNotZero(builder, loc, done, runtime)};
}

static Values emitCall(OpBuilder &builder, DeactivateCellOp op, Value frame,
                       Value node, RuntimeCalls &runtime) {
  Location loc = op.getLoc();
  Value cell = IndexMath(builder, loc).toI64(op.getCell());
  Value where = runtime.string(builder, loc, describePlace(loc));
  runtime.tai_rt_deactivate(builder, loc, frame, op.getBase(), node, cell,
                            where);
  return {};
}

static Values emitCall(OpBuilder &builder, AppendCellOp op, Value frame,
                       Value node, RuntimeCalls &runtime) {
  Location loc = op.getLoc();
  IndexMath math(builder, loc);
  Value list = math.toI64(op.getList());
  Value where = runtime.string(builder, loc, describePlace(loc));
  Value at = runtime.tai_rt_append(builder, loc, frame, op.getBase(), node,
                                   list, where);
  return {math.toIndex(at)};
}

namespace {
struct LowerTreeBase final : LeafPattern<TreeBaseOp> {
  using LeafPattern::LeafPattern;

  LogicalResult matchAndRewrite(TreeBaseOp op,
                                PatternRewriter &rewriter) const override {
    rewriter.replaceOp(op,
                       leaf.getTree(op.getTreeAttr().getAttr(), op.getLoc()));
    return success();
  }
};

struct LowerStartsAtZero final : LeafPattern<StartsAtZeroOp> {
  using LeafPattern::LeafPattern;

  LogicalResult matchAndRewrite(StartsAtZeroOp op,
                                PatternRewriter &rewriter) const override {
    rewriter.replaceOp(op, leaf.getStartsAtZero(op.getNumber(), op.getLoc()));
    return success();
  }
};

/// Lowers an op on cells to a call of a function of the runtime, whose first
/// arguments are frame, tree and node.
template <typename Op> struct LowerCells final : LeafPattern<Op> {
  using LeafPattern<Op>::LeafPattern;

  LogicalResult matchAndRewrite(Op op,
                                PatternRewriter &rewriter) const override {
    RuntimeCalls &runtime = this->leaf.runtime;
    Value node = runtime.i32(rewriter, op.getLoc(), op.getNode());
    rewriter.replaceOp(op,
                       emitCall(rewriter, op, this->leaf.frame, node, runtime));
    return success();
  }
};
} // namespace

//===----------------------------------------------------------------------===//
// Ranks of a mesh
//===----------------------------------------------------------------------===//

/// The plan of an exchange: the numbers of a TaiExchangePlan with its digits.
static SmallVector<int64_t> getPlan(ExchangeOp op, const FieldInfo &field) {
  std::optional<Sharding> sharding = getSharding(field.layout);
  int64_t element = field.scalarType.getIntOrFloatBitWidth();
  if (field.scalarType.isBF16())
    element = 17;
  if (isa<FloatType>(field.scalarType))
    element = -element;
  bool isVector = field.numComponents != 1;
  SmallVector<int64_t> plan{static_cast<int64_t>(op.getKind()),
                            element,
                            op.getDigestAttr() ? op.getDigestAttr().getInt()
                                               : 0,
                            sharding ? sharding->block : 0,
                            int64_t(op.getBefore()),
                            int64_t(op.getAfter()),
                            int64_t(field.storage.offset),
                            int64_t(field.storage.digits.size() + isVector)};
  for (const IndexDigit &digit : field.storage.digits) {
    int64_t role = TAI_DIGIT_FREE;
    const auto *fixed = llvm::find(op.getDims(), digit.dimension);
    if (fixed != op.getDims().end())
      role = fixed - op.getDims().begin();
    else if (sharding && sharding->dimension == digit.dimension)
      role = TAI_DIGIT_ROW;
    plan.append({role, digit.divisor, digit.extent, int64_t(digit.stride)});
  }
  if (isVector)
    plan.append({TAI_DIGIT_FREE, 1, field.numComponents, field.scalarSize});
  return plan;
}

namespace {
struct LowerRank final : LeafPattern<RankOp> {
  using LeafPattern::LeafPattern;

  LogicalResult matchAndRewrite(RankOp op,
                                PatternRewriter &rewriter) const override {
    Location loc = op.getLoc();
    RuntimeCalls &runtime = leaf.runtime;
    Value rank =
        runtime.call(rewriter, loc, "tai_rt_rank", rewriter.getI64Type(),
                     {leaf.frame, runtime.i64(rewriter, loc, op.getRanks()),
                      runtime.string(rewriter, loc, describePlace(loc))});
    rewriter.replaceOp(op, IndexMath(rewriter, loc).toIndex(rank));
    return success();
  }
};

struct LowerExchange final : LeafPattern<ExchangeOp> {
  using LeafPattern::LeafPattern;

  LogicalResult matchAndRewrite(ExchangeOp op,
                                PatternRewriter &rewriter) const override {
    FailureOr<const FieldInfo *> found =
        leaf.module.fields.lookup(op, op.getFieldAttr());
    if (failed(found))
      return failure();
    const FieldInfo &field = **found;
    Location loc = op.getLoc();
    RuntimeCalls &runtime = leaf.runtime;
    SmallVector<int64_t> plan = getPlan(op, field);
    Value planned = emitStackSlots(rewriter, loc, plan.size());
    for (auto [number, value] : llvm::enumerate(plan))
      emitSlotStore(rewriter, loc, runtime.i64(rewriter, loc, value),
                    emitSlot(rewriter, loc, planned, number));
    Value at = op.getAt().empty()
                   ? runtime.null(rewriter, loc)
                   : emitStackSlots(rewriter, loc, op.getAt().size());
    for (auto [number, index] : llvm::enumerate(op.getAt())) {
      Value first =
          runtime.i64(rewriter, loc, field.layout.offset[op.getDims()[number]]);
      Value zeroBased = arith::SubIOp::create(
          rewriter, loc, IndexMath(rewriter, loc).toI64(index), first);
      emitSlotStore(rewriter, loc, zeroBased,
                    emitSlot(rewriter, loc, at, number));
    }
    TreeOp declared = field.layout.tree;
    Value tree = leaf.getTree(declared.getSymNameAttr(), loc);
    runtime.call(rewriter, loc, "tai_rt_exchange", Type(),
                 {leaf.frame, tree, planned, at,
                  runtime.string(rewriter, loc, op.getField()),
                  runtime.string(rewriter, loc, describePlace(loc))});
    rewriter.eraseOp(op);
    return success();
  }
};
} // namespace

/// Moves allocations to the function's entry, once for all iterations of loops.
static void hoistArrays(LLVM::LLVMFuncOp function) {
  Block *entry = &function.getBody().front();
  function.walk([&](LLVM::AllocaOp op) {
    Operation *size = op.getArraySize().getDefiningOp();
    if (op->getBlock() == entry || !size ||
        !size->hasTrait<OpTrait::ConstantLike>())
      return;
    OpBuilder builder = OpBuilder::atBlockBegin(entry);
    Operation *copy = builder.clone(*size);
    op->moveAfter(copy);
    op.getArraySizeMutable().assign(copy->getResult(0));
  });
}

LogicalResult tai::lowerLeafOps(LLVM::LLVMFuncOp function,
                                ModuleLowering &lowering) {
  hoistArrays(function);
  LeafLowering leaf(function, lowering);
  RewritePatternSet patterns(function.getContext());
  patterns.add<LowerLocal, LowerStack, LowerDraw, LowerAssert, LowerPrint,
               LowerTreeBase, LowerStartsAtZero, LowerRank, LowerExchange,
               LowerCells<ActiveCellsOp>, LowerCells<ListIsCurrentOp>,
               LowerCells<ActivateCellOp>, LowerCells<DeactivateCellOp>,
               LowerCells<AppendCellOp>>(function.getContext(), leaf);
  return lowerAll(function, std::move(patterns), [](Operation *op) {
    auto cast = dyn_cast<UnrealizedConversionCastOp>(op);
    return !cast || isDraw(cast);
  });
}
