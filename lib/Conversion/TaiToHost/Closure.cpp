//===- Closure.cpp - Outlining with closures ------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/IRMapping.h"
#include "tai/Conversion/TaiToHost/Lowering.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"

using namespace mlir;
using namespace mlir::tai;

LLVM::LLVMFuncOp tai::createFunction(ModuleOp module, Location loc,
                                     StringRef name, Type result,
                                     ArrayRef<Type> arguments,
                                     bool isInternal) {
  OpBuilder builder = OpBuilder::atBlockEnd(module.getBody());
  Type returned =
      result ? result : LLVM::LLVMVoidType::get(module.getContext());
  auto function = LLVM::LLVMFuncOp::create(
      builder, loc, name, LLVM::LLVMFunctionType::get(returned, arguments),
      isInternal ? LLVM::Linkage::Internal : LLVM::Linkage::External);
  // Lowered code throws nothing; unwind tables would only cost compile time.
  function.setNoUnwind(true);
  markLowered(function);
  function.addEntryBlock(builder);
  return function;
}

LogicalResult tai::replaceOutside(Region &region,
                                  function_ref<bool(Value)> isOutside,
                                  function_ref<FailureOr<Value>(Value)> get) {
  WalkResult result = region.walk([&](Operation *op) {
    for (OpOperand &operand : op->getOpOperands()) {
      if (!isOutside(operand.get()))
        continue;
      FailureOr<Value> value = get(operand.get());
      if (failed(value))
        return WalkResult::interrupt();
      operand.set(*value);
    }
    return WalkResult::advance();
  });
  return failure(result.wasInterrupted());
}

//===----------------------------------------------------------------------===//
// Closure
//===----------------------------------------------------------------------===//

static bool isVectorOfScalars(Operation *op) {
  return isa<VectorType>(op->getResultTypes().front()) &&
         op->getNumRegions() == 0 && isMemoryEffectFree(op);
}

/// True if `op` adds or casts integers and is not part of the address of an
/// array, which is replaced later, at its uses.
static bool isIntegerSum(Operation *op) {
  return isa<arith::AddIOp, arith::SubIOp, arith::IndexCastOp, arith::ExtSIOp>(
             op) &&
         !op->getOperand(0)
              .getDefiningOp<memref::ExtractAlignedPointerAsIndexOp>();
}

Closure::Closure(LLVM::LLVMFuncOp inner, Value frame, Operation *call)
    : inner(inner), call(call), entry(inner.getContext()) {
  known[frame] = inner.getArgument(0);
}

FailureOr<Value> Closure::get(Value outer) {
  Value &value = known[outer];
  if (value)
    return value;
  entry.setInsertionPointToStart(&inner.getBody().front());
  Operation *definition = outer.getDefiningOp();
  if (definition && definition->getNumOperands() == 0 &&
      (definition->hasTrait<OpTrait::ConstantLike>() ||
       isa<TreeBaseOp, LLVM::AddressOfOp>(definition))) {
    value = entry.clone(*definition)->getResult(0);
    return value;
  }
  // Vectors of captured scalars and sums of integers are recomputed, because
  // LLVM must see the constant distance of slots such as `t` and `t + 1`.
  if (definition &&
      (isVectorOfScalars(definition) || isIntegerSum(definition))) {
    IRMapping operands;
    Operation *last = nullptr;
    for (Value operand : definition->getOperands()) {
      FailureOr<Value> inside = get(operand);
      if (failed(inside))
        return failure();
      operands.map(operand, *inside);
      Operation *made = inside->getDefiningOp();
      if (made && (!last || last->isBeforeInBlock(made)))
        last = made;
    }
    if (last)
      entry.setInsertionPointAfter(last);
    else
      entry.setInsertionPointToStart(&inner.getBody().front());
    Value copy = entry.clone(*definition, operands)
                     ->getResult(cast<OpResult>(outer).getResultNumber());
    known[outer] = copy;
    return copy;
  }
  Type type = outer.getType();
  if (!type.isIntOrIndexOrFloat() && !isa<LLVM::LLVMPointerType>(type)) {
    InFlightDiagnostic diag =
        call->emitOpError("uses a value of type ")
        << type << " from outside; expects scalars, as tai-scalarize makes "
        << "them";
    diag.attachNote(outer.getLoc()) << "value defined here";
    return diag;
  }
  Value slot =
      emitSlot(entry, call->getLoc(), inner.getArgument(1), captured.size());
  value = emitSlotLoad(entry, call->getLoc(), type, slot);
  captured[outer] = value;
  return value;
}

LogicalResult Closure::capture(Region &region) {
  auto isOutside = [&](Value value) {
    Region *at = value.getParentRegion();
    return !inner.getBody().isAncestor(at);
  };
  return replaceOutside(region, isOutside,
                        [&](Value outer) { return get(outer); });
}

Value Closure::emit(RuntimeCalls &runtime) {
  OpBuilder builder(call);
  Location loc = call->getLoc();
  if (captured.empty())
    return runtime.null(builder, loc);
  Value slots = emitStackSlots(builder, loc, captured.size());
  for (auto [i, pair] : llvm::enumerate(captured))
    emitSlotStore(builder, loc, pair.first, emitSlot(builder, loc, slots, i));
  return slots;
}

//===----------------------------------------------------------------------===//
// Arguments and results
//===----------------------------------------------------------------------===//

/// Replaces an array argument by its address and extents: after
/// tai-lower-layout, the array has only uses that ask for these.
static LogicalResult replaceArray(BlockArgument array, Value address,
                                  ArrayRef<Value> extents) {
  for (OpOperand &use : llvm::make_early_inc_range(array.getUses())) {
    Operation *user = use.getOwner();
    if (auto pointer = dyn_cast<memref::ExtractAlignedPointerAsIndexOp>(user)) {
      for (Operation *cast : llvm::make_early_inc_range(pointer->getUsers())) {
        if (!isa<arith::IndexCastOp>(cast))
          return cast->emitOpError("cannot be lowered on the address of an "
                                   "array");
        // A chain of casts from the address to index, i64 and back to a pointer
        // is the address itself.
        for (Operation *back : llvm::make_early_inc_range(cast->getUsers())) {
          if (!isa<LLVM::IntToPtrOp>(back))
            continue;
          back->getResult(0).replaceAllUsesWith(address);
          back->erase();
        }
        OpBuilder builder(cast);
        if (!cast->use_empty())
          cast->getResult(0).replaceAllUsesWith(LLVM::PtrToIntOp::create(
              builder, cast->getLoc(), cast->getResult(0).getType(), address));
        cast->erase();
      }
      user->erase();
      continue;
    }
    auto dim = dyn_cast<memref::DimOp>(user);
    std::optional<int64_t> index = dim ? dim.getConstantIndex() : std::nullopt;
    if (!index || *index < 0 || *index >= int64_t(extents.size()))
      return user->emitOpError("cannot be lowered on an array argument of a "
                               "kernel");
    dim.getResult().replaceAllUsesWith(extents[*index]);
    dim.erase();
  }
  return success();
}

LogicalResult tai::replaceArguments(FunctionOpInterface function, Value frame,
                                    OpBuilder &builder, RuntimeCalls &runtime,
                                    ArrayAddress arrayAddress) {
  if (function.getNumArguments() == 0)
    return success();
  Location loc = function.getLoc();
  Value slots = runtime.frameMember(
      builder, loc, frame, offsetof(TaiFrame, args), runtime.getPointerType());
  int64_t next = 0;
  auto loadNext = [&](Type type) {
    return emitSlotLoad(builder, loc, type,
                        emitSlot(builder, loc, slots, next++));
  };
  for (BlockArgument argument : function.getArguments()) {
    Type type = argument.getType();
    if (auto memref = dyn_cast<MemRefType>(type)) {
      Value address = loadNext(runtime.getPointerType());
      SmallVector<Value> extents;
      // Dimensions that tai-scalarize has added for the elements of an array
      // are constant, and callers pass no extents for them.
      auto elementRank = function.getArgAttrOfType<IntegerAttr>(
          argument.getArgNumber(), "tai.element_rank");
      int64_t rank =
          memref.getRank() - (elementRank ? elementRank.getInt() : 0);
      for (int64_t i = 0; i != rank; ++i)
        extents.push_back(loadNext(builder.getIndexType()));
      if (arrayAddress)
        address = arrayAddress(builder, argument, address, extents);
      if (failed(replaceArray(argument, address, extents)))
        return failure();
      continue;
    }
    if (auto vector = dyn_cast<VectorType>(type)) {
      SmallVector<Value> components;
      for (int64_t i = 0; i != vector.getNumElements(); ++i)
        components.push_back(loadNext(vector.getElementType()));
      for (OpOperand &use : llvm::make_early_inc_range(argument.getUses())) {
        auto parts = dyn_cast<vector::ToElementsOp>(use.getOwner());
        if (!parts)
          return use.getOwner()->emitOpError("uses ")
                 << type << "; expects scalars, as tai-scalarize makes them";
        parts->replaceAllUsesWith(components);
        parts->erase();
      }
      continue;
    }
    argument.replaceAllUsesWith(loadNext(type));
  }
  return success();
}

/// Emits stores of the returned values to the slots of the frame.
static void emitResults(ValueRange values, Location loc, Value frame,
                        OpBuilder &builder, RuntimeCalls &runtime) {
  if (values.empty())
    return;
  Value slots =
      runtime.frameMember(builder, loc, frame, offsetof(TaiFrame, results),
                          runtime.getPointerType());
  int64_t next = 0;
  for (Value value : values) {
    SmallVector<Value> components{value};
    auto parts = value.getDefiningOp<vector::FromElementsOp>();
    if (parts)
      components.assign(parts.getElements().begin(), parts.getElements().end());
    for (Value component : components)
      emitSlotStore(builder, loc, component,
                    emitSlot(builder, loc, slots, next++));
  }
}

void tai::replaceReturn(Operation *ret, Location loc, Value frame,
                        OpBuilder &builder, RuntimeCalls &runtime) {
  builder.setInsertionPoint(ret);
  emitResults(ret->getOperands(), loc, frame, builder, runtime);
  SmallVector<Value> returned(ret->getOperands());
  ret->erase();
  for (Value value : returned)
    if (auto parts = value.getDefiningOp<vector::FromElementsOp>())
      if (parts->use_empty())
        parts.erase();
}
