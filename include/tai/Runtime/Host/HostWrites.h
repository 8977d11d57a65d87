//===- HostWrites.h - Writes of the host to fields --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Writes of the host are passed to a tape that records, and may be refused
// because of tapes of other threads.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_HOST_HOSTWRITES_H
#define TAI_RUNTIME_HOST_HOSTWRITES_H

#include "tai/Runtime/Host/FieldCopies.h"
#include "tai/Runtime/Host/Recordings.h"
#include "tai/Runtime/Storage/Halos.h"

namespace mlir::tai::runtime {

/// An observer for forward mode: the tangent of a field ends where the host
/// overwrites it.
class OverwriteWatcher {
public:
  virtual ~OverwriteWatcher() = default;
  virtual void overwrite(const Field &field) = 0;
};

class HostWrites {
public:
  HostWrites(const TreeStore &store, const MemoryAccount &memory,
             const Recordings &recordings, const FieldCopies &copies,
             DeviceHost &devices, Halos &halos)
      : store(store), memory(memory), recordings(recordings), copies(copies),
        devices(devices), halos(halos) {}

  /// Sets the observer that is told of each write of the host; null removes it.
  void setWatcher(OverwriteWatcher *follows) { watcher = follows; }

  /// Writes all elements of a field, from a row-major array of its scalar type.
  Status copyIn(Field &field, const void *array);
  Status fillF64(Field &field, double value);
  Status fillI64(Field &field, int64_t value);
  /// Writes one component of one element of a field, converted to the field's
  /// type; see Field::writeF64.
  Status writeF64(Field &field, const int64_t *index, int64_t component,
                  double value);
  Status writeI64(Field &field, const int64_t *index, int64_t component,
                  int64_t value);
  /// Writes the elements at `count` index tuples, from an array of the field's
  /// type; activates their cells.
  Status writeElements(Field &field, const int64_t *indices, int64_t count,
                       const void *values);
  /// Activates or deactivates a cell of a sparse level; `cell` -1 deactivates
  /// all cells of the level. The change is recorded by a tape, and repeated on
  /// replay.
  Status setActive(const TreePtr &tree, int64_t level, int64_t cell,
                   bool isActive);
  /// Notes that another library has written, or will write, to an exported
  /// field. Fails while a tape records, because it cannot record such writes.
  Status noteOutside(Field &field);

  /// Performs a write of the host, of any of the kinds above. A tape calls the
  /// two steps of a write, which notify no recorder: `activateFor` activates
  /// the cells of sparse levels, and `perform` stores the values.
  Status change(const HostWrite &write);
  Status activateFor(const HostWrite &write);
  /// Stores the values of a write. Returns false if the host interrupted it.
  bool
  perform(const HostWrite &write,
          FieldCopies::Interrupts interrupts = FieldCopies::Interrupts::Wait);

private:
  /// Removes the halos of a field that the host writes.
  void removeHalos(const Field &field);
  Status activateNonzero(Field &field, const void *array);

  const TreeStore &store;
  const MemoryAccount &memory;
  const Recordings &recordings;
  const FieldCopies &copies;
  DeviceHost &devices;
  Halos &halos;
  OverwriteWatcher *watcher = nullptr;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_HOST_HOSTWRITES_H
