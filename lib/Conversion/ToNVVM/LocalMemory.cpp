//===- LocalMemory.cpp - Heap memory of device threads --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The history of a loop in a gradient is in memory that each thread allocates.
// A short one is in the thread's local memory, which takes no time to allocate
// and whose accesses by the threads of a warp are coalesced. A longer one is on
// the heap of the device, which is small and of which thousands of threads
// allocate at the same time: a failure is reported with kernel, line and size,
// and the thread exits before it writes to memory. The exit is inserted in LLVM
// IR (see lib/CodeGen/Passes/FailedAllocations.cpp), where a branch to the end
// of the function is possible.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/IR/Matchers.h"
#include "tai/Conversion/TaiToGPU/Offload.h"

using namespace mlir;
using namespace mlir::tai;

/// Returns the name of the kernel that a device function belongs to: the
/// function's name without the number.
static StringRef getKernelName(StringRef function) {
  return function.take_front(function.rfind('_'));
}

namespace {
/// The local memory of the threads of a function. The driver reserves it for
/// all threads that a device can run at the same time, some 270,000, which
/// bounds its size.
class ThreadMemory {
public:
  explicit ThreadMemory(LLVM::LLVMFuncOp function) : function(function) {}

  /// Reserves `bytes` bytes of the thread's local memory and returns their
  /// address; null if the function would need too many.
  Value reserve(int64_t bytes) {
    if (bytes > free)
      return {};
    free -= llvm::alignTo(bytes, kAlignment);
    OpBuilder builder =
        OpBuilder::atBlockBegin(&function.getFunctionBody().front());
    Location loc = function.getLoc();
    Value size =
        LLVM::ConstantOp::create(builder, loc, builder.getI64Type(), bytes);
    return LLVM::AllocaOp::create(
        builder, loc, LLVM::LLVMPointerType::get(builder.getContext()),
        builder.getI8Type(), size, kAlignment);
  }

  /// The number of bytes reserved for an array whose size is known at run time.
  static constexpr int64_t kRunTimeBytes = 1024;

private:
  static constexpr int64_t kAlignment = 16;

  LLVM::LLVMFuncOp function;
  int64_t free = 4096;
};
} // namespace

static bool isFree(Operation *op) {
  auto call = dyn_cast<LLVM::CallOp>(op);
  return call && call.getCallee() == "free";
}

/// True if memory is only read, written and freed, the latter in the iteration
/// that allocates it, so that its address does not escape.
static bool isPrivate(Value address, Block *block, bool &isFreed) {
  return llvm::all_of(address.getUsers(), [&](Operation *user) {
    if (isFree(user)) {
      isFreed = true;
      return user->getBlock() == block;
    }
    if (auto element = dyn_cast<LLVM::GEPOp>(user))
      return isPrivate(element, block, isFreed);
    if (auto store = dyn_cast<LLVM::StoreOp>(user))
      return store.getValue() != address;
    return isa<LLVM::LoadOp>(user);
  });
}

/// Puts short arrays into the thread's local memory; `call` allocates longer
/// arrays.
static void keepInThread(LLVM::CallOp call, ThreadMemory &own) {
  bool isFreed = false;
  if (!isPrivate(call.getResult(), call->getBlock(), isFreed) || !isFreed)
    return;
  Value bytes = call.getArgOperands().front();
  APInt known;
  bool isKnown = matchPattern(bytes, m_ConstantInt(&known));
  Value memory =
      own.reserve(isKnown ? known.getSExtValue() : ThreadMemory::kRunTimeBytes);
  if (!memory)
    return;
  if (isKnown) {
    for (Operation *user : llvm::make_early_inc_range(call->getUsers()))
      if (isFree(user))
        user->erase();
    call.getResult().replaceAllUsesWith(memory);
    call.erase();
    return;
  }
  // A short array is in local memory instead, so the heap allocation becomes
  // one of zero bytes, which does nothing.
  OpBuilder builder(call);
  Location loc = call.getLoc();
  auto constant = [&](int64_t value) -> Value {
    return LLVM::ConstantOp::create(builder, loc, bytes.getType(), value);
  };
  Value isShort =
      LLVM::ICmpOp::create(builder, loc, LLVM::ICmpPredicate::ule, bytes,
                           constant(ThreadMemory::kRunTimeBytes));
  Value onHeap =
      LLVM::SelectOp::create(builder, loc, isShort, constant(0), bytes);
  call.setOperand(0, onHeap);
  builder.setInsertionPointAfter(call);
  auto chosen =
      LLVM::SelectOp::create(builder, loc, isShort, memory, call.getResult());
  call.getResult().replaceUsesWithIf(chosen, [&](OpOperand &use) {
    return use.getOwner() != chosen && !isFree(use.getOwner());
  });
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
  ThreadMemory own(function);
  function.walk([&](LLVM::CallOp call) {
    if (call.getCallee() == "malloc")
      calls.push_back(call);
  });
  for (LLVM::CallOp call : calls)
    keepInThread(call, own);
  calls.clear();
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
