//===- ExportedBuffer.h - Field memory used by others -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A library with the address of a field writes to it without notice. On a
// device, the host's copy of an exported tree is therefore always considered
// stale, unless the host was the last to write.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_HOST_EXPORTEDBUFFER_H
#define TAI_RUNTIME_HOST_EXPORTEDBUFFER_H

#include "tai/Runtime/Mirror/DeviceHost.h"

namespace mlir::tai::runtime {

struct ExportedField;

/// Keeps the memory of an exported field alive, even after the field is
/// destroyed.
class ExportedBuffer {
public:
  explicit ExportedBuffer(const TreePtr &tree);
  ~ExportedBuffer();
  ExportedBuffer(const ExportedBuffer &) = delete;
  ExportedBuffer &operator=(const ExportedBuffer &) = delete;
  /// True if any exported buffer exists, in any runtime of the process.
  static bool areAny() { return count.load(std::memory_order_relaxed) > 0; }
  /// Exports the address of a field: on the device, if the runtime has one.
  /// Until the buffer is destroyed, reads on the host assume that others may
  /// have changed the field. Fails for sparse fields, and for fields whose
  /// elements are not strided uniformly along each dimension. The field must
  /// not owe zeros (see Gradients.h).
  static Status make(Field &field, DeviceHost &devices,
                     ExportedField &exported);
  /// True if `field` is exported; then sets `begin` and `end` to the range of
  /// addresses of its elements.
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
  /// Strides in bytes, for each dimension of the field and of its element.
  std::vector<int64_t> strides;
  std::unique_ptr<ExportedBuffer> buffer;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_HOST_EXPORTEDBUFFER_H
