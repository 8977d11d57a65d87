//===- LoopLists.h - Cells visited by loops ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The reverse of a loop over active cells visits the same cells as the loop,
// even if activity has changed. So the lists of a launch are kept: they are
// shared, and cost nothing while activity does not change.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_SPARSE_LOOPLISTS_H
#define TAI_RUNTIME_SPARSE_LOOPLISTS_H

#include "tai/Runtime/Sparse/Sparse.h"

namespace mlir::tai::runtime {

/// A list of active cells in device memory, which may not be computed yet.
class DeviceCells;
using DeviceCellsPtr = std::shared_ptr<const DeviceCells>;

class LoopLists {
public:
  /// If the launch has several loops over the same sparse level: tells whether
  /// all of them visited the same cells.
  enum class Others {
    /// All loops over the level visited the same cells, or there is only one
    /// loop.
    Same,
    /// Another loop over the level visited different cells.
    Differ,
    /// Not known, because comparing the visited cells would have to wait for
    /// lists on a device.
    Unknown
  };

  struct Entry {
    const SparseNode *node;
    /// The cells that the loop visited, as a list on the host or on the device:
    /// exactly one of the two is set.
    ActiveListPtr list;
    DeviceCellsPtr onDevice;
    Others others = Others::Same;
  };

  void add(const SparseNode &node, ActiveListPtr list) {
    Others others = Others::Same;
    for (Entry &entry : entries) {
      if (entry.node != &node || entry.list == list ||
          (entry.list && entry.list->cells == list->cells))
        continue;
      others = Others::Differ;
      if (entry.others == Others::Same)
        entry.others = Others::Differ;
    }
    entries.push_back({&node, std::move(list), nullptr, others});
  }
  void add(const SparseNode &node, DeviceCellsPtr list) {
    Others others = Others::Same;
    for (Entry &entry : entries)
      if (entry.node == &node && entry.onDevice != list)
        entry.others = others = Others::Unknown;
    entries.push_back({&node, nullptr, std::move(list), others});
  }
  const Entry *find(const SparseNode &node) const {
    for (const Entry &entry : entries)
      if (entry.node == &node)
        return &entry;
    return nullptr;
  }
  const std::vector<Entry> &all() const { return entries; }
  /// Adds the currently active cells, in place of the cells of a loop in the
  /// launch, which are not known.
  void addUnknown(const SparseNode &node, ActiveListPtr list, bool differs) {
    entries.push_back({&node, std::move(list), nullptr,
                       differs ? Others::Differ : Others::Same});
  }
  bool empty() const { return entries.empty(); }
  /// False if no loop has visited a cell. Lists on a device count as not empty.
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
