//===- DeviceHeap.h - The heap of device code -------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Threads of a device allocate memory while they run, for the history of loops
// in gradients. The size of the heap is fixed when a device is opened; with
// CUDA it can be set once in a process.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_DEVICE_DEVICEHEAP_H
#define TAI_RUNTIME_DEVICE_DEVICEHEAP_H

#include <cstdint>

namespace mlir::tai::runtime {

/// Sets the heap size of devices opened later; 0 for each device's default.
void setDeviceHeapBytes(int64_t bytes);
int64_t deviceHeapBytes();

} // namespace mlir::tai::runtime

extern "C" {
/// Allocate and free memory of the emulated device's heap.
void *tai_emu_allocate(uint64_t bytes);
void tai_emu_free(void *memory);
}

#endif // TAI_RUNTIME_DEVICE_DEVICEHEAP_H
