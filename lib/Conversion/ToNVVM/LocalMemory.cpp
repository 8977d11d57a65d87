//===- LocalMemory.cpp - Heap memory of device threads --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The history of a loop in a gradient is in memory that each thread allocates.
// The heap of a device is small, and thousands of threads allocate at the same
// time: a failure is reported with kernel, line and size, and the thread exits
// before it writes to memory. The exit is inserted in LLVM IR (see
// lib/CodeGen/Passes/LocalMemory.cpp), where a branch to the end of the
// function is possible.
//
//===----------------------------------------------------------------------===//

#include "../TaiToGPU/Offload.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"

using namespace mlir;
using namespace mlir::tai;

/// The kernel that a device function belongs to: its name without the number.
static StringRef getKernelName(StringRef function) {
  return function.take_front(function.rfind('_'));
}

void tai::guardAllocations(LLVM::LLVMFuncOp function, RuntimeCalls &runtime) {
  Value state = function.getArgument(0);
  std::string text =
      ("out of memory on the device: an iteration of kernel '" +
       getKernelName(function.getName()) +
       "' records {} of values, and its heap, which all threads share, has no "
       "room left; give it more: ti.init(device_heap_memory=...)")
          .str();
  SmallVector<LLVM::CallOp> calls;
  function.walk([&](LLVM::CallOp call) { calls.push_back(call); });
  for (LLVM::CallOp call : calls) {
    std::optional<StringRef> name = call.getCallee();
    if (!name)
      continue;
    OpBuilder builder(call);
    Location loc = call.getLoc();
    auto describe = [&] {
      return SmallVector<Value>{
          runtime.string(builder, loc, text),
          runtime.string(builder, loc, describePlace(loc))};
    };
    if (*name == "malloc") {
      SmallVector<Value> arguments{state, call.getArgOperands().front()};
      arguments.append(describe());
      Value memory = runtime.call(builder, loc, kLocalAllocate,
                                  runtime.getPointerType(), arguments);
      call.getResult().replaceAllUsesWith(memory);
    } else if (*name == "free") {
      runtime.call(builder, loc, kLocalFree, Type(), call.getArgOperands());
    } else if (*name == "tai_rt_stack_grow") {
      SmallVector<Value> arguments(call.getArgOperands());
      arguments.append(describe());
      runtime.call(builder, loc, "tai_rt_stack_grow_at", Type(), arguments);
    } else {
      continue;
    }
    call.erase();
  }
}

Value tai::markHandedOn(OpBuilder &builder, Location loc, Value address,
                        RuntimeCalls &runtime) {
  return runtime.call(builder, loc, kLocalGiven, runtime.getPointerType(),
                      {address});
}
