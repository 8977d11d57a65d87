//===- Gradients.h - Adjoints and tangents as a whole -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Clears those that may hold something, and knows which adjoint fields owe
// zeros; see docs/decisions/0017-overwritten-gradients.md.
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
            const FieldCopies &copies, LaunchState &state, const SkipSet &skips,
            SkipCounters &counters)
      : store(store), recordings(recordings), copies(copies), state(state),
        skips(skips), counters(counters) {}

  /// Sets the adjoint fields that are dirty to zero; in forward mode the
  /// tangents of adjoints too. On behalf of a tape, all but those to which
  /// another thread has written and which the tape does not use.
  void clear(const Recorder *tape = nullptr);
  /// The same for the tangents that the calling thread has left.
  void clearTangents();

  /// Leaves zeros of an adjoint field to whoever looks at them.
  void owe(const FieldPtr &adjoint, std::shared_ptr<const OwedZeros> zeros);
  bool areOwed() const {
    return __builtin_expect(owesAny.load(std::memory_order_acquire), false);
  }
  /// Stores them. To be called before anybody looks past the fields. Those that
  /// another thread has left belong to it, which may be at work there: of them,
  /// only those of the fields that the caller is about to use.
  using Uses = std::function<bool(const FieldPtr &)>;
  void settle(const Uses &uses = nullptr);
  /// The same for those fields that `settleSome` settles.
  template <typename Body> void settleThose(const Body &settleSome) {
    std::lock_guard<std::mutex> lock(mutex);
    settleSome();
    forgetSettled();
  }
  void forget(const Tree &tree);

private:
  void forgetSettled();
  /// To be called whenever `owing` has changed.
  void update();

  const TreeStore &store;
  const Recordings &recordings;
  const FieldCopies &copies;
  LaunchState &state;
  const SkipSet &skips;
  SkipCounters &counters;
  std::mutex mutex;
  /// Adjoint fields that may owe zeros, under the lock; and whether there are
  /// any.
  std::vector<FieldPtr> owing;
  std::atomic<bool> owesAny{false};
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_HOST_GRADIENTS_H
