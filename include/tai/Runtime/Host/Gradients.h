//===- Gradients.h - Clearing of gradients ----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Clears adjoint and tangent fields that may be non-zero, and tracks which
// adjoint fields owe zeros (zeros not stored yet); see
// docs/decisions/0017-overwritten-gradients.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_HOST_GRADIENTS_H
#define TAI_RUNTIME_HOST_GRADIENTS_H

#include "tai/Runtime/Host/FieldCopies.h"
#include "tai/Runtime/Host/Recordings.h"
#include <functional>

namespace mlir::tai::runtime {

class Gradients {
public:
  Gradients(const TreeStore &store, const Recordings &recordings,
            const FieldCopies &copies, const SkipSet &skips,
            SkipCounters &counters)
      : store(store), recordings(recordings), copies(copies), skips(skips),
        counters(counters) {}

  /// Sets dirty adjoint fields to zero; in forward mode the tangents of
  /// adjoints too. For a tape, skips fields that another thread has written and
  /// the tape does not use. Fails if the host interrupts it.
  Status clear(const Recorder *tape = nullptr);
  /// Sets to zero the tangent fields that no other thread wrote last.
  void clearTangents();

  /// Defers storing zeros in an adjoint field until it is read. Launches of
  /// kernels that use no gradient go on as before.
  void owe(const FieldPtr &adjoint, std::shared_ptr<const OwedZeros> zeros);
  bool areOwed() const {
    return __builtin_expect(owesAny.load(std::memory_order_acquire), false);
  }
  /// Stores owed zeros. Call before memory is accessed other than through
  /// fields. Zeros owed by another thread belong to that thread, which may be
  /// using the field: settle stores them only in fields that the caller is
  /// about to use (`uses`).
  using Uses = std::function<bool(const FieldPtr &)>;
  void settle(const Uses &uses = nullptr);
  /// Call when the owed zeros of single fields have been stored.
  void forgetSettled();
  void forget(const Tree &tree);

private:
  /// Call whenever `owing` has changed.
  void update();

  const TreeStore &store;
  const Recordings &recordings;
  const FieldCopies &copies;
  const SkipSet &skips;
  SkipCounters &counters;
  /// Never held while zeros are stored, which may wait for a device.
  std::mutex mutex;
  /// Adjoint fields that may owe zeros, guarded by `mutex`; and whether there
  /// are any such fields.
  std::vector<FieldPtr> owing;
  std::atomic<bool> owesAny{false};
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_HOST_GRADIENTS_H
