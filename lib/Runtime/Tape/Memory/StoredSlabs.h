//===- StoredSlabs.h - Unchanged stored outputs -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An adjoint may have a variant that loads values which its kernel has stored
// instead of recomputing them. It is valid for a launch if no later record has
// changed the slabs that the launch stored to. This tracks, for one field, the
// record that last stored to each slab.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_MEMORY_STOREDSLABS_H
#define TAI_LIB_RUNTIME_TAPE_MEMORY_STOREDSLABS_H

#include "tai/Runtime/Mirror/Slabs.h"
#include <algorithm>

namespace mlir::tai::runtime {

class StoredSlabs {
public:
  bool any() const { return anyStored; }

  /// Notes that the record with this stamp has stored to `range`, or to unknown
  /// slabs if the range is all; the field has `count` slabs. Sets lost[s] for
  /// each stamp s whose record's stored values this may overwrite. Only the
  /// last record that stored to a slab is tracked.
  void mark(SlabRange range, int64_t count, uint32_t stamp,
            std::vector<bool> &lost) {
    lose(range, lost, stamp);
    anyStored = true;
    if (range.isAll()) {
      anywhere = stamp;
      return;
    }
    if (at.empty())
      at.resize(static_cast<size_t>(count));
    std::fill(at.begin() + range.first, at.begin() + range.end(), stamp);
  }

  /// Notes that the slabs in `range` change, or unknown slabs if the range is
  /// all. The record with the stamp `keeps` does not lose its stored values.
  void lose(SlabRange range, std::vector<bool> &lost, uint32_t keeps = 0) {
    if (!anyStored || (range.count == 1 && anywhere == 0 &&
                       (at.empty() || at[range.first] == 0)))
      return;
    loseAny(range, lost, keeps);
  }

private:
  void loseAny(SlabRange range, std::vector<bool> &lost, uint32_t keeps) {
    auto loseOf = [&](uint32_t &stamp) {
      if (stamp == 0 || stamp == keeps)
        return;
      if (lost.size() <= stamp)
        lost.resize(stamp + 1);
      lost[stamp] = true;
      stamp = 0;
    };
    loseOf(anywhere);
    if (!range.isAll()) {
      if (!at.empty())
        std::for_each(at.begin() + range.first, at.begin() + range.end(),
                      loseOf);
      return;
    }
    std::for_each(at.begin(), at.end(), loseOf);
    anyStored = keeps != 0;
  }

  /// at: for each slab, the stamp of the last record that stored to it, or 0 if
  /// the slab has changed since. anywhere: the same for unknown slabs.
  std::vector<uint32_t> at;
  uint32_t anywhere = 0;
  bool anyStored = false;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_MEMORY_STOREDSLABS_H
