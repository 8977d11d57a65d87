//===- FieldCopies.h - Copies of whole fields -------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Copies between a field and a row-major array of the host, and fills; on
// worker threads, or on the device if the field is there. Recorders are not
// notified: see HostWrites.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_HOST_FIELDCOPIES_H
#define TAI_RUNTIME_HOST_FIELDCOPIES_H

#include "tai/Runtime/Mirror/DeviceHost.h"
#include "tai/Runtime/Threads/Safepoint.h"
#include "tai/Runtime/Threads/Workers.h"
#include <functional>

namespace mlir::tai::runtime {

class FieldCopies {
public:
  FieldCopies(Workers &workers, DeviceHost &devices)
      : workers(workers), devices(devices) {}

  /// Copies all elements of a field to an array of its scalar type, of shape
  /// (shape..., element shape...).
  Status copyOut(const Field &field, void *array) const;
  /// The number of bytes that a copy moves between two safepoints, which takes
  /// a few milliseconds, even if the pages of the memory are new.
  static constexpr int64_t bytesPerSafepoint = 4 << 20;
  /// Tells whether a request of the host to interrupt stops a copy in the
  /// middle, or has to wait until the copy is complete. In both cases the copy
  /// passes safepoints.
  enum class Interrupts { Stop, Wait };
  /// Copies an array to a field; for a sparse field, to active cells only.
  /// False if the copy was interrupted: the field then holds a part of the
  /// array.
  bool copyIn(Field &field, const void *array,
              Interrupts interrupts = Interrupts::Wait) const;
  /// Sets all components of all elements of a field to one scalar of the
  /// field's type. False if the host interrupted the fill.
  bool fill(Field &field, const void *scalarBytes,
            Interrupts interrupts = Interrupts::Wait) const;
  bool clear(Field &field, Interrupts interrupts = Interrupts::Wait) const {
    const char zeros[8] = {};
    return fill(field, zeros, interrupts);
  }

private:
  /// Calls run(begin, end) for ranges that make up [0, count), with safepoints
  /// in between, on worker threads if `bytes` is large enough. False if the
  /// host has interrupted the work.
  bool runParts(int64_t count, int64_t bytes, Interrupts interrupts,
                const std::function<void(int64_t, int64_t)> &run) const;
  template <typename Data, typename Move>
  bool forEachRow(const Field &field, Data *data, Interrupts interrupts,
                  const Move &move) const;
  template <typename Body>
  bool forEachActiveCell(const Field &field, int64_t bytesOfCell,
                         Interrupts interrupts, const Body &body) const;
  bool fillActive(Field &field, const void *scalarBytes,
                  Interrupts interrupts) const;
  bool copyInActive(Field &field, const void *array,
                    Interrupts interrupts) const;

  Workers &workers;
  DeviceHost &devices;
};

/// Lets work that copies many small pieces pass safepoints, and refuses to
/// begin such work again from a handler that has interrupted it.
class CopySafepoints {
public:
  /// Passes the first safepoint, which starts the clock, if `bytes` bytes take
  /// long to copy. Fails if the host interrupts the work.
  Status begin(int64_t bytes);
  Status pass();
  /// Fails if called from a handler that has interrupted this work.
  Status checkHandler() const;

private:
  template <typename Look> Status call(const Look &look);

  safepoint::Watch watch;
  bool isLong = false, isInHandler = false;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_HOST_FIELDCOPIES_H
