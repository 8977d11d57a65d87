//===- RuntimeCalls.h - Calls into the runtime ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The compiled side of tai/Runtime/Abi.h: reading the frame, slots, constant
// strings and arrays, and calls by name.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TAITOHOST_RUNTIMECALLS_H
#define TAI_LIB_CONVERSION_TAITOHOST_RUNTIMECALLS_H

#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/IR/Builders.h"
#include "mlir/IR/BuiltinOps.h"
#include "tai/ABI/Abi.h"

namespace mlir::tai {

class RuntimeCalls {
public:
  /// `table` is the module, or the part of it that is compiled for a device:
  /// what is called is declared there.
  explicit RuntimeCalls(Operation *table);

  /// Calls a function of the runtime; a null `result` stands for void. Pure
  /// functions neither read nor write memory that the kernel sees.
  Value call(OpBuilder &builder, Location loc, StringRef name, Type result,
             ValueRange arguments, bool pure = false);

  /// The address of a constant: a zero-terminated string, or an array.
  Value string(OpBuilder &builder, Location loc, StringRef text);
  Value array(OpBuilder &builder, Location loc, ArrayRef<int32_t> numbers);

  /// Member of the frame at `offset` bytes.
  Value frameMember(OpBuilder &builder, Location loc, Value frame,
                    size_t offset, Type type);

  Value null(OpBuilder &builder, Location loc);
  Value i32(OpBuilder &builder, Location loc, int64_t value);
  Value i64(OpBuilder &builder, Location loc, int64_t value);

  LLVM::LLVMPointerType getPointerType() { return pointerType; }

private:
  Value global(OpBuilder &builder, Location loc, Type type, Attribute value,
               StringRef prefix);

  Operation *table;
  LLVM::LLVMPointerType pointerType;
  llvm::StringMap<LLVM::LLVMFuncOp> functions;
  llvm::DenseMap<Attribute, LLVM::GlobalOp> globals;
};

/// Room for `count` slots of eight bytes in the frame of the function that
/// encloses the insertion point: allocated once on entry, so that a loop does
/// not grow the stack.
Value emitStackSlots(OpBuilder &builder, Location loc, int64_t count);

/// The address of slot `index`.
Value emitSlot(OpBuilder &builder, Location loc, Value slots, int64_t index);

/// Stores a scalar at the start of a slot in its own type, or loads it.
void emitSlotStore(OpBuilder &builder, Location loc, Value value, Value slot);
Value emitSlotLoad(OpBuilder &builder, Location loc, Type type, Value slot);

/// The number of slots that a value takes (see TaiFrame).
int64_t getNumSlots(Type type);

/// The values of a message, in slots, with their kinds and shapes.
struct MessageValues {
  Value count, kinds, shapes, slots;
};
/// `shapes` is the number of components of each value, which stand one after
/// another in `values`; empty if all are scalars.
MessageValues emitMessageValues(RuntimeCalls &runtime, OpBuilder &builder,
                                Location loc, ValueRange values,
                                ArrayRef<int32_t> shapes);

/// Reports a failure of the launch.
void emitFail(RuntimeCalls &runtime, OpBuilder &builder, Location loc,
              Value frame, int32_t failure, StringRef message,
              ValueRange values, ArrayRef<int32_t> shapes);

/// "file:line:column" of the innermost source location, or "".
std::string describeLocation(Location loc);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOHOST_RUNTIMECALLS_H
