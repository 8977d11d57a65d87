//===- DeviceHeap.cpp - The heap of device code ---------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Device/DeviceHeap.h"
#include <atomic>
#include <cstdlib>
#include <cstring>

static std::atomic<int64_t> heapBytes{0};
/// The bytes in use on the emulated device, by all threads together.
static std::atomic<int64_t> used{0};

void mlir::tai::runtime::setDeviceHeapBytes(int64_t bytes) {
  heapBytes.store(bytes, std::memory_order_relaxed);
}

int64_t mlir::tai::runtime::deviceHeapBytes() {
  return heapBytes.load(std::memory_order_relaxed);
}

/// The size of an allocation is stored in front of its memory.
static constexpr int64_t headerBytes = 16;

extern "C" void *tai_emu_allocate(uint64_t bytes) {
  constexpr int64_t usual = int64_t(4) << 30;
  int64_t limit = mlir::tai::runtime::deviceHeapBytes();
  auto size = static_cast<int64_t>(bytes);
  // This allocator returns null for zero bytes, like the allocator of the CUDA
  // driver.
  if (size <= 0 || used.fetch_add(size) + size > (limit ? limit : usual)) {
    if (size > 0)
      used.fetch_sub(size);
    return nullptr;
  }
  auto *memory =
      static_cast<char *>(std::malloc(static_cast<size_t>(size + headerBytes)));
  if (!memory) {
    used.fetch_sub(size);
    return nullptr;
  }
  std::memcpy(memory, &size, sizeof(size));
  std::memset(memory + headerBytes, 0xa5, static_cast<size_t>(size));
  return memory + headerBytes;
}

extern "C" void tai_emu_free(void *memory) {
  if (!memory)
    return;
  char *start = static_cast<char *>(memory) - headerBytes;
  int64_t size;
  std::memcpy(&size, start, sizeof(size));
  used.fetch_sub(size);
  std::free(start);
}
