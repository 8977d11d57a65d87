//===- Offload.h - Splitting host and device code ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The parts of convert-tai-to-gpu; see docs/decisions/0010-cuda.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CONVERSION_TAITOGPU_OFFLOAD_H
#define TAI_CONVERSION_TAITOGPU_OFFLOAD_H

#include "mlir/Dialect/GPU/IR/GPUDialect.h"
#include "tai/ABI/LocalMemory.h"
#include "tai/Conversion/TaiToHost/Lowering.h"

namespace mlir::tai {

/// State shared by the lowerings of one module for a device.
struct DeviceLowering {
  DeviceLowering(ModuleLowering &host, ModuleLowering &device,
                 gpu::GPUModuleOp kernels)
      : host(host), device(device), kernels(kernels) {}

  /// host: the lowering of host code. device: the lowering of the device
  /// functions in `kernels`.
  ModuleLowering &host, &device;
  gpu::GPUModuleOp kernels;
  /// The loops of the kernel for which mayBeCountless() holds.
  llvm::SmallPtrSet<Operation *, 4> countless;
};

/// Attribute of an unrealized_conversion_cast from an address to a value that
/// is in device memory at that address. A second operand of the cast is a
/// prediction of the value.
constexpr llvm::StringLiteral kDeviceSlotAttrName = "tai.device_slot";

/// Attribute of an unrealized_conversion_cast in a loop whose result is the
/// target address of a sum of the loop: the number of this sum.
constexpr llvm::StringLiteral kSumTargetAttrName = "tai.sum_target";

/// Attribute of a host op that produces an address: the alignment of the
/// address in bytes.
constexpr llvm::StringLiteral kAlignmentAttrName = "tai.alignment";

/// The alignment, in bytes, that trees have on every device; enough for the
/// widest memory access.
constexpr int64_t kTreeAlignment = 16;

/// Attribute that `tai-narrow-indices` sets on a module, and that its
/// gpu.module gets later: the width of an index in bits; 64 if absent.
constexpr llvm::StringLiteral kIndexBitsAttrName = "tai.index_bits";

/// True for a parallel loop that becomes a device function.
bool isDeviceLoop(Operation *op);

/// Wraps code after `start` that must run on the device and is not in a
/// parallel loop into loops of one iteration. Values that later code uses go
/// through device memory.
LogicalResult offloadSerialCode(LLVM::LLVMFuncOp host, Operation *start,
                                Value frame, DeviceLowering &lowering);

/// Loads the lengths of lists of active cells on the device, from the word in
/// front of each list, instead of on the host.
void readLengthsOnDevice(LLVM::LLVMFuncOp host);

/// Copies to the host the values in device memory that host code still uses.
void fetchHostValues(LLVM::LLVMFuncOp host, Value frame,
                     DeviceLowering &lowering);

/// Replaces each loop with additions in fixed point, which have private
/// buffers, by three loops that find their scales, add them up, and round the
/// sums.
LogicalResult splitFixedPointLoops(LLVM::LLVMFuncOp host, Value frame,
                                   DeviceLowering &lowering);

/// Replaces additions that have private buffers by additions to sums of f64,
/// and inserts after their loop a loop that adds the sums to the field.
LogicalResult splitWideScatters(LLVM::LLVMFuncOp host, Value frame,
                                DeviceLowering &lowering);

/// Finds the sums that the iterations of a loop can keep in registers, and
/// computes their target addresses before the loop.
LogicalResult prepareSums(ParallelForOp loop, Value frame,
                          DeviceLowering &lowering);

/// Moves a loop to a function of its own and launches the function instead.
LogicalResult outlineLoop(ParallelForOp loop, Value frame, StringRef name,
                          DeviceLowering &lowering);

/// Fails if GPUs do not support the block size that the loop specifies.
LogicalResult checkBlockSize(ParallelForOp loop);

/// Sets the block size on the function of a loop, if the loop specifies one,
/// and marks functions of loops with few iterations.
void noteSizes(ParallelForOp loop, LLVM::LLVMFuncOp function);

/// Limits registers so that a block of the function's size fits, if it has one.
void limitRegisters(LLVM::LLVMFuncOp function);

/// True if the loop may have so many iterations that a device would run them
/// for hours.
bool mayBeCountless(ParallelForOp loop);

/// Inserts safepoints into loops that may run long inside the iterations of a
/// device function, whose first argument is the device state; and, if
/// `areCountless`, into the loop over the iterations of a thread.
void pollLongLoops(LLVM::LLVMFuncOp function, scf::ForOp iterations,
                   bool runsAlone, bool areCountless, RuntimeCalls &runtime);

/// Makes a device function, whose first argument is the device state, report
/// failed allocations.
void guardAllocations(LLVM::LLVMFuncOp function, RuntimeCalls &runtime);

/// Marks the address of memory that an earlier function of the kernel
/// allocated: a thread exits if that allocation failed.
Value markHandedOn(OpBuilder &builder, Location loc, Value address,
                   RuntimeCalls &runtime);

} // namespace mlir::tai

#endif // TAI_CONVERSION_TAITOGPU_OFFLOAD_H
