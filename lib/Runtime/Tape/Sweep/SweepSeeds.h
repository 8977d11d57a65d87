//===- SweepSeeds.h - Starts of reverse sweeps ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Losses with the seeds of their adjoints, and which other adjoints may be
// non-zero at the start of a sweep.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_SWEEP_SWEEPSEEDS_H
#define TAI_LIB_RUNTIME_TAPE_SWEEP_SWEEPSEEDS_H

#include "../Record/TapeHolds.h"

namespace mlir::tai::runtime {

class SweepSeeds {
public:
  explicit SweepSeeds(TapeServices services) : services(services) {}

  bool empty() const { return losses.empty(); }
  bool has(const Field &field) const;
  /// The names of the losses as text: "'loss', 'other'".
  std::string names() const;

  /// Adds a loss, which the tape holds from then on. A field of one number is
  /// treated as a sum: it is set to zero, and its seed is 1.
  Status add(FieldPtr loss, TapeHolds &holds);
  /// Sets the seed of a loss, the initial value of its adjoint: a row-major
  /// array of the adjoint's scalar type.
  Status set(const Field &loss, const void *array);
  /// Sets the losses that are sums to zero, before the sequence runs again.
  void clearSums() const;
  /// Stores the seeds to the adjoints of the losses.
  Status store() const;

  /// The fields whose adjoints may be non-zero when a sweep starts, except
  /// those written by other threads only. `cleared`: gradients are zeroed
  /// before the sweep, so that only exported ones can be non-zero.
  std::vector<Field *> liveFields(bool cleared, const TapeHolds &holds) const;

private:
  struct Loss {
    FieldPtr field;
    /// The seed of the loss in the scalar type of its adjoint; empty for a seed
    /// of 1.
    std::vector<char> seed;
  };
  void clearSum(Field &loss) const;

  TapeServices services;
  std::vector<Loss> losses;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_SWEEP_SWEEPSEEDS_H
