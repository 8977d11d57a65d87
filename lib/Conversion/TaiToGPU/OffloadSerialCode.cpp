//===- OffloadSerialCode.cpp - Serial code on the device ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Outside of its parallel loops, a kernel is serial code. Accesses to fields,
// and computations that depend on them, run on the device: sequences of such
// ops become loops of one iteration, which one thread executes. Arithmetic on
// arguments, and control flow around loops, stays on the host.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Conversion/TaiToGPU/Offload.h"
#include "tai/Dialect/Mesh/IR/Mesh.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "llvm/Support/CheckedArithmetic.h"

using namespace mlir;
using namespace mlir::tai;

bool tai::isDeviceLoop(Operation *op) {
  auto loop = dyn_cast<ParallelForOp>(op);
  return loop && !loop.getSerialize() &&
         !loop->getParentOfType<ParallelForOp>();
}

/// True for ops that request lists of active cells, refuse launches or
/// communicate with other processes, which only the host can do.
static bool isHostOp(Operation *op) {
  return isa<ActiveCellsOp, ListIsCurrentOp, PreconditionOp, tai::RankOp,
             ExchangeOp>(op);
}

/// True if `op` contains a device loop or a host op.
static bool staysOnHost(Operation *op) {
  return op
      ->walk<WalkOrder::PreOrder>([](Operation *inner) {
        return isDeviceLoop(inner) || isHostOp(inner) ? WalkResult::interrupt()
                                                      : WalkResult::advance();
      })
      .wasInterrupted();
}

/// Moves requests for lists of active cells out of loops. This is correct
/// unless the loop changes which cells are active.
static LogicalResult hoistLists(LLVM::LLVMFuncOp host) {
  SmallVector<Operation *> inside;
  host.walk([&](Operation *op) {
    if (isHostOp(op) && op->getParentOfType<ParallelForOp>())
      inside.push_back(op);
  });
  for (Operation *op : inside) {
    auto outer = op->getParentOfType<ParallelForOp>();
    while (auto next = outer->getParentOfType<ParallelForOp>())
      outer = next;
    bool changes =
        outer
            .walk([](Operation *inner) {
              return isa<ActivateCellOp, DeactivateCellOp, AppendCellOp>(inner)
                         ? WalkResult::interrupt()
                         : WalkResult::advance();
            })
            .wasInterrupted();
    if (changes && isa<ActiveCellsOp>(op))
      return op->emitError(
          "the list of active cells, inside of a parallel loop that changes "
          "which are active, does not come to the GPU yet; make the loop over "
          "them a kernel of its own");
    op->moveBefore(outer);
  }
  return success();
}

/// Allocates device memory that lives until the end of the launch.
static Value createScratch(OpBuilder &builder, Location loc, Value frame,
                           RuntimeCalls &runtime, int64_t bytes) {
  return runtime.tai_rt_device_scratch(builder, loc, frame,
                                       runtime.i64(builder, loc, bytes));
}

namespace {
/// Consecutive ops of one block that one thread of the device runs, in order.
struct Group {
  SmallVector<Operation *> ops;
};

class SerialOffload {
public:
  SerialOffload(Value frame, DeviceLowering &lowering)
      : frame(frame), lowering(lowering) {}

  /// Assigns the ops of a block, given in order, to groups.
  void assign(ArrayRef<Operation *> ops);
  /// Wraps each group of ops into a loop of one iteration, which becomes a
  /// device function.
  LogicalResult emit();

private:
  bool runsOnDevice(Operation *op);
  void add(Operation *op);
  Group *findEarlier(Operation *op);
  LogicalResult emit(Group &group);

  Value frame;
  DeviceLowering &lowering;
  std::vector<std::unique_ptr<Group>> groups;
  /// For each op that runs on the device, its group of ops.
  llvm::DenseMap<Operation *, Group *> groupOf;
  /// The last group if further ops can join it, else null.
  Group *open = nullptr;
};
} // namespace

/// True if `op` does more than arithmetic. Calls by which the host gets device
/// memory do not count.
static bool hasEffects(Operation *op) {
  if (auto call = dyn_cast<LLVM::CallOp>(op))
    if (call.getCallee() && call.getCallee()->starts_with("tai_rt_device_"))
      return false;
  return isa<StackCreateOp, AllocaOp>(op) ||
         (!isa<TreeBaseOp>(op) && !isHostOp(op) && !isMemoryEffectFree(op));
}

bool SerialOffload::runsOnDevice(Operation *op) {
  if (hasEffects(op))
    return true;
  return op
      ->walk([&](Operation *inner) {
        bool usesDevice = llvm::any_of(inner->getOperands(), [&](Value value) {
          return groupOf.contains(value.getDefiningOp());
        });
        return usesDevice ? WalkResult::interrupt() : WalkResult::advance();
      })
      .wasInterrupted();
}

/// Returns an earlier group of device ops that `op` can join, which saves a
/// launch, if it is arithmetic on values of that group.
Group *SerialOffload::findEarlier(Operation *op) {
  if (hasEffects(op) || op->getNumRegions() != 0)
    return nullptr;
  Group *latest = nullptr;
  auto forEachNeighbour = [&](auto visit) {
    for (Value operand : op->getOperands())
      if (Operation *definition = operand.getDefiningOp())
        if (definition->getBlock() == op->getBlock())
          visit(definition, groupOf.lookup(definition));
  };
  forEachNeighbour([&](Operation *definition, Group *group) {
    if (group && (!latest || latest->ops.back()->isBeforeInBlock(definition)))
      latest = group;
  });
  bool isReady = latest != nullptr;
  forEachNeighbour([&](Operation *definition, Group *group) {
    isReady &= group || definition->isBeforeInBlock(latest->ops.back());
  });
  return isReady ? latest : nullptr;
}

void SerialOffload::add(Operation *op) {
  Group *group = open;
  if (!group) {
    group = findEarlier(op);
    if (group)
      op->moveAfter(group->ops.back());
  }
  if (!group) {
    groups.push_back(std::make_unique<Group>());
    group = open = groups.back().get();
  }
  group->ops.push_back(op);
  groupOf[op] = group;
}

void SerialOffload::assign(ArrayRef<Operation *> ops) {
  open = nullptr;
  for (Operation *op : ops) {
    if (op->hasTrait<OpTrait::IsTerminator>())
      continue;
    if (staysOnHost(op)) {
      open = nullptr;
      if (!isDeviceLoop(op))
        for (Region &region : op->getRegions())
          for (Block &block : region)
            assign(llvm::map_to_vector(
                block, [](Operation &inner) { return &inner; }));
      open = nullptr;
    } else if (isa<vector::FromElementsOp>(op)) {
      // A vector of arguments is built by the host, which packs the arguments
      // of a launch.
      op->moveBefore(op->getBlock()->getTerminator());
    } else if (runsOnDevice(op)) {
      add(op);
    }
  }
  open = nullptr;
}

LogicalResult SerialOffload::emit(Group &group) {
  Operation *last = group.ops.back();
  Location loc = group.ops.front()->getLoc();
  OpBuilder builder(last->getContext());
  builder.setInsertionPointAfter(last);
  auto isOutside = [&](Operation *user) {
    Operation *ancestor = last->getBlock()->findAncestorOpInBlock(*user);
    return !ancestor || groupOf.lookup(ancestor) != &group;
  };
  // Results of the group that other code uses are passed through memory.
  SmallVector<Value> handedOn;
  for (Operation *op : group.ops)
    for (Value result : op->getResults())
      if (llvm::any_of(result.getUsers(), isOutside))
        handedOn.push_back(result);
  for (Value value : handedOn)
    if (!value.getType().isIntOrIndexOrFloat() &&
        !isa<LLVM::LLVMPointerType>(value.getType()))
      return value.getDefiningOp()->emitOpError("yields ")
             << value.getType()
             << " to another part of the kernel; parts of a kernel on a GPU "
                "hand on scalars alone";
  Value slots;
  if (!handedOn.empty())
    slots = createScratch(builder, loc, frame, lowering.host.runtime,
                          8 * handedOn.size());

  Value zero = arith::ConstantIndexOp::create(builder, loc, 0);
  Value one = arith::ConstantIndexOp::create(builder, loc, 1);
  auto loop =
      ParallelForOp::create(builder, loc, ValueRange{zero}, ValueRange{one});
  Block *body = &loop.getBody().front();
  for (Operation *op : group.ops)
    op->moveBefore(body->getTerminator());
  for (auto [i, value] : llvm::enumerate(handedOn)) {
    builder.setInsertionPoint(loop);
    Value slot = emitSlot(builder, loc, slots, i);
    builder.setInsertionPointAfter(loop);
    auto outside = UnrealizedConversionCastOp::create(builder, value.getLoc(),
                                                      value.getType(), slot);
    outside->setAttr(kDeviceSlotAttrName, builder.getUnitAttr());
    value.replaceUsesWithIf(outside.getResult(0), [&](OpOperand &use) {
      return !loop->isProperAncestor(use.getOwner());
    });
    builder.setInsertionPoint(body->getTerminator());
    emitSlotStore(builder, value.getLoc(), value, slot);
  }
  return success();
}

LogicalResult SerialOffload::emit() {
  for (auto &group : groups)
    if (failed(emit(*group)))
      return failure();
  return success();
}

/// True if the size of `type` is known. A data layout ends the process when it
/// is asked for the size of any other type.
static bool hasFixedSize(Type type) {
  if (auto vector = dyn_cast<VectorType>(type))
    return !vector.isScalable() && hasFixedSize(vector.getElementType());
  if (auto array = dyn_cast<LLVM::LLVMArrayType>(type))
    return hasFixedSize(array.getElementType());
  if (auto structure = dyn_cast<LLVM::LLVMStructType>(type))
    return !structure.isOpaque() &&
           llvm::all_of(structure.getBody(), hasFixedSize);
  return type.isIntOrIndexOrFloat() || isa<LLVM::LLVMPointerType>(type);
}

/// Returns the size in bytes of an array that several parts of a kernel share.
static FailureOr<int64_t> getSharedBytes(LLVM::AllocaOp array,
                                         const DataLayout &layout) {
  if (!hasFixedSize(array.getElemType()))
    return array.emitOpError("allocates ")
           << array.getElemType()
           << ", whose size is unknown; parts of a kernel on a GPU cannot "
              "share it";
  std::optional<int64_t> count = getConstantIntValue(array.getArraySize());
  std::optional<int64_t> bytes;
  if (count && *count >= 0)
    bytes = llvm::checkedMul<int64_t>(
        *count, layout.getTypeSize(array.getElemType()).getFixedValue());
  if (!bytes)
    return array.emitOpError(
        "allocates a number of elements that is computed, negative or too "
        "large; parts of a kernel on a GPU share arrays of constant size "
        "alone");
  return *bytes;
}

/// Moves variables that several parts of a kernel use to device memory: they
/// cannot be on the stack of a single part.
static LogicalResult shareLocals(LLVM::LLVMFuncOp host, Value frame,
                                 DeviceLowering &lowering) {
  RuntimeCalls &runtime = lowering.host.runtime;
  DataLayout layout(lowering.host.module);
  SmallVector<LLVM::AllocaOp> arrays;
  SmallVector<AllocaOp> locals;
  host.walk<WalkOrder::PreOrder>([&](Operation *op) {
    if (isDeviceLoop(op))
      return WalkResult::skip();
    if (auto array = dyn_cast<LLVM::AllocaOp>(op))
      arrays.push_back(array);
    if (auto local = dyn_cast<AllocaOp>(op))
      locals.push_back(local);
    return WalkResult::advance();
  });
  for (LLVM::AllocaOp array : arrays) {
    FailureOr<int64_t> bytes = getSharedBytes(array, layout);
    if (failed(bytes))
      return failure();
    OpBuilder builder(array);
    array.getResult().replaceAllUsesWith(
        createScratch(builder, array.getLoc(), frame, runtime, *bytes));
    array.erase();
  }
  for (AllocaOp local : locals) {
    // A local inside serial code is a variable of the thread that runs the
    // code.
    Operation *outer = local->getParentOp();
    if (outer != host && !staysOnHost(outer))
      continue;
    OpBuilder builder(local);
    Location loc = local.getLoc();
    Type type = cast<LocalType>(local.getLocal().getType()).getElementType();
    if (isa<VectorType>(type))
      continue;
    Value slot = createScratch(builder, loc, frame, runtime, 8);
    Value zero =
        arith::ConstantOp::create(builder, loc, builder.getZeroAttr(type));
    emitSlotStore(builder, loc, zero, slot);
    for (Operation *user : llvm::make_early_inc_range(local->getUsers())) {
      builder.setInsertionPoint(user);
      if (auto load = dyn_cast<LocalLoadOp>(user))
        load.replaceAllUsesWith(
            emitSlotLoad(builder, load.getLoc(), type, slot));
      else if (auto store = dyn_cast<LocalStoreOp>(user))
        emitSlotStore(builder, store.getLoc(), store.getValue(), slot);
      user->erase();
    }
    local.erase();
  }
  return success();
}

LogicalResult tai::offloadSerialCode(LLVM::LLVMFuncOp host, Operation *start,
                                     Value frame, DeviceLowering &lowering) {
  if (failed(hoistLists(host)) || failed(shareLocals(host, frame, lowering)))
    return failure();
  SmallVector<Operation *> ops;
  for (Operation *op = start->getNextNode(); op; op = op->getNextNode())
    ops.push_back(op);
  SerialOffload offload(frame, lowering);
  offload.assign(ops);
  return offload.emit();
}

void tai::readLengthsOnDevice(LLVM::LLVMFuncOp host) {
  SmallVector<ActiveCellsOp> lists;
  host.walk([&](ActiveCellsOp list) { lists.push_back(list); });
  for (ActiveCellsOp list : lists) {
    OpBuilder builder(list->getContext());
    builder.setInsertionPointAfter(list);
    Location loc = list.getLoc();
    Value slot = LLVM::GEPOp::create(builder, loc, list.getCells().getType(),
                                     builder.getI64Type(), list.getCells(),
                                     ArrayRef<LLVM::GEPArg>{-1});
    auto length = UnrealizedConversionCastOp::create(
        builder, loc, list.getCount().getType(),
        ValueRange{slot, list.getCount()});
    length->setAttr(kDeviceSlotAttrName, builder.getUnitAttr());
    list.getCount().replaceAllUsesExcept(length.getResult(0), length);
  }
}

void tai::fetchHostValues(LLVM::LLVMFuncOp host, Value frame,
                          DeviceLowering &lowering) {
  RuntimeCalls &runtime = lowering.host.runtime;
  SmallVector<UnrealizedConversionCastOp> values;
  host.walk([&](UnrealizedConversionCastOp cast) {
    if (cast->hasAttr(kDeviceSlotAttrName))
      values.push_back(cast);
  });
  for (UnrealizedConversionCastOp value : values) {
    if (!value->use_empty()) {
      // Values are fetched from the device as late as possible, because a fetch
      // waits for all work queued before it.
      Operation *first = nullptr;
      for (Operation *user : value->getUsers()) {
        Operation *here = value->getBlock()->findAncestorOpInBlock(*user);
        if (here && (!first || here->isBeforeInBlock(first)))
          first = here;
      }
      OpBuilder builder(first ? first : value.getOperation());
      Location loc = value.getLoc();
      Value room = emitStackSlots(builder, loc, 1);
      runtime.tai_rt_device_fetch(builder, loc, frame, room,
                                  value.getOperand(0),
                                  runtime.i64(builder, loc, 8));
      value.getResult(0).replaceAllUsesWith(
          emitSlotLoad(builder, loc, value.getResult(0).getType(), room));
    }
    value.erase();
  }
}
