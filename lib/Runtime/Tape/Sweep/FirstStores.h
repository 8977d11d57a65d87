//===- FirstStores.h - Adjoints that a sweep need not clear -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The first adjoint kernel of a sweep that uses an adjoint field often adds to
// each of its elements once. It then stores them instead, and the field, which
// is zero by its state, need not be zero in memory; see
// docs/decisions/0082-first-stores.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_SWEEP_FIRSTSTORES_H
#define TAI_LIB_RUNTIME_TAPE_SWEEP_FIRSTSTORES_H

#include "AdjointForms.h"

namespace mlir::tai::runtime {

class FirstStores {
public:
  FirstStores(TapeServices services, const TapeRecording &recording,
              const TapePlan &plan, const AdjointForms &forms)
      : services(services), recording(recording), plan(plan), forms(forms) {}

  /// Chooses the fields that the planned sweep stores first, if `mayChoose`,
  /// and clears all others that wait for a sweep. Must be called before the
  /// first adjoint is launched.
  void begin(bool mayChoose);
  /// Ends the sweep: a field that it did not store is zero again, and all are
  /// if the sweep has failed.
  void end(bool hasFailed);

  /// Before and after the launch of a record's adjoint: the bits of
  /// TaiFrame::zeroAdjoints, whose fields owe no zeros any more; and a check
  /// whether it was launched at all.
  uint64_t enter(uint32_t index) {
    return __builtin_expect(stores.empty(), true) ? 0 : take(index);
  }
  void leave(uint32_t index) {
    if (__builtin_expect(!stores.empty(), false))
      settle(index);
  }

  /// The fields that the last sweep stored without clearing them, and their
  /// size.
  const std::vector<std::string> &names() const { return stored; }
  int64_t bytes() const { return storedBytes; }

private:
  struct Store {
    uint32_t index;
    uint64_t bit;
    FieldPtr field;
    bool isLaunched;
  };

  void choose();
  bool mayStore(const Field &adjoint) const;
  uint64_t take(uint32_t index);
  void settle(uint32_t index);

  TapeServices services;
  const TapeRecording &recording;
  const TapePlan &plan;
  const AdjointForms &forms;
  std::vector<Store> stores;
  std::vector<std::string> stored;
  int64_t storedBytes = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_SWEEP_FIRSTSTORES_H
