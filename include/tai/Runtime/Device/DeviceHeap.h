//===- DeviceHeap.h - Memory that device code asks for ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Threads of a device allocate memory while they run: what a gradient records.
// How much there is is decided when a device is opened; CUDA lets a process say
// it once.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_DEVICE_DEVICEHEAP_H
#define TAI_RUNTIME_DEVICE_DEVICEHEAP_H

#include <cstdint>

namespace mlir::tai::runtime {

/// For devices that are opened from now on; 0 for what suits each.
void setDeviceHeapBytes(int64_t bytes);
int64_t deviceHeapBytes();

} // namespace mlir::tai::runtime

extern "C" {
/// The heap of the emulated device.
void *tai_emu_allocate(uint64_t bytes);
void tai_emu_free(void *memory);
}

#endif // TAI_RUNTIME_DEVICE_DEVICEHEAP_H
