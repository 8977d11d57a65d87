//===- TreeStore.h - The trees and fields of a runtime ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Names, partners and memory. Handles stay safe to use when a tree is gone, and
// say so.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_STORAGE_TREESTORE_H
#define TAI_RUNTIME_STORAGE_TREESTORE_H

#include "tai/Runtime/Storage/Field.h"
#include "tai/Runtime/Storage/LaunchState.h"
#include "tai/Runtime/Storage/MemoryAccount.h"
#include "tai/Support/Skips.h"
#include <unordered_map>

namespace mlir::tai::runtime {

struct FieldInfo {
  std::string name;
  TreePtr tree;
  FieldLayout layout;
  /// Names of other fields, which need not exist yet; empty for none.
  std::string adjoint, dual;
};

/// Who gives trees memory on a device besides.
class TreeMirrors {
public:
  virtual ~TreeMirrors() = default;
  /// Whether a sparse tree can be there at all.
  virtual Status check(const std::string &name, int64_t bytes,
                       const std::vector<SparseInfo> &levels) const = 0;
  /// Null where there is no device.
  virtual std::shared_ptr<Mirror> make(Tree &tree, SparseOnDevice *&levels) = 0;
};

class TreeStore {
public:
  TreeStore(MemoryAccount &memory, LaunchState &state, const ListMaker &lists)
      : memory(memory), state(state), lists(lists) {}
  ~TreeStore();
  TreeStore(const TreeStore &) = delete;
  TreeStore &operator=(const TreeStore &) = delete;

  void setMirrors(TreeMirrors *made) { mirrors = made; }

  /// `sparse` describes the sparse levels, those above before those below.
  Status addTree(std::string name, int64_t bytes, TreePtr &tree,
                 std::vector<SparseInfo> sparse = {});
  /// From now on no launch begins to use the tree, or again one may.
  void setClosing(Tree &tree, bool isClosing);
  /// Frees the storage and forgets the fields.
  Status destroyTree(const std::string &name);
  TreePtr findTree(const std::string &name) const;
  const std::unordered_map<std::string, TreePtr> &trees() const {
    return treesByName;
  }
  /// A field of the tree, which stands for all of it where the activity of
  /// cells matters; null if there is none. Any thread.
  FieldPtr firstOf(const Tree &tree) const;

  Status addField(FieldInfo info, FieldPtr &field);
  /// Gives a field another adjoint than the one that it was declared with.
  Status setAdjoint(Field &field, const FieldPtr &adjoint);
  FieldPtr findField(const std::string &name) const;
  const std::vector<FieldPtr> &fields() const { return fieldList; }
  /// "field 'x'", for messages; a gradient is said to be one. Any thread.
  std::string describe(const Field &field) const;
  /// True for adjoints and tangents of other fields.
  bool isPartner(const Field &field) const;

  /// What trees and gradients have been given, and how much of it is in use.
  void countMemory(SkipAmounts &amounts) const;

private:
  void freeTree(Tree &tree);
  Status checkPartners(const Field &added) const;
  void linkPartners(const FieldPtr &added);

  MemoryAccount &memory;
  LaunchState &state;
  const ListMaker lists;
  TreeMirrors *mirrors = nullptr;
  uint64_t treesMade = 0;
  std::unordered_map<std::string, TreePtr> treesByName;
  std::unordered_map<std::string, FieldPtr> fieldsByName;
  std::vector<FieldPtr> fieldList;
  /// Taken to change the list, and to read it where others may: launches do not
  /// wait for other calls.
  mutable std::mutex fieldsMutex;
};

/// Bytes of the elements of a field that are active.
int64_t bytesInUse(const Field &field);

/// The skips and what they have left out, as a table to read.
std::string skipTable(SkipSet skips, const SkipAmounts &amounts);

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_STORAGE_TREESTORE_H
