//===- ExportedBuffer.h - Field memory that others use ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A library that has the address of a field writes to it without a word. On a
// device, what the host holds of the tree is therefore never current while the
// tree is exported, unless the host is the last that wrote.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_HOST_EXPORTEDBUFFER_H
#define TAI_RUNTIME_HOST_EXPORTEDBUFFER_H

#include "tai/Runtime/Mirror/DeviceHost.h"

namespace mlir::tai::runtime {

struct ExportedField;

/// Memory of a field in the hands of others, which stays as long as this, also
/// when the field is gone.
class ExportedBuffer {
public:
  explicit ExportedBuffer(const TreePtr &tree);
  ~ExportedBuffer();
  ExportedBuffer(const ExportedBuffer &) = delete;
  ExportedBuffer &operator=(const ExportedBuffer &) = delete;
  /// Whether there are any, of whatever runtime.
  static bool areAny() { return count.load(std::memory_order_relaxed) > 0; }
  /// Gives out the address of a field, on the device if there is one. Until the
  /// buffer is released, what is read on the host may have been changed by
  /// others. Fails where an element has no even distance from the next along
  /// each dimension, and for sparse fields. Zeros that are owed are to be
  /// settled before.
  static Status make(Field &field, DeviceHost &devices,
                     ExportedField &exported);
  /// Whether the field is exported, and where its elements then lie.
  static bool findBytes(const Field &field, uint64_t &begin, uint64_t &end);

private:
  static std::atomic<int> count;
  TreePtr tree;
  std::shared_ptr<void> memory;
  std::shared_ptr<Mirror> mirror;
};

struct ExportedField {
  void *address = nullptr;
  bool onDevice = false;
  /// Bytes from one index to the next, along each dimension of the field and of
  /// its element.
  std::vector<int64_t> strides;
  std::unique_ptr<ExportedBuffer> buffer;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_HOST_EXPORTEDBUFFER_H
