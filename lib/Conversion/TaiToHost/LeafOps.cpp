//===- LeafOps.cpp - Locals, checks, output and random numbers ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "../../Transforms/Utils/Accumulate.h"
#include "../../Transforms/Utils/IndexMath.h"
#include "Lowering.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Locals
//===----------------------------------------------------------------------===//

/// A local lives on the stack of the function, where LLVM finds and promotes
/// it; it is set to zero where the program makes it.
static LogicalResult lowerLocal(AllocaOp op) {
  Location loc = op.getLoc();
  Type type = cast<LocalType>(op.getLocal().getType()).getElementType();
  if (isa<VectorType>(type))
    return op.emitOpError("holds ")
           << type << "; expects a scalar, as tai-scalarize makes it";
  OpBuilder builder(op);
  Value slot = emitStackSlots(builder, loc, 1);
  Value zero =
      arith::ConstantOp::create(builder, loc, builder.getZeroAttr(type));
  emitSlotStore(builder, loc, zero, slot);
  for (Operation *user : llvm::make_early_inc_range(op->getUsers())) {
    builder.setInsertionPoint(user);
    if (auto load = dyn_cast<LocalLoadOp>(user)) {
      load.replaceAllUsesWith(emitSlotLoad(builder, load.getLoc(), type, slot));
    } else if (auto store = dyn_cast<LocalStoreOp>(user)) {
      emitSlotStore(builder, store.getLoc(), store.getValue(), slot);
    } else {
      return user->emitOpError("cannot be lowered on a local variable");
    }
    user->erase();
  }
  op.erase();
  return success();
}

//===----------------------------------------------------------------------===//
// Random numbers
//===----------------------------------------------------------------------===//

/// Operand names would need an op of its own; the numbers travel as operands of
/// this placeholder: (iteration, sequence[, seed, launch]) -> bits.
constexpr llvm::StringLiteral kIterationFunction = "tai_rt_random_u32";

void tai::numberDraws(Operation *root, ParallelForOp loop) {
  SmallVector<RandomOp> draws;
  root->walk<WalkOrder::PreOrder>([&](Operation *op) {
    if (op != root && isa<ParallelForOp>(op))
      return WalkResult::skip();
    if (auto draw = dyn_cast<RandomOp>(op))
      draws.push_back(draw);
    return WalkResult::advance();
  });
  if (draws.empty())
    return;

  // The number of the iteration: the position in the box, row-major.
  OpBuilder builder(root->getContext());
  Value iteration;
  Block *start = loop ? &loop.getBody().front() : &root->getRegion(0).front();
  builder.setInsertionPointToStart(start);
  Location loc = root->getLoc();
  IndexMath math(builder, loc);
  iteration = math.constant(0);
  if (loop) {
    for (auto [iv, lower, upper] :
         llvm::zip(loop.getInductionVars(), loop.getLowerBounds(),
                   loop.getUpperBounds()))
      iteration = math.add(math.mul(iteration, math.extent(lower, upper)),
                           math.sub(iv, lower));
  }
  iteration = math.toI64(iteration);

  for (RandomOp draw : draws) {
    bool repeats = draw->getBlock() != start && [&] {
      for (Operation *parent = draw->getParentOp(); parent != root;
           parent = parent->getParentOp())
        if (isa<LoopLikeOpInterface>(parent))
          return true;
      return false;
    }();
    Type i32 = builder.getI32Type();
    bool isDouble = draw.getValue().getType().getIntOrFloatBitWidth() > 32;
    Value counter;
    if (repeats) {
      builder.setInsertionPointToStart(start);
      counter = AllocaOp::create(builder, loc,
                                 LocalType::get(root->getContext(), i32));
    }
    builder.setInsertionPoint(draw);
    auto constant = [&](int64_t value) -> Value {
      return arith::ConstantIntOp::create(builder, draw.getLoc(), value, 32);
    };
    Value sequence =
        repeats ? LocalLoadOp::create(builder, draw.getLoc(), i32, counter)
                      .getResult()
                : constant(0);
    if (repeats) {
      Value next = arith::AddIOp::create(builder, draw.getLoc(), sequence,
                                         constant(isDouble ? 2 : 1));
      LocalStoreOp::create(builder, draw.getLoc(), next, counter);
    }
    // Handed over as operands, which closures capture like all others.
    auto carrier = UnrealizedConversionCastOp::create(
        builder, draw.getLoc(), draw.getValue().getType(),
        ValueRange{iteration, sequence});
    carrier->setAttr("stream", draw.getStreamAttr());
    draw.replaceAllUsesWith(carrier.getResult(0));
    draw.erase();
  }
}

/// Random bits as the type asks: all bits for an integer, [0, 1) for a float.
static void lowerDraw(UnrealizedConversionCastOp op, Value frame,
                      RuntimeCalls &runtime) {
  OpBuilder builder(op);
  Location loc = op.getLoc();
  Type type = op.getResult(0).getType();
  Type i32 = builder.getI32Type(), i64 = builder.getI64Type();
  Value iteration = op.getOperand(0), sequence = op.getOperand(1);
  // A device function is given them, the host's has them in its frame.
  auto key = [&](unsigned number, size_t offset) {
    return op->getNumOperands() > 2
               ? op.getOperand(2 + number)
               : runtime.frameMember(builder, loc, frame, offset, i64);
  };
  Value seed = key(0, offsetof(TaiFrame, seed));
  Value launch = key(1, offsetof(TaiFrame, launch));
  Value stream = runtime.i32(builder, loc,
                             cast<IntegerAttr>(op->getAttr("stream")).getInt());
  auto draw = [&](Value at) {
    return runtime.call(builder, loc, kIterationFunction, i32,
                        {seed, launch, iteration, stream, at}, /*pure=*/true);
  };

  Value bits = draw(sequence);
  unsigned width = type.getIntOrFloatBitWidth();
  if (width > 32) {
    Value next = arith::AddIOp::create(builder, loc, sequence,
                                       runtime.i32(builder, loc, 1));
    Value high = arith::ExtUIOp::create(builder, loc, i64, bits);
    Value low = arith::ExtUIOp::create(builder, loc, i64, draw(next));
    high = arith::ShLIOp::create(builder, loc, high,
                                 runtime.i64(builder, loc, 32));
    bits = arith::OrIOp::create(builder, loc, high, low);
  }
  if (isa<IntegerType>(type)) {
    if (width < 32)
      bits = arith::TruncIOp::create(builder, loc, type, bits);
    op.getResult(0).replaceAllUsesWith(bits);
    op.erase();
    return;
  }

  // As many bits as the significand holds, so that 1 is never reached by
  // rounding.
  auto floatType = cast<FloatType>(type);
  unsigned kept =
      llvm::APFloat::semanticsPrecision(floatType.getFloatSemantics());
  unsigned available = width > 32 ? 64 : 32;
  Value shift =
      arith::ConstantIntOp::create(builder, loc, available - kept, available);
  bits = arith::ShRUIOp::create(builder, loc, bits, shift);
  Value number = arith::UIToFPOp::create(builder, loc, type, bits);
  Value scale = arith::ConstantOp::create(
      builder, loc, builder.getFloatAttr(type, std::ldexp(1.0, -int(kept))));
  Value result = arith::MulFOp::create(builder, loc, number, scale);
  op.getResult(0).replaceAllUsesWith(result);
  op.erase();
}

//===----------------------------------------------------------------------===//
// Checks and output
//===----------------------------------------------------------------------===//

/// Numbers of components of the arguments, which tai-scalarize took apart.
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

static LogicalResult lowerAssert(AssertOp op, Value frame,
                                 ModuleLowering &lowering) {
  IntegerAttr failure = op.getFailureAttr();
  if (!failure && !lowering.debug) {
    op.erase();
    return success();
  }
  if (failed(checkScalars(op, op.getArgs())))
    return LogicalResult::failure();
  OpBuilder builder(op);
  Location loc = op.getLoc();
  Value yes = arith::ConstantIntOp::create(builder, loc, 1, 1);
  Value broken = arith::XOrIOp::create(builder, loc, op.getCondition(), yes);
  auto branch = scf::IfOp::create(builder, loc, broken);
  OpBuilder inside = branch.getThenBodyBuilder();
  emitFail(lowering.runtime, inside, loc, frame,
           failure ? failure.getInt() : int64_t(TAI_FAIL_ASSERT),
           op.getMessage(), op.getArgs(), getShapes(op.getShapes()));
  op.erase();
  return success();
}

static LogicalResult lowerPrint(PrintOp op, Value frame,
                                RuntimeCalls &runtime) {
  if (failed(checkScalars(op, op.getArgs())))
    return failure();
  OpBuilder builder(op);
  Location loc = op.getLoc();
  MessageValues values = emitMessageValues(runtime, builder, loc, op.getArgs(),
                                           getShapes(op.getShapes()));
  Value format = runtime.string(builder, loc, op.getFormat());
  runtime.tai_rt_print(builder, loc, frame, format, values.count, values.kinds,
                       values.shapes, values.slots);
  op.erase();
  return success();
}

//===----------------------------------------------------------------------===//
// Sparse levels
//===----------------------------------------------------------------------===//

/// Calls a function of the runtime for cell ops: (frame, tree, node, number),
/// and where in the program that is.
static void lowerCellOp(Operation *op, Value frame, RuntimeCalls &runtime) {
  OpBuilder builder(op);
  Location loc = op->getLoc();
  IndexMath math(builder, loc);
  Value tree = op->getOperand(0);
  Value node = runtime.i32(builder, loc,
                           op->getAttrOfType<IntegerAttr>("node").getInt());
  if (auto cells = dyn_cast<ActiveCellsOp>(op)) {
    Value slot = emitStackSlots(builder, loc, 1);
    IntegerAttr reach = cells.getReachAttr();
    Value count = reach ? runtime.tai_rt_gathered_cells(
                              builder, loc, frame, tree, node,
                              runtime.i64(builder, loc, reach.getInt()), slot)
                        : runtime.tai_rt_active_cells(builder, loc, frame, tree,
                                                      node, slot);
    Value list =
        LLVM::LoadOp::create(builder, loc, runtime.getPointerType(), slot);
    cells.getCells().replaceAllUsesWith(list);
    cells.getCount().replaceAllUsesWith(math.toIndex(count));
    return op->erase();
  }
  if (auto current = dyn_cast<ListIsCurrentOp>(op)) {
    Value all = runtime.tai_rt_list_is_current(builder, loc, frame, tree, node);
    current.getCurrent().replaceAllUsesWith(
        arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::ne, all,
                              runtime.i32(builder, loc, 0)));
    return op->erase();
  }
  Value number = math.toI64(op->getOperand(1));
  Value where = runtime.string(builder, loc, describePlace(loc));
  if (auto activate = dyn_cast<ActivateCellOp>(op)) {
    Value done =
        runtime.tai_rt_activate(builder, loc, frame, tree, node, number, where);
    activate.getDone().replaceAllUsesWith(
        arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::ne, done,
                              runtime.i32(builder, loc, 0)));
  } else if (auto append = dyn_cast<AppendCellOp>(op)) {
    Value at =
        runtime.tai_rt_append(builder, loc, frame, tree, node, number, where);
    append.getAt().replaceAllUsesWith(math.toIndex(at));
  } else {
    runtime.tai_rt_deactivate(builder, loc, frame, tree, node, number, where);
  }
  op->erase();
}

LogicalResult tai::lowerLeafOps(LLVM::LLVMFuncOp function,
                                ModuleLowering &lowering) {
  Value frame = function.getArgument(0);
  RuntimeCalls &runtime = lowering.runtime;
  SmallVector<Operation *> ops;
  llvm::DenseMap<StringAttr, Value> bases;
  function.walk([&](Operation *op) {
    if (isa<AllocaOp, StackCreateOp, AssertOp, PrintOp, TreeBaseOp,
            ActiveCellsOp, ListIsCurrentOp, ActivateCellOp, DeactivateCellOp,
            AppendCellOp>(op) ||
        (isa<UnrealizedConversionCastOp>(op) && op->hasAttr("stream")))
      ops.push_back(op);
  });
  for (Operation *op : ops) {
    LogicalResult result =
        llvm::TypeSwitch<Operation *, LogicalResult>(op)
            .Case([&](AllocaOp alloca) { return lowerLocal(alloca); })
            .Case([&](StackCreateOp stack) {
              return lowerStack(stack, frame, runtime);
            })
            .Case([&](AssertOp assertion) {
              return lowerAssert(assertion, frame, lowering);
            })
            .Case([&](PrintOp print) {
              return lowerPrint(print, frame, runtime);
            })
            .Case<ActiveCellsOp, ListIsCurrentOp, ActivateCellOp,
                  DeactivateCellOp, AppendCellOp>([&](auto cell) {
              lowerCellOp(cell, frame, runtime);
              return success();
            })
            .Case([&](UnrealizedConversionCastOp draw) {
              lowerDraw(draw, frame, runtime);
              return success();
            })
            .Case([&](TreeBaseOp tree) {
              Value &base = bases[tree.getTreeAttr().getAttr()];
              if (!base) {
                auto builder =
                    OpBuilder::atBlockBegin(&function.getBody().front());
                Value trees = runtime.frameMember(builder, tree.getLoc(), frame,
                                                  offsetof(TaiFrame, trees),
                                                  runtime.getPointerType());
                int64_t index =
                    lowering.treeIndex.lookup(tree.getTreeAttr().getAttr());
                base = runtime.frameMember(builder, tree.getLoc(), trees,
                                           index * sizeof(void *),
                                           runtime.getPointerType());
              }
              tree.getBase().replaceAllUsesWith(base);
              tree.erase();
              return success();
            })
            .Default([](Operation *) { return failure(); });
    if (failed(result))
      return failure();
  }
  return success();
}
