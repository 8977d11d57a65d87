//===- Lowering.h - The parts of convert-tai-to-scf -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TAITOHOST_LOWERING_H
#define TAI_LIB_CONVERSION_TAITOHOST_LOWERING_H

#include "RuntimeCalls.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Utils/FieldAddress.h"
#include "llvm/ADT/MapVector.h"

namespace mlir::tai {

/// What the parts share while one module is lowered.
struct ModuleLowering {
  /// `table`: where functions of the runtime are declared, by default the
  /// module itself.
  ModuleLowering(ModuleOp module, bool deterministic, bool debug,
                 Operation *table = nullptr);

  ModuleOp module;
  RuntimeCalls runtime;
  FieldTable fields;
  bool deterministic, debug;
  /// Of the kernel that is being lowered: sums have the order of all targets.
  bool oneOrder = false;
  /// Position of each tree in TaiFrame::trees.
  llvm::DenseMap<StringAttr, int64_t> treeIndex;
};

/// Moves code out of a function into one that gets a closure: what the code
/// uses from outside is stored to slots at the call, and loaded on entry.
/// Constants are copied instead.
class Closure {
public:
  /// `frame` is the frame in the function around `call`, the point before
  /// which the closure is built; `inner` has the frame and the closure as its
  /// first two arguments.
  Closure(LLVM::LLVMFuncOp inner, Value frame, Operation *call);

  /// The value inside for a value outside.
  FailureOr<Value> get(Value outer);

  /// Replaces what the ops of `region`, which was moved into the inner
  /// function, use from outside.
  LogicalResult capture(Region &region);

  /// Stores the captured values and yields the address of the closure.
  Value emit(RuntimeCalls &runtime);

private:
  LLVM::LLVMFuncOp inner;
  Operation *call;
  OpBuilder entry;
  llvm::MapVector<Value, Value> captured;
  llvm::DenseMap<Value, Value> known;
};

/// A function of the module with an entry block; `frame` is its first argument.
LLVM::LLVMFuncOp createFunction(ModuleOp module, Location loc, StringRef name,
                                Type result, ArrayRef<Type> arguments,
                                bool isInternal);

/// Yields the address to use for an array of the caller, from that in the slots
/// and the extents.
using ArrayAddress =
    llvm::function_ref<Value(OpBuilder &builder, BlockArgument array,
                             Value address, ValueRange extents)>;

/// Replaces the operands of ops in the region that are outside by what `get`
/// makes of them.
LogicalResult replaceOutside(Region &region,
                             function_ref<bool(Value)> isOutside,
                             function_ref<FailureOr<Value>(Value)> get);

/// Loads arguments from the slots of the frame in place of the arguments of
/// `function`, which are replaced; arrays are replaced use by use.
LogicalResult replaceArguments(FunctionOpInterface function, Value frame,
                               OpBuilder &builder, RuntimeCalls &runtime,
                               ArrayAddress arrayAddress = nullptr);

/// Stores returned values to the slots of the frame, in the place of what ends
/// the function, at which `builder` stands afterwards.
void replaceReturn(Operation *ret, Location loc, Value frame,
                   OpBuilder &builder, RuntimeCalls &runtime);

/// Each lowers one op, or all ops of a kind in a function.
LogicalResult lowerKernel(KernelOp kernel, ModuleLowering &lowering);
LogicalResult lowerHostFunction(func::FuncOp function,
                                ModuleLowering &lowering);
/// Lowers the host functions of a module whose kernels have been lowered, and
/// removes its trees and fields.
LogicalResult finishModule(ModuleLowering &lowering);
LogicalResult lowerParallelFor(ParallelForOp loop, Value frame, StringRef name,
                               ModuleLowering &lowering,
                               SmallVectorImpl<LLVM::LLVMFuncOp> &functions);
LogicalResult lowerLeafOps(LLVM::LLVMFuncOp function, ModuleLowering &lowering);
/// Replaces a parallel loop by serial ones where it stands; its updates become
/// plain.
LogicalResult lowerSerially(ParallelForOp loop, FieldTable &fields);
/// Lowers the preconditions of a kernel that is done otherwise: it returns
/// before anything runs where one does not hold.
void lowerPreconditions(LLVM::LLVMFuncOp function, ModuleLowering &lowering);
LogicalResult lowerStack(StackCreateOp op, Value frame, RuntimeCalls &runtime);

/// Gives each tai.random below `loop` its iteration number, and a count to
/// those that may draw more than once in one; `loop` may be null, for the
/// serial code of a kernel.
void numberDraws(Operation *root, ParallelForOp loop);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOHOST_LOWERING_H
