//===- LiveSlabs.h - Adjoints that may be non-zero --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The elements whose adjoints may be non-zero ("live") at a point of a reverse
// sweep, according to the summaries of the kernels whose adjoints have run.
// After the adjoint of a launch that computes x[t + 1, b] from x[t, b], the
// slab of x at [t, b] is live, and the slab at [t + 1, b] is not if it has been
// zeroed.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_PLAN_LIVESLABS_H
#define TAI_LIB_RUNTIME_TAPE_PLAN_LIVESLABS_H

#include "../Record/TapeRecording.h"
#include "SlabSet.h"

namespace mlir::tai::runtime {

class LiveSlabs {
public:
  /// Starts without live elements.
  explicit LiveSlabs(const TapeRecording &recording);

  /// Marks the adjoints of all elements of a field, or of all fields, as
  /// possibly non-zero (live).
  void add(const Field &field);
  void addAll() { isAll = true; }
  /// Marks no element of the field as live any more.
  void remove(const Field &field);

  /// Whether a kernel has so many accesses to a field that they count as one
  /// access to all of its elements.
  static bool hasManyPlaces(const Kernel &kernel, const Field &field);

  bool has(const Field &field) const;
  /// True if a launch writes, or overwrites, elements whose adjoints may be
  /// non-zero.
  bool isWritten(const TapeRecording::Record &record) const;
  bool isOverwritten(const TapeRecording::Record &record) const;

  /// Updates the set of live elements after the adjoint of a launch. `zeroes`:
  /// the adjoint has set the adjoints of the elements that the launch
  /// overwrites to zero.
  void pass(const TapeRecording::Record &record, bool zeroes);

  /// For passes in the order of the records, in which an element is live if its
  /// value depends on the inputs of interest. isRead: whether a launch reads
  /// live elements. passForward: updates the live elements after the launch.
  bool isRead(const TapeRecording::Record &record) const;
  void passForward(const TapeRecording::Record &record, bool isRead);

private:
  struct Use {
    size_t set;
    unsigned shape;
    const std::vector<FixedIndex> *fixed;
  };
  struct KernelUses {
    std::vector<Use> read, written, overwritten;
    /// The subset of `overwritten` of which each launch stores all elements.
    std::vector<Use> ended;
  };
  size_t numberOf(const Field &field);
  void collect(const Kernel &kernel, KernelUses &uses);
  SlabSet::Slab locate(const Use &use, const uint64_t *args) const {
    return sets[use.set].locate(use.shape, *use.fixed, args);
  }
  bool meets(const std::vector<Use> &uses, const uint64_t *args) const;
  void add(const std::vector<Use> &uses, const uint64_t *args);
  void end(const KernelUses &uses, const uint64_t *args);

  const TapeRecording &recording;
  bool isAll = false;
  std::vector<SlabSet> sets;
  std::unordered_map<const Field *, size_t> numbers;
  std::unordered_map<const Kernel *, KernelUses> kernelUses;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_PLAN_LIVESLABS_H
