//===- StoredOutputs.h - What stands where it was stored --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An adjoint has a form that loads values which its kernel has stored, where
// that saves computing them once more. A launch is reversed by it if nothing
// that the tape has seen since has changed the slabs which it stored to: then
// the fields still hold them. This remembers, for one field, who has stored to
// each slab last.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_MEMORY_STOREDOUTPUTS_H
#define TAI_LIB_RUNTIME_TAPE_MEMORY_STOREDOUTPUTS_H

#include <algorithm>
#include <cstdint>
#include <vector>

namespace mlir::tai::runtime {

class StoredOutputs {
public:
  bool any() const { return anyStored; }

  /// The record of this stamp has stored to a slab of `count`, or to one that
  /// is not known, for -1. `lost` is told which records, by their stamps, lose
  /// what they stored. Of two that store there, only the later one is looked
  /// after.
  void mark(int64_t slab, int64_t count, uint32_t stamp,
            std::vector<bool> &lost) {
    lose(slab, lost, stamp);
    anyStored = true;
    if (slab < 0) {
      anywhere = stamp;
      return;
    }
    if (at.empty())
      at.resize(static_cast<size_t>(count));
    at[slab] = stamp;
  }

  /// A slab, or all of them for -1, changes. The record of the stamp `keeps`
  /// does not lose what it stored.
  void lose(int64_t slab, std::vector<bool> &lost, uint32_t keeps = 0) {
    if (!anyStored)
      return;
    auto loseOf = [&](uint32_t &stamp) {
      if (stamp == 0 || stamp == keeps)
        return;
      if (lost.size() <= stamp)
        lost.resize(stamp + 1);
      lost[stamp] = true;
      stamp = 0;
    };
    loseOf(anywhere);
    if (slab >= 0) {
      if (!at.empty())
        loseOf(at[slab]);
      return;
    }
    std::for_each(at.begin(), at.end(), loseOf);
    anyStored = keeps != 0;
  }

private:
  /// Stamps of the record that has stored to each slab, and to one at an
  /// unknown place, and whose adjoint may load that; 0 once it was changed.
  std::vector<uint32_t> at;
  uint32_t anywhere = 0;
  bool anyStored = false;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_MEMORY_STOREDOUTPUTS_H
