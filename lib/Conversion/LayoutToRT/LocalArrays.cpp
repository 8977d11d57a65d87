//===- LocalArrays.cpp - Arrays local to a kernel -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "LocalArrays.h"
#include "mlir/Dialect/LLVMIR/FunctionCallUtils.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/Interfaces/DataLayoutInterfaces.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"
#include "tai/Transforms/Utils/FieldAddress.h"
#include "tai/Transforms/Utils/IndexMath.h"

using namespace mlir;
using namespace mlir::tai;

/// Returns the kind of `tai.atomic` that corresponds to an upstream kind of
/// atomic.
static std::optional<AtomicKind> toAtomicKind(arith::AtomicRMWKind kind) {
  switch (kind) {
  case arith::AtomicRMWKind::addf:
  case arith::AtomicRMWKind::addi:
    return AtomicKind::Add;
  case arith::AtomicRMWKind::mulf:
    return AtomicKind::Mul;
  case arith::AtomicRMWKind::minimumf:
    return AtomicKind::Min;
  case arith::AtomicRMWKind::maximumf:
  case arith::AtomicRMWKind::maxs:
    return AtomicKind::Max;
  default:
    return std::nullopt;
  }
}

namespace {
/// Lowers one array.
class ArrayLowering {
public:
  ArrayLowering(FunctionOpInterface function, Operation *alloc, bool onDevice)
      : function(function), alloc(alloc), onDevice(onDevice),
        array(alloc->getResult(0)), type(cast<MemRefType>(array.getType())) {}

  LogicalResult run() {
    for (Operation *user : array.getUsers()) {
      auto atomic = dyn_cast<memref::AtomicRMWOp>(user);
      if (atomic
              ? !toAtomicKind(atomic.getKind())
              : !isa<memref::LoadOp, memref::StoreOp, memref::DeallocOp>(user))
        return user->emitOpError(
            "cannot be lowered on an array that a kernel makes");
    }
    if (!type.getLayout().isIdentity() ||
        !type.getElementType().isIntOrIndexOrFloat())
      return alloc->emitOpError("makes an array of a type that cannot be "
                                "lowered");
    bool isInLoop = alloc->getParentOfType<ParallelForOp>() != nullptr;
    if (isa<memref::AllocaOp>(alloc) && !type.hasStaticShape())
      return alloc->emitOpError("cannot be lowered here; use 'memref.alloc'");
    isOnStack = isa<memref::AllocaOp>(alloc) && !(onDevice && isInLoop);
    // On a device, a thread runs several iterations in a loop, in which its
    // stack would grow: the array is allocated and freed instead. See
    // ToNVVM/LocalMemory.cpp.
    if (isa<memref::AllocaOp>(alloc) && !isOnStack) {
      OpBuilder end(alloc->getBlock()->getTerminator());
      memref::DeallocOp::create(end, alloc->getLoc(), array);
    }
    allocate();
    for (Operation *user : llvm::make_early_inc_range(array.getUsers()))
      lowerUse(user);
    alloc->erase();
    return success();
  }

private:
  void allocate() {
    OpBuilder builder(alloc);
    Location loc = alloc->getLoc();
    IndexMath math(builder, loc);
    storage = getStorageType(type.getElementType());
    auto dynamic = alloc->getOperands().begin();
    Value count = math.constant(1);
    for (int64_t extent : type.getShape()) {
      extents.push_back(ShapedType::isDynamic(extent) ? *dynamic++
                                                      : math.constant(extent));
      count = math.mul(count, extents.back());
    }
    auto pointer = LLVM::LLVMPointerType::get(builder.getContext());
    if (isOnStack) {
      // The array is allocated at the top of the kernel, wherever `alloc` is,
      // so that the stack does not grow. An array of an iteration of a parallel
      // loop becomes a local variable of the loop's function instead.
      if (!alloc->getParentOfType<ParallelForOp>())
        builder.setInsertionPointToStart(&function.getFunctionBody().front());
      Value size = LLVM::ConstantOp::create(builder, loc, builder.getI64Type(),
                                            type.getNumElements());
      base = LLVM::AllocaOp::create(builder, loc, pointer, storage, size);
      return;
    }
    Operation *table = SymbolTable::getNearestSymbolTable(function);
    FailureOr<LLVM::LLVMFuncOp> malloc =
        LLVM::lookupOrCreateMallocFn(builder, table, builder.getI64Type());
    base = LLVM::CallOp::create(builder, loc, *malloc,
                                getBytes(builder, loc, math.toI64(count)))
               .getResult();
  }

  /// Emits the size of the local array in bytes: a constant where its shape is
  /// static.
  Value getBytes(OpBuilder &builder, Location loc, Value count) {
    Type i64 = builder.getI64Type();
    if (type.hasStaticShape()) {
      auto each = static_cast<int64_t>(
          DataLayout::closest(alloc).getTypeSize(storage).getFixedValue());
      return LLVM::ConstantOp::create(builder, loc, i64,
                                      type.getNumElements() * each);
    }
    auto pointer = LLVM::LLVMPointerType::get(builder.getContext());
    Value one = LLVM::ConstantOp::create(builder, loc, i64, 1);
    Value null = LLVM::ZeroOp::create(builder, loc, pointer);
    Value end = LLVM::GEPOp::create(builder, loc, pointer, storage, null, one);
    Value each = LLVM::PtrToIntOp::create(builder, loc, i64, end);
    return LLVM::MulOp::create(builder, loc, count, each);
  }

  Value getElement(OpBuilder &builder, Location loc, ValueRange indices) {
    IndexMath math(builder, loc);
    Value offset = math.constant(0);
    for (auto [index, extent] : llvm::zip(indices, extents))
      offset = math.add(math.mul(offset, extent), index);
    return emitPointer(builder, loc, storage, base, offset);
  }

  void lowerUse(Operation *user) {
    OpBuilder builder(user);
    Location loc = user->getLoc();
    if (auto load = dyn_cast<memref::LoadOp>(user)) {
      load.getResult().replaceAllUsesWith(
          emitLoad(builder, loc, type.getElementType(),
                   getElement(builder, loc, load.getIndices()), {}));
    } else if (auto store = dyn_cast<memref::StoreOp>(user)) {
      emitStore(builder, loc, store.getValueToStore(),
                getElement(builder, loc, store.getIndices()), {});
    } else if (auto atomic = dyn_cast<memref::AtomicRMWOp>(user)) {
      lowerSum(atomic);
    } else {
      Operation *table = SymbolTable::getNearestSymbolTable(function);
      FailureOr<LLVM::LLVMFuncOp> free =
          LLVM::lookupOrCreateFreeFn(builder, table);
      LLVM::CallOp::create(builder, loc, *free, base);
    }
    user->erase();
  }

  void lowerSum(memref::AtomicRMWOp atomic) {
    OpBuilder builder(atomic);
    Location loc = atomic.getLoc();
    AtomicKind kind = *toAtomicKind(atomic.getKind());
    ReductionAttr reduction = getReduction(atomic);
    if (!reduction) {
      auto loop = atomic->getParentOfType<ParallelForOp>();
      bool isAlone = !loop || loop.getSerialize();
      Value element = getElement(builder, loc, atomic.getIndices());
      Value old = isAlone ? emitPlainUpdate(builder, loc, kind,
                                            atomic.getValue(), element, {})
                          : emitAtomicUpdate(builder, loc, kind,
                                             atomic.getValue(), element, {});
      atomic.getResult().replaceAllUsesWith(old);
      return;
    }
    // The loop accumulates in a register and needs the element's address after
    // its end, so the address is computed at the array's definition.
    OpBuilder start(builder.getContext());
    start.setInsertionPointAfterValue(base);
    IndexMath math(start, loc);
    auto constants =
        llvm::map_to_vector(atomic.getIndices(), [&](Value index) -> Value {
          return math.constant(*getConstantIntValue(index));
        });
    auto update = LLVM::AtomicRMWOp::create(
        builder, loc, LLVM::AtomicBinOp::fadd,
        getElement(start, loc, constants), atomic.getValue(),
        LLVM::AtomicOrdering::monotonic);
    update->setAttr(kAccumulateAttrName, reduction);
    atomic.getResult().replaceAllUsesWith(update);
  }

  FunctionOpInterface function;
  Operation *alloc;
  bool onDevice;
  bool isOnStack = false;
  Value array;
  MemRefType type;
  Type storage;
  Value base;
  SmallVector<Value> extents;
};
} // namespace

LogicalResult mlir::tai::lowerLocalArrays(FunctionOpInterface function,
                                          bool onDevice) {
  SmallVector<Operation *> allocs;
  function.walk([&](Operation *op) {
    if (isa<memref::AllocOp, memref::AllocaOp>(op))
      allocs.push_back(op);
  });
  for (Operation *alloc : allocs)
    if (failed(ArrayLowering(function, alloc, onDevice).run()))
      return failure();
  return success();
}
