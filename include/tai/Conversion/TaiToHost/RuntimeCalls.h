//===- RuntimeCalls.h - Calls into the runtime ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The compiler's side of tai/ABI/Abi.h: emits reads of the frame, slots,
// constant strings and arrays, and calls of runtime functions.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CONVERSION_TAITOHOST_RUNTIMECALLS_H
#define TAI_CONVERSION_TAITOHOST_RUNTIMECALLS_H

#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/IR/Builders.h"
#include "mlir/IR/BuiltinOps.h"
#include "tai/ABI/Abi.h"
#include "tai/Support/Places.h"

namespace mlir::tai {

/// Gives the MLIR types of a C function in Abi.def.
template <typename Function> struct EntryTypes;
template <typename Result, typename... Parameters>
struct EntryTypes<Result(Parameters...)> {
  static constexpr size_t numParameters = sizeof...(Parameters);
  static Type getResult(MLIRContext *context) { return get<Result>(context); }
  static SmallVector<Type> getParameters(MLIRContext *context) {
    return {get<Parameters>(context)...};
  }

private:
  /// Null for void.
  template <typename T> static Type get(MLIRContext *context) {
    if constexpr (std::is_void_v<T>)
      return Type();
    else if constexpr (std::is_pointer_v<T>)
      return LLVM::LLVMPointerType::get(context);
    else if constexpr (std::is_same_v<T, double>)
      return Float64Type::get(context);
    else
      return IntegerType::get(context, 8 * sizeof(T));
  }
};

class RuntimeCalls {
public:
  /// `table` is the module, or the gpu.module in it, in which called functions
  /// are declared.
  explicit RuntimeCalls(Operation *table);

  /// A method for each row of Abi.def, which emits a call of the function of
  /// the same name, with a value for each parameter. Returns null if the
  /// function returns void.
#define TAI_ENTRY(result, name, parameters)                                    \
  template <typename... Arguments>                                             \
  Value tai_rt_##name(OpBuilder &builder, Location loc,                        \
                      Arguments... arguments) {                                \
    return callEntry<decltype(::tai_rt_##name)>(builder, loc, "tai_rt_" #name, \
                                                {Value(arguments)...});        \
  }
#include "tai/ABI/Abi.def"

  /// Calls a function that is not in Abi.def, such as one of the device
  /// library; a null `result` stands for void. `pure` functions neither read
  /// nor write memory that the kernel accesses.
  Value call(OpBuilder &builder, Location loc, StringRef name, Type result,
             ValueRange arguments, bool pure = false);

  /// Emits the address of a constant: a zero-terminated string, or an array.
  Value string(OpBuilder &builder, Location loc, StringRef text);
  Value array(OpBuilder &builder, Location loc, ArrayRef<int32_t> numbers);

  /// Emits a load of the member of the frame that is `offset` bytes from its
  /// start.
  Value frameMember(OpBuilder &builder, Location loc, Value frame,
                    size_t offset, Type type);

  Value null(OpBuilder &builder, Location loc);
  Value i32(OpBuilder &builder, Location loc, int64_t value);
  Value i64(OpBuilder &builder, Location loc, int64_t value);

  LLVM::LLVMPointerType getPointerType() { return pointerType; }

private:
  template <typename Function, size_t count>
  Value callEntry(OpBuilder &builder, Location loc, StringRef name,
                  const Value (&arguments)[count]) {
    using Types = EntryTypes<Function>;
    static_assert(count == Types::numParameters,
                  "a value for each parameter of the function");
    MLIRContext *context = builder.getContext();
    assert(TypeRange(ValueRange(arguments)) ==
               TypeRange(Types::getParameters(context)) &&
           "values are of the types of the function");
    return call(builder, loc, name, Types::getResult(context),
                ValueRange(arguments));
  }
  Value global(OpBuilder &builder, Location loc, Type type, Attribute value,
               StringRef prefix);

  Operation *table;
  LLVM::LLVMPointerType pointerType;
  llvm::StringMap<LLVM::LLVMFuncOp> functions;
  llvm::DenseMap<Attribute, LLVM::GlobalOp> globals;
};

/// Allocates `count` slots of eight bytes in the stack frame of the function
/// around the insertion point, at its entry, so that a loop does not grow the
/// stack.
Value emitStackSlots(OpBuilder &builder, Location loc, int64_t count);

/// Emits the address of slot number `index` of the array `slots`.
Value emitSlot(OpBuilder &builder, Location loc, Value slots, int64_t index);

/// Stores a scalar at the start of a slot in its own type, or loads a scalar.
void emitSlotStore(OpBuilder &builder, Location loc, Value value, Value slot);
Value emitSlotLoad(OpBuilder &builder, Location loc, Type type, Value slot);

/// Returns the number of argument slots that a value of this type occupies (see
/// TaiFrame).
int64_t getNumSlots(Type type);

/// The values that a message of the runtime shows: their slots, kinds and
/// shapes.
struct MessageValues {
  Value count, kinds, shapes, slots;
};
/// `shapes` is the number of components of each value, which are consecutive in
/// `values`; empty if all are scalars.
MessageValues emitMessageValues(RuntimeCalls &runtime, OpBuilder &builder,
                                Location loc, ValueRange values,
                                ArrayRef<int32_t> shapes);

/// Emits a report of a failure of the launch.
void emitFail(RuntimeCalls &runtime, OpBuilder &builder, Location loc,
              Value frame, int32_t failure, StringRef message,
              ValueRange values, ArrayRef<int32_t> shapes);

} // namespace mlir::tai

#endif // TAI_CONVERSION_TAITOHOST_RUNTIMECALLS_H
