//===- LoopLists.h - What loops over sparse levels went over ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The reverse of a loop over active cells goes over those cells that the loop
// went over, whatever is active by then. So the lists of a launch are kept:
// they are shared, and cost nothing while activity stays as it is.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_SPARSE_LOOPLISTS_H
#define TAI_RUNTIME_SPARSE_LOOPLISTS_H

#include "tai/Runtime/Sparse/Sparse.h"

namespace mlir::tai::runtime {

/// A list of active cells in the memory of a device, which may still be made.
class DeviceCells;
using DeviceCellsPtr = std::shared_ptr<const DeviceCells>;

class LoopLists {
public:
  struct Entry {
    const SparseNode *node;
    /// One of them.
    ActiveListPtr list;
    DeviceCellsPtr onDevice;
    /// Another loop of the launch over the same level went over other cells.
    bool differs = false;
    /// That has to be found out: of lists on a device the host knows nothing.
    bool mayDiffer = false;
  };

  void add(const SparseNode &node, ActiveListPtr list) {
    bool differs = false;
    for (Entry &entry : entries) {
      if (entry.node != &node || entry.list == list)
        continue;
      bool isOther = !entry.list || entry.list->cells != list->cells;
      entry.differs |= isOther;
      differs |= isOther;
    }
    entries.push_back({&node, std::move(list), nullptr, differs});
  }
  void add(const SparseNode &node, DeviceCellsPtr list) {
    bool mayDiffer = false;
    for (Entry &entry : entries)
      if (entry.node == &node && entry.onDevice != list)
        entry.mayDiffer = mayDiffer = true;
    entries.push_back({&node, nullptr, std::move(list), false, mayDiffer});
  }
  const Entry *find(const SparseNode &node) const {
    for (const Entry &entry : entries)
      if (entry.node == &node)
        return &entry;
    return nullptr;
  }
  const std::vector<Entry> &all() const { return entries; }
  /// Adds what is active now, for a launch whose own lists nobody has kept.
  void addUnknown(const SparseNode &node, ActiveListPtr list, bool differs) {
    entries.push_back({&node, std::move(list), nullptr, differs});
  }
  bool empty() const { return entries.empty(); }
  /// True also where nobody knows.
  bool hasCells() const {
    for (const Entry &entry : entries)
      if (entry.onDevice || !entry.list->cells.empty())
        return true;
    return false;
  }
  void clear() { entries.clear(); }

private:
  std::vector<Entry> entries;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_SPARSE_LOOPLISTS_H
