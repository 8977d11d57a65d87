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

  /// Sets all adjoint fields to zero that may be non-zero; in forward mode,
  /// also the tangents of adjoint fields. With `tape`, skips fields that
  /// another thread has written and that the tape does not use. Fails if the
  /// host interrupts the work.
  Status clear(const Recorder *tape = nullptr);
  /// Sets to zero the tangent fields that no other thread wrote last.
  void clearTangents();

  /// Records that an adjoint field is zero where `zeros` says so, and defers
  /// storing these zeros until the field is read. Launches of kernels that use
  /// no gradient do not store them.
  void owe(const FieldPtr &adjoint, std::shared_ptr<const OwedZeros> zeros);
  bool areOwed() const {
    return __builtin_expect(owesAny.load(std::memory_order_acquire), false);
  }
  /// Stores deferred zeros. Must be called before memory is accessed other than
  /// through fields. Zeros deferred by another thread belong to that thread,
  /// which may be using the field: they are stored only in fields for which
  /// `uses` is true, because the caller is about to use them.
  using Uses = std::function<bool(const FieldPtr &)>;
  void settle(const Uses &uses = nullptr);
  /// Stores them as settle(uses) does at the start of a sweep, but not those of
  /// fields whose clearing waits for the sweep (isWaiting).
  void settleForSweep(const Uses &uses);
  /// True if the field has been cleared, and owes all of its zeros.
  static bool isWaiting(const Field &field) {
    return field.owesZeros() && field.dirtiedBy() == 0;
  }
  /// Removes from `owing` the fields whose deferred zeros have been stored; to
  /// be called after zeros of single fields have been stored.
  void forgetSettled();
  void forget(const Tree &tree);

private:
  /// Updates the flag `owesAny`. Must be called after each change of `owing`,
  /// the list of fields with deferred zeros.
  void update();
  void settleIf(const Uses &selected);
  /// Clears a field by owing all of its zeros, if the sweep of the tape will
  /// probably store the field before it reads it. False if it must be cleared.
  bool clearLater(const FieldPtr &field, const Recorder *tape);

  const TreeStore &store;
  const Recordings &recordings;
  const FieldCopies &copies;
  const SkipSet &skips;
  SkipCounters &counters;
  /// Guards `owing`, the list of fields with deferred zeros. Never held while
  /// zeros are stored, because storing may wait for a device.
  std::mutex mutex;
  /// Adjoint fields that may owe zeros, guarded by `mutex`; and a flag that
  /// tells whether there are any such fields.
  std::vector<FieldPtr> owing;
  std::atomic<bool> owesAny{false};
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_HOST_GRADIENTS_H
