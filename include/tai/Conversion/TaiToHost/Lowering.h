//===- Lowering.h - The parts of convert-tai-to-scf -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CONVERSION_TAITOHOST_LOWERING_H
#define TAI_CONVERSION_TAITOHOST_LOWERING_H

#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "tai/Conversion/TaiToHost/RuntimeCalls.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Utils/FieldAddress.h"
#include "llvm/ADT/MapVector.h"
#include "llvm/ADT/SetVector.h"

namespace mlir::tai {

/// State shared by the lowerings of one module for the host.
struct ModuleLowering {
  /// `table`: the symbol table for declarations of runtime functions, by
  /// default the module itself.
  ModuleLowering(ModuleOp module, bool debug, Operation *table = nullptr);

  ModuleOp module;
  RuntimeCalls runtime;
  FieldTable fields;
  bool debug;
  /// The position of each tree in the list of trees of the frame,
  /// TaiFrame::trees.
  llvm::DenseMap<StringAttr, int64_t> treeIndex;
  /// The functions that are lowered, including helpers that could not be
  /// inlined, which are rejected. Other functions of the module are not
  /// changed.
  llvm::SetVector<Operation *> functions;
};

/// Outlines code into a function with a closure: captured values are stored to
/// slots at the call, and loaded on entry. Constants are copied instead.
class Closure {
public:
  /// `call`: the op of the outer function before which the closure is built.
  /// `frame`: the frame in the outer function. `inner`: the function whose
  /// first two arguments are the frame and the closure.
  Closure(LLVM::LLVMFuncOp inner, Value frame, Operation *call);

  /// Returns the value in the inner function for a value in the outer function.
  FailureOr<Value> get(Value outer);

  /// Replaces the values that `region`, which was moved into the inner
  /// function, captures.
  LogicalResult capture(Region &region);

  /// Emits stores of the captured values to the closure, and returns the
  /// address of the closure.
  Value emit(RuntimeCalls &runtime);

private:
  LLVM::LLVMFuncOp inner;
  Operation *call;
  OpBuilder entry;
  llvm::MapVector<Value, Value> captured;
  llvm::DenseMap<Value, Value> known;
};

/// Creates a function of the module with an entry block; `frame` is the first
/// argument.
LLVM::LLVMFuncOp createFunction(ModuleOp module, Location loc, StringRef name,
                                Type result, ArrayRef<Type> arguments,
                                bool isInternal);

/// A callback that computes the address of an array argument from the address
/// and the extents in its slots.
using ArrayAddress =
    llvm::function_ref<Value(OpBuilder &builder, BlockArgument array,
                             Value address, ValueRange extents)>;

/// Replaces the values used in the region for which `isOutside` holds by the
/// results of `get`.
LogicalResult replaceOutside(Region &region,
                             function_ref<bool(Value)> isOutside,
                             function_ref<FailureOr<Value>(Value)> get);

/// Replaces the arguments of `function` by loads from the slots of the frame;
/// arrays are replaced at each use.
LogicalResult replaceArguments(FunctionOpInterface function, Value frame,
                               OpBuilder &builder, RuntimeCalls &runtime,
                               ArrayAddress arrayAddress = nullptr);

/// Replaces the terminator `ret` by stores of its operands to the slots of the
/// frame; `builder` is left at the point behind the stores.
void replaceReturn(Operation *ret, Location loc, Value frame,
                   OpBuilder &builder, RuntimeCalls &runtime);

/// Each of these functions lowers one op, or all ops of a kind in a function.
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
/// Replaces a parallel loop by nested serial loops in place; its updates become
/// non-atomic.
LogicalResult lowerSerially(ParallelForOp loop, FieldTable &fields);
/// Lowers the preconditions of a kernel that has been lowered: it returns
/// early, before any effect, where one does not hold.
void lowerPreconditions(LLVM::LLVMFuncOp function, ModuleLowering &lowering);
LogicalResult lowerStack(StackCreateOp op, Value frame, RuntimeCalls &runtime);

/// Numbers the random draws below `root`: each gets its iteration in `loop`
/// (null for the serial code of a kernel), and a counter if it may draw more
/// than once in an iteration.
void numberDraws(Operation *root, ParallelForOp loop);
/// True if the cast is the placeholder of a random draw that has got its
/// number.
bool isDraw(UnrealizedConversionCastOp op);
/// Emits the random number of a draw: an integer of random bits, or a float in
/// [0, 1).
Value emitDraw(UnrealizedConversionCastOp op, Value frame, OpBuilder &builder,
               RuntimeCalls &runtime);

} // namespace mlir::tai

#endif // TAI_CONVERSION_TAITOHOST_LOWERING_H
