//===- Offload.h - What of a kernel runs where ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The parts of convert-tai-to-gpu; see docs/decisions/0010-cuda.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TAITOGPU_OFFLOAD_H
#define TAI_LIB_CONVERSION_TAITOGPU_OFFLOAD_H

#include "../TaiToHost/Lowering.h"
#include "mlir/Dialect/GPU/IR/GPUDialect.h"
#include "tai/ABI/LocalMemory.h"

namespace mlir::tai {

/// What the parts share while one module is lowered.
struct DeviceLowering {
  /// Of the host's part, and of the functions in `kernels`.
  ModuleLowering &host, &device;
  gpu::GPUModuleOp kernels;
  bool deterministic;
};

/// On an unrealized_conversion_cast from an address to a value: the value is in
/// device memory at that address. A second operand is a guess of it.
constexpr llvm::StringLiteral kDeviceSlotAttrName = "tai.device_slot";

/// On an unrealized_conversion_cast in a loop: the address to which its sum of
/// this number goes.
constexpr llvm::StringLiteral kSumTargetAttrName = "tai.sum_target";

/// On an op of the host's part that makes an address: how it is aligned.
constexpr llvm::StringLiteral kAlignmentAttrName = "tai.alignment";

/// What every device gives a tree, as much as its widest access needs.
constexpr int64_t kTreeAlignment = 16;

/// On that, in deterministic mode: each thread stores a sum of its own, from
/// that address on.
constexpr llvm::StringLiteral kPartialSumAttrName = "tai.partial_sum";

/// On a module, by `tai-narrow-indices`, and then on its gpu.module: how many
/// bits an index needs; 64 where it is not there.
constexpr llvm::StringLiteral kIndexBitsAttrName = "tai.index_bits";

/// True for a loop that becomes a device function.
bool isDeviceLoop(Operation *op);

/// Wraps what must run on the device and is in no parallel loop, after `start`,
/// into loops of one iteration. Values that later code uses go through device
/// memory.
LogicalResult offloadSerialCode(LLVM::LLVMFuncOp host, Operation *start,
                                Value frame, DeviceLowering &lowering);

/// The lengths of lists of active cells stand in device memory, in front of the
/// lists.
void readLengthsOnDevice(LLVM::LLVMFuncOp host);

/// Fetches the values in device memory that the host's part still uses.
void fetchHostValues(LLVM::LLVMFuncOp host, Value frame,
                     DeviceLowering &lowering);

/// Finds the sums that the iterations of a loop keep in registers, and computes
/// before the loop where they go.
LogicalResult prepareSums(ParallelForOp loop, Value frame,
                          DeviceLowering &lowering);

/// Moves a loop to a function of its own and launches that in its place.
LogicalResult outlineLoop(ParallelForOp loop, Value frame, StringRef name,
                          DeviceLowering &lowering);

/// Fails where a GPU has no blocks of the size that the loop asks for.
LogicalResult checkBlockSize(ParallelForOp loop);

/// Says on the function of a loop how many threads its blocks have, if the loop
/// does.
void noteBlockSize(ParallelForOp loop, LLVM::LLVMFuncOp function);

/// Leaves so many threads room, if the function says how many there are.
void limitRegisters(LLVM::LLVMFuncOp function);

/// Makes loops that may be long inside the iterations of a device function,
/// whose first argument is the state of the device, ask whether they go on.
void pollLongLoops(LLVM::LLVMFuncOp function, scf::ForOp iterations,
                   bool runsAlone, RuntimeCalls &runtime);

/// Makes a device function, whose first argument is the state of the device,
/// say where it finds no memory.
void guardAllocations(LLVM::LLVMFuncOp function, RuntimeCalls &runtime);

/// The address of memory that an earlier function of the kernel has allocated,
/// for one that ends where there is none.
Value markHandedOn(OpBuilder &builder, Location loc, Value address,
                   RuntimeCalls &runtime);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOGPU_OFFLOAD_H
