//===- Stacks.cpp - Stacks of scalars -------------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A stack is a TaiStack in the stack frame of the function, followed by its
// first slots. Push and pop are a few instructions; the runtime is called to
// grow the stack, and to free a grown one.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Conversion/TaiToHost/Lowering.h"

using namespace mlir;
using namespace mlir::tai;

static_assert(sizeof(TaiStack) == 3 * sizeof(int64_t), "members are slots");

namespace {
/// Emits the code of creation, pushes and pops for one stack.
class StackLowering {
public:
  StackLowering(OpBuilder &builder, Location loc, Value stack, Value frame,
                RuntimeCalls &runtime)
      : builder(builder), loc(loc), stack(stack), frame(frame),
        runtime(runtime) {}

  void create() {
    store(getMember(3), 0);
    store(runtime.i64(builder, loc, 0), 1);
    store(runtime.i64(builder, loc, TAI_STACK_SLOTS), 2);
  }

  void push(Value value) {
    Value isFull = arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::eq,
                                         loadSize(), load(2));
    OpBuilder inside = onlyIf(isFull);
    runtime.tai_rt_stack_grow(inside, loc, frame, stack);
    Value size = loadSize();
    emitSlotStore(builder, loc, value, getTop(size));
    store(add(size, 1), 1);
  }

  Value pop(Type type) {
    // A stack that failed to grow is empty, and its size must not become
    // negative.
    Value size = arith::MaxSIOp::create(builder, loc, add(loadSize(), -1),
                                        runtime.i64(builder, loc, 0));
    store(size, 1);
    return emitSlotLoad(builder, loc, type, getTop(size));
  }

  void destroy() {
    Value grown =
        arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::ne, load(2),
                              runtime.i64(builder, loc, TAI_STACK_SLOTS));
    OpBuilder inside = onlyIf(grown);
    runtime.tai_rt_stack_free(inside, loc, stack);
  }

private:
  Value getMember(int64_t index) {
    return emitSlot(builder, loc, stack, index);
  }
  void store(Value value, int64_t index) {
    emitSlotStore(builder, loc, value, getMember(index));
  }
  Value load(int64_t index) {
    return emitSlotLoad(builder, loc, builder.getI64Type(), getMember(index));
  }
  Value loadSize() { return load(1); }
  Value add(Value value, int64_t constant) {
    return arith::AddIOp::create(builder, loc, value,
                                 runtime.i64(builder, loc, constant));
  }
  /// Emits the address of the stack slot at `position`.
  Value getTop(Value position) {
    Value slots = emitSlotLoad(builder, loc, runtime.getPointerType(), stack);
    return LLVM::GEPOp::create(
        builder, loc, slots.getType(), builder.getI64Type(), slots,
        ArrayRef<LLVM::GEPArg>{position}, LLVM::GEPNoWrapFlags::inbounds);
  }
  OpBuilder onlyIf(Value condition) {
    return scf::IfOp::create(builder, loc, condition).getThenBodyBuilder();
  }

  OpBuilder &builder;
  Location loc;
  Value stack, frame;
  RuntimeCalls &runtime;
};
} // namespace

LogicalResult tai::lowerStack(StackCreateOp op, Value frame,
                              RuntimeCalls &runtime) {
  OpBuilder builder(op);
  Value stack = emitStackSlots(builder, op.getLoc(), 3 + TAI_STACK_SLOTS);
  StackLowering(builder, op.getLoc(), stack, frame, runtime).create();
  for (Operation *user : llvm::make_early_inc_range(op->getUsers())) {
    builder.setInsertionPoint(user);
    StackLowering lowering(builder, user->getLoc(), stack, frame, runtime);
    if (auto push = dyn_cast<StackPushOp>(user)) {
      lowering.push(push.getValue());
    } else if (auto pop = dyn_cast<StackPopOp>(user)) {
      Value value = lowering.pop(pop.getValue().getType());
      pop.getValue().replaceAllUsesWith(value);
    } else if (isa<StackDestroyOp>(user)) {
      lowering.destroy();
    } else {
      return user->emitOpError("cannot be lowered on a stack");
    }
    user->erase();
  }
  op.erase();
  return success();
}
