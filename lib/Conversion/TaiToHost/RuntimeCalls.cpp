//===- RuntimeCalls.cpp - Calls into the runtime --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Conversion/TaiToHost/RuntimeCalls.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "tai/Transforms/Utils/FieldAddress.h"

using namespace mlir;
using namespace mlir::tai;

RuntimeCalls::RuntimeCalls(Operation *table)
    : table(table),
      pointerType(LLVM::LLVMPointerType::get(table->getContext())) {
  for (auto function : table->getRegion(0).getOps<LLVM::LLVMFuncOp>())
    functions[function.getSymName()] = function;
}

Value RuntimeCalls::call(OpBuilder &builder, Location loc, StringRef name,
                         Type result, ValueRange arguments, bool pure) {
  LLVM::LLVMFuncOp &function = functions[name];
  if (!function) {
    Type returned =
        result ? result : LLVM::LLVMVoidType::get(builder.getContext());
    auto type = LLVM::LLVMFunctionType::get(
        returned, llvm::to_vector(arguments.getTypes()));
    OpBuilder top = OpBuilder::atBlockEnd(&table->getRegion(0).front());
    function = LLVM::LLVMFuncOp::create(top, table->getLoc(), name, type);
    function.setNoUnwind(true);
    if (pure) {
      function.setWillReturn(true);
      auto none = LLVM::ModRefInfo::NoModRef;
      function.setMemoryEffectsAttr(LLVM::MemoryEffectsAttr::get(
          builder.getContext(), {none, none, none, none, none, none}));
    }
  }
  auto call = LLVM::CallOp::create(builder, loc, function, arguments);
  return result ? call.getResult() : Value();
}

Value RuntimeCalls::global(OpBuilder &builder, Location loc, Type type,
                           Attribute value, StringRef prefix) {
  LLVM::GlobalOp &global = globals[value];
  if (!global) {
    OpBuilder top = OpBuilder::atBlockBegin(&table->getRegion(0).front());
    std::string name = (prefix + llvm::Twine(globals.size())).str();
    global = LLVM::GlobalOp::create(top, table->getLoc(), type,
                                    /*isConstant=*/true,
                                    LLVM::Linkage::Internal, name, value);
  }
  return LLVM::AddressOfOp::create(builder, loc, global);
}

Value RuntimeCalls::string(OpBuilder &builder, Location loc, StringRef text) {
  std::string terminated = text.str();
  terminated.push_back('\0');
  auto type = LLVM::LLVMArrayType::get(builder.getI8Type(), terminated.size());
  return global(builder, loc, type, builder.getStringAttr(terminated),
                "tai.string.");
}

Value RuntimeCalls::array(OpBuilder &builder, Location loc,
                          ArrayRef<int32_t> numbers) {
  auto type = LLVM::LLVMArrayType::get(builder.getI32Type(), numbers.size());
  return global(builder, loc, type, builder.getI32TensorAttr(numbers),
                "tai.array.");
}

Value RuntimeCalls::frameMember(OpBuilder &builder, Location loc, Value frame,
                                size_t offset, Type type) {
  Value address = frame;
  if (offset != 0)
    address = LLVM::GEPOp::create(
        builder, loc, pointerType, builder.getI8Type(), frame,
        ArrayRef<LLVM::GEPArg>{static_cast<int32_t>(offset)},
        LLVM::GEPNoWrapFlags::inbounds);
  auto load = LLVM::LoadOp::create(builder, loc, type, address);
  load.setInvariant(true);
  return load;
}

Value RuntimeCalls::null(OpBuilder &builder, Location loc) {
  return LLVM::ZeroOp::create(builder, loc, pointerType);
}

Value RuntimeCalls::i32(OpBuilder &builder, Location loc, int64_t value) {
  return arith::ConstantIntOp::create(builder, loc, value, 32);
}

Value RuntimeCalls::i64(OpBuilder &builder, Location loc, int64_t value) {
  return arith::ConstantIntOp::create(builder, loc, value, 64);
}

//===----------------------------------------------------------------------===//
// Slots
//===----------------------------------------------------------------------===//

Value tai::emitStackSlots(OpBuilder &builder, Location loc, int64_t count) {
  auto function = builder.getInsertionBlock()
                      ->getParentOp()
                      ->getParentOfType<LLVM::LLVMFuncOp>();
  if (!function)
    function =
        cast<LLVM::LLVMFuncOp>(builder.getInsertionBlock()->getParentOp());
  OpBuilder entry = OpBuilder::atBlockBegin(&function.getBody().front());
  Value one = arith::ConstantIntOp::create(entry, loc, 1, 64);
  auto type =
      LLVM::LLVMArrayType::get(entry.getI64Type(), std::max<int64_t>(count, 1));
  return LLVM::AllocaOp::create(
      entry, loc, LLVM::LLVMPointerType::get(builder.getContext()), type, one,
      /*alignment=*/8);
}

Value tai::emitSlot(OpBuilder &builder, Location loc, Value slots,
                    int64_t index) {
  if (index == 0)
    return slots;
  return LLVM::GEPOp::create(
      builder, loc, slots.getType(), builder.getI64Type(), slots,
      ArrayRef<LLVM::GEPArg>{static_cast<int32_t>(index)},
      LLVM::GEPNoWrapFlags::inbounds);
}

void tai::emitSlotStore(OpBuilder &builder, Location loc, Value value,
                        Value slot) {
  emitStore(builder, loc, value, slot, AliasScopes());
}

Value tai::emitSlotLoad(OpBuilder &builder, Location loc, Type type,
                        Value slot) {
  return emitLoad(builder, loc, type, slot, AliasScopes());
}

int64_t tai::getNumSlots(Type type) {
  if (auto vector = dyn_cast<VectorType>(type))
    return vector.getNumElements();
  if (auto memref = dyn_cast<MemRefType>(type))
    return 1 + memref.getRank();
  return 1;
}

//===----------------------------------------------------------------------===//
// Messages
//===----------------------------------------------------------------------===//

MessageValues tai::emitMessageValues(RuntimeCalls &runtime, OpBuilder &builder,
                                     Location loc, ValueRange values,
                                     ArrayRef<int32_t> shapes) {
  SmallVector<int32_t> ones(values.size(), 1);
  if (shapes.empty())
    shapes = ones;
  MessageValues message;
  message.count = runtime.i32(builder, loc, shapes.size());
  if (values.empty()) {
    message.kinds = message.shapes = message.slots = runtime.null(builder, loc);
    return message;
  }

  message.slots = emitStackSlots(builder, loc, values.size());
  SmallVector<int32_t> kinds;
  for (auto [i, value] : llvm::enumerate(values)) {
    Value slot = emitSlot(builder, loc, message.slots, i);
    Type type = value.getType();
    int32_t kind = TAI_VALUE_I64;
    if (isa<FloatType>(type)) {
      kind = TAI_VALUE_F64;
      if (!type.isF64())
        value =
            arith::ExtFOp::create(builder, loc, builder.getF64Type(), value);
    } else if (type.isInteger(1)) {
      kind = TAI_VALUE_BOOL;
      value = arith::ExtUIOp::create(builder, loc, builder.getI64Type(), value);
    } else if (!type.isIndex() && !type.isInteger(64)) {
      value = arith::ExtSIOp::create(builder, loc, builder.getI64Type(), value);
    }
    emitSlotStore(builder, loc, value, slot);
    kinds.push_back(kind);
  }
  // The runtime takes one kind for each printed value, however many components
  // the value has.
  SmallVector<int32_t> kindOfValue;
  size_t first = 0;
  for (int32_t shape : shapes) {
    kindOfValue.push_back(kinds[first]);
    first += shape;
  }
  message.kinds = runtime.array(builder, loc, kindOfValue);
  message.shapes = runtime.array(builder, loc, shapes);
  return message;
}

void tai::emitFail(RuntimeCalls &runtime, OpBuilder &builder, Location loc,
                   Value frame, int32_t failure, StringRef message,
                   ValueRange values, ArrayRef<int32_t> shapes) {
  MessageValues packed =
      emitMessageValues(runtime, builder, loc, values, shapes);
  Value text = runtime.string(builder, loc, message);
  Value where = runtime.string(builder, loc, describePlace(loc));
  runtime.tai_rt_fail(builder, loc, frame, runtime.i32(builder, loc, failure),
                      text, where, packed.count, packed.kinds, packed.shapes,
                      packed.slots);
}
