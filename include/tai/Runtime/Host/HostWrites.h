//===- HostWrites.h - Changes that the host makes to fields -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A tape that records hears of them, and tapes of other threads may forbid
// them.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_HOST_HOSTWRITES_H
#define TAI_RUNTIME_HOST_HOSTWRITES_H

#include "tai/Runtime/Host/FieldCopies.h"
#include "tai/Runtime/Host/Recordings.h"

namespace mlir::tai::runtime {

/// Who follows tangents, which end where the host writes.
class OverwriteWatcher {
public:
  virtual ~OverwriteWatcher() = default;
  virtual void overwrite(const Field &field) = 0;
};

class HostWrites {
public:
  HostWrites(const TreeStore &store, const MemoryAccount &memory,
             const Recordings &recordings, const FieldCopies &copies,
             DeviceHost &devices)
      : store(store), memory(memory), recordings(recordings), copies(copies),
        devices(devices) {}

  /// Null for nobody.
  void setWatcher(OverwriteWatcher *follows) { watcher = follows; }

  /// The whole field from a row-major array of its own scalar type.
  Status copyIn(Field &field, const void *array);
  Status fillF64(Field &field, double value);
  Status fillI64(Field &field, int64_t value);
  /// One component of one element, as Field::writeF64.
  Status writeF64(Field &field, const int64_t *index, int64_t component,
                  double value);
  Status writeI64(Field &field, const int64_t *index, int64_t component,
                  int64_t value);
  /// The elements at `count` index tuples, from an array of the type of the
  /// field; their cells become active.
  Status writeElements(Field &field, const int64_t *indices, int64_t count,
                       const void *values);
  /// Makes a cell of a sparse level active or inactive, or, for -1, all of them
  /// inactive. A tape that records does so again where it replays.
  Status setActive(const TreePtr &tree, int64_t level, int64_t cell,
                   bool isActive);
  /// Others have written, or are about to write, to a field that is lent.
  /// Fails while a tape records, which would not know.
  Status noteOutside(Field &field);

  /// Any of them; and its steps, for tapes: what becomes active for it, and the
  /// change itself, of which nobody hears.
  Status change(const HostWrite &write);
  Status activateFor(const HostWrite &write);
  void perform(const HostWrite &write);

private:
  Status activateNonzero(Field &field, const void *array);

  const TreeStore &store;
  const MemoryAccount &memory;
  const Recordings &recordings;
  const FieldCopies &copies;
  DeviceHost &devices;
  OverwriteWatcher *watcher = nullptr;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_HOST_HOSTWRITES_H
