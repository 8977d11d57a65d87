//===- DLPack.h - The binary interface of DLPack ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Tensors in capsules "dltensor" and "dltensor_versioned", and the table of C
// functions by which a tensor type exports them without capsules.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_PYTHON_DLPACK_H
#define TAI_PYTHON_DLPACK_H

#include <cstdint>

namespace taipy::dlpack {

struct Tensor {
  void *data;
  int32_t deviceType, deviceNumber;
  int32_t rank;
  uint8_t code, bits;
  uint16_t lanes;
  int64_t *shape, *strides;
  uint64_t byteOffset;
};
static_assert(sizeof(Tensor) == 48, "the layout is that of DLPack");

enum DeviceType : int32_t { kCpu = 1, kCuda = 2 };

struct Managed {
  Tensor tensor;
  void *owner;
  void (*deleter)(Managed *);
};

struct ManagedVersioned {
  uint32_t major, minor;
  void *owner;
  void (*deleter)(ManagedVersioned *);
  uint64_t flags;
  Tensor tensor;
};

constexpr uint64_t kReadOnly = 1;

/// The attribute `__dlpack_c_exchange_api__` of a type is a capsule of this
/// name that holds the table.
constexpr const char *kTableName = "dlpack_exchange_api";

struct ExchangeTable {
  uint32_t major, minor;
  void *older;
  void *allocate;
  void *exportManaged;
  void *importManaged;
  /// A borrowed view of the tensor, valid until the tensor is changed; -1 and a
  /// Python error on failure. May be null.
  int (*view)(void *object, Tensor *tensor);
  /// The function that gives the current stream of the tensor's library.
  int (*currentStream)(int32_t deviceType, int32_t deviceNumber, void **stream);
};

} // namespace taipy::dlpack

#endif // TAI_PYTHON_DLPACK_H
